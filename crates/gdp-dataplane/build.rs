//! Embeds the XDP programs if `cargo xtask build` has compiled them from the current source.

use std::path::Path;
use std::{env, fs, io};

#[path = "../../gdp-ebpf/fingerprint.rs"]
mod fingerprint;

fn main() -> io::Result<()> {
    let manifest = env::var("CARGO_MANIFEST_DIR").map_err(io::Error::other)?;
    let out = env::var("OUT_DIR").map_err(io::Error::other)?;
    let root = Path::new(&manifest).ancestors().nth(2).ok_or(io::ErrorKind::NotFound)?;
    let object = fingerprint::object(root)?;
    // Watch the folder while the object does not exist. Cargo treats a missing file as a changed
    // file.
    let object_or_folder = if object.is_file() { object.clone() } else { root.join(fingerprint::FOLDER) };
    for path in fingerprint::files(root)?.iter().chain([&object_or_folder]) {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    let embedded = if object.is_file() {
        fs::copy(&object, Path::new(&out).join("object"))?;
        "Some(aya::include_bytes_aligned!(concat!(env!(\"OUT_DIR\"), \"/object\")))"
    } else {
        "None"
    };
    fs::write(Path::new(&out).join("embedded.rs"), format!("const EMBEDDED: Option<&[u8]> = {embedded};\n"))
}
