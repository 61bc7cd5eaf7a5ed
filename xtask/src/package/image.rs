//! Writes an image of the OCI without a daemon: a layer with Debian's C library, and a layer with
//! the programs. <https://specs.opencontainers.org/image-spec/>

use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::arch::Arch;
use super::build::packaging;
use super::stage::Staged;

/// Debian packages of the lower layer. The programs need no others, and no shell.
const BASE: [&str; 3] = ["libc6", "libgcc-s1", "base-files"];

/// The folder of the volume for keys and configuration.
const KEYS: &str = "etc/gdp";

const LAYER: &str = "application/vnd.oci.image.layer.v1.tar+gzip";
const CONFIG: &str = "application/vnd.oci.image.config.v1+json";
const MANIFEST: &str = "application/vnd.oci.image.manifest.v1+json";

/// The user of the programs, as `packaging/image/passwd` has it.
const USER: &str = "31415:31415";

/// A layer, by the digest of its file and of the tar in it.
struct Layer {
    descriptor: Value,
    diff: String,
}

/// Writes `gdp-VERSION-ARCH.oci.tar`, which `docker load`, `podman load` and skopeo read.
pub fn write(staged: &Staged) -> Result<PathBuf> {
    ensure!(staged.arch == Arch::Amd64, "the lower layer comes from this machine's Debian, so it is amd64");
    let work = staged.folder.join("image");
    if work.exists() {
        fs::remove_dir_all(&work)?;
    }
    let blobs = work.join("oci/blobs/sha256");
    fs::create_dir_all(&blobs)?;
    let (base, programs) = (work.join("base"), work.join("programs"));
    lay_out_base(&work, &base)?;
    for package in &staged.packages {
        if package.name != "gdp-switch" {
            fs::create_dir_all(&programs)?;
            execute(Program::Cp.command().arg("-r").arg(package.tree.join("usr")).arg(&programs))?;
        }
    }
    // Manual pages and units are for people and systemd.
    for unused in ["usr/share/man", "usr/lib", "usr/share/lintian"] {
        let _ = fs::remove_dir_all(programs.join(unused));
    }
    // The volume for keys gets its owner from the image.
    let own = work.join("own");
    fs::create_dir_all(own.join(KEYS))?;
    let layers =
        [layer(&base, ".", "0", &blobs)?, layer(&programs, ".", "0", &blobs)?, layer(&own, KEYS, "31415", &blobs)?];
    let config = json!({
        "architecture": staged.arch.debian(),
        "os": "linux",
        "config": {
            "User": USER,
            "Env": ["PATH=/usr/bin", "XDG_CONFIG_HOME=/etc", "XDG_STATE_HOME=/var/lib", "XDG_RUNTIME_DIR=/run"],
            "Entrypoint": ["/usr/bin/gdp-proxy"],
            "Cmd": ["/etc/gdp/proxy.yaml"],
            "Volumes": {"/etc/gdp": {}},
            "StopSignal": "SIGTERM",
            "Labels": {"org.opencontainers.image.version": staged.version, "org.opencontainers.image.title": "gdp-proxy"},
        },
        "rootfs": {"type": "layers", "diff_ids": layers.iter().map(|layer| &layer.diff).collect::<Vec<_>>()},
    });
    let config = blob(&serde_json::to_vec(&config)?, CONFIG, &blobs)?;
    let of_layers: Vec<_> = layers.iter().map(|layer| &layer.descriptor).collect();
    let manifest = json!({"schemaVersion": 2, "mediaType": MANIFEST, "config": config, "layers": of_layers});
    let mut manifest = blob(&serde_json::to_vec(&manifest)?, MANIFEST, &blobs)?;
    manifest["annotations"] = json!({
        "org.opencontainers.image.ref.name": staged.version,
        "io.containerd.image.name": format!("gdp-proxy:{}", staged.version),
    });
    manifest["platform"] = json!({"architecture": staged.arch.debian(), "os": "linux"});
    let index = json!({"schemaVersion": 2, "manifests": [manifest]});
    fs::write(work.join("oci/index.json"), serde_json::to_vec(&index)?)?;
    // What `docker load` reads where it knows no layout of the OCI.
    let path =
        |descriptor: &Value| descriptor["digest"].as_str().unwrap_or_default().replace("sha256:", "blobs/sha256/");
    let paths: Vec<_> = of_layers.iter().map(|layer| path(layer)).collect();
    let tags = [format!("gdp-proxy:{}", staged.version)];
    let legacy = json!([{"Config": path(&config), "RepoTags": tags, "Layers": paths}]);
    fs::write(work.join("oci/manifest.json"), serde_json::to_vec(&legacy)?)?;
    fs::write(work.join("oci/oci-layout"), br#"{"imageLayoutVersion": "1.0.0"}"#)?;
    let compose = fs::read_to_string(packaging("compose.yaml"))?.replace(env!("CARGO_PKG_VERSION"), &staged.version);
    fs::write(staged.folder.join("compose.yaml"), compose)?;
    let file = staged.folder.join(format!("gdp-{}-{}.oci.tar", staged.version, staged.arch.debian()));
    execute(Program::Tar.command().args(["--sort=name", "-cf"]).arg(&file).arg("-C").arg(work.join("oci")).arg("."))?;
    fs::remove_dir_all(&work)?;
    println!("{} ({:.1} MB)", file.display(), file.metadata()?.len() as f64 / 1e6);
    Ok(file)
}

/// Unpacks the lower layer from packages of this machine's Debian.
fn lay_out_base(work: &Path, base: &Path) -> Result<()> {
    let debs = work.join("debs");
    fs::create_dir_all(&debs)?;
    execute(Program::AptGet.command().args(["-q", "download"]).args(BASE).current_dir(&debs))?;
    for entry in fs::read_dir(&debs)? {
        execute(Program::DpkgDeb.command().arg("-x").arg(entry?.path()).arg(base))?;
    }
    for unused in ["usr/share/doc", "usr/share/man", "usr/share/locale", "usr/share/lintian", "usr/sbin"] {
        let _ = fs::remove_dir_all(base.join(unused));
    }
    for file in ["passwd", "group"] {
        let source = packaging("image").join(file);
        fs::copy(&source, base.join("etc").join(file)).with_context(|| format!("cannot copy {}", source.display()))?;
    }
    Ok(())
}

/// Packs a folder. Times and order are fixed, so equal files make an equal layer.
fn layer(tree: &Path, what: &str, owner: &str, blobs: &Path) -> Result<Layer> {
    let tar = blobs.join("layer.tar");
    let mut pack = Program::Tar.command();
    pack.args([
        "--sort=name",
        "--mtime=@0",
        "--numeric-owner",
        &format!("--owner={owner}"),
        &format!("--group={owner}"),
    ]);
    execute(pack.arg("-cf").arg(&tar).arg("-C").arg(tree).arg(what))?;
    let diff = format!("sha256:{}", digest(&tar)?);
    execute(Program::Gzip.command().arg("-n6").arg(&tar))?;
    let packed = blobs.join("layer.tar.gz");
    let (digest, size) = (digest(&packed)?, packed.metadata()?.len());
    fs::rename(&packed, blobs.join(&digest))?;
    Ok(Layer { descriptor: json!({"mediaType": LAYER, "digest": format!("sha256:{digest}"), "size": size}), diff })
}

/// Writes a blob, and returns its descriptor.
fn blob(content: &[u8], media: &str, blobs: &Path) -> Result<Value> {
    let digest = hex(&Sha256::digest(content));
    fs::write(blobs.join(&digest), content)?;
    Ok(json!({"mediaType": media, "digest": format!("sha256:{digest}"), "size": content.len()}))
}

fn digest(file: &Path) -> Result<String> {
    let mut hasher = Sha256::new();
    let mut reader = BufReader::new(File::open(file)?);
    let mut buffer = vec![0; 1 << 20];
    loop {
        match io::Read::read(&mut reader, &mut buffer)? {
            0 => return Ok(hex(&hasher.finalize())),
            length => hasher.update(&buffer[..length]),
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
