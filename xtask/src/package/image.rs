//! Writes an image of the OCI without a daemon: a layer with Debian's C library, and a layer with
//! the programs. <https://specs.opencontainers.org/image-spec/>

use std::fs::{self, File, Permissions};
use std::io::{self, BufReader};
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::arch::Arch;
use super::build::packaging;
use super::stage::{Staged, settle};

/// Debian packages of the lower layer. The programs need no others, and no shell. Those of arm64
/// are for cross compilers, so that this machine's Debian has them.
const BASE: [&str; 3] = ["libc6", "libgcc-s1", "base-files"];
const BASE_ARM64: [&str; 3] = ["libc6-arm64-cross", "libgcc-s1-arm64-cross", "base-files"];

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
    let work = staged.folder.join("image");
    if work.exists() {
        fs::remove_dir_all(&work)?;
    }
    let blobs = work.join("oci/blobs/sha256");
    fs::create_dir_all(&blobs)?;
    let (base, programs) = (work.join("base"), work.join("programs"));
    lay_out_base(staged.arch, &work, &base)?;
    for package in &staged.packages {
        if package.name != "gdp-switch" {
            fs::create_dir_all(&programs)?;
            execute(Program::Cp.command().arg("-r").arg(package.tree.join("usr")).arg(&programs))?;
        }
    }
    settle(&programs, staged.epoch)?;
    // Manual pages and units are for people and systemd.
    for unused in ["usr/share/man", "usr/lib", "usr/share/lintian"] {
        let _ = fs::remove_dir_all(programs.join(unused));
    }
    // The volume for keys gets its owner from the image.
    let own = work.join("own");
    fs::create_dir_all(own.join(KEYS))?;
    settle(&own, staged.epoch)?;
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
    settle(&work.join("oci"), staged.epoch)?;
    let file = staged.folder.join(format!("gdp-{}-{}.oci.tar", staged.version, staged.arch.debian()));
    execute(
        Program::Tar
            .command()
            .args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "-cf"])
            .arg(&file)
            .arg("-C")
            .arg(work.join("oci"))
            .arg("."),
    )?;
    fs::remove_dir_all(&work)?;
    println!("{} ({:.1} MB)", file.display(), file.metadata()?.len() as f64 / 1e6);
    Ok(file)
}

/// Unpacks the layers of an image as a runtime does, and starts its programs in them.
pub fn check(file: &Path, arch: Arch) -> Result<()> {
    let work = tempfile::tempdir()?;
    let (oci, root) = (work.path().join("oci"), work.path().join("root"));
    unpack(file, &oci)?;
    let index: Value = serde_json::from_slice(&fs::read(oci.join("index.json"))?)?;
    let manifest: Value = serde_json::from_slice(&fs::read(stored(&oci, &index["manifests"][0])?)?)?;
    for layer in manifest["layers"].as_array().context("the image has no layers")? {
        unpack(&stored(&oci, layer)?, &root)?;
    }
    for program in ["gdp-proxy", "gdp-ctl"] {
        let inside = format!("usr/bin/{program}");
        let mut command = if arch.is_native() {
            let mut command = Program::Unshare.command();
            let (user, group) = USER.split_once(':').context("a user and a group")?;
            command.args(["--setuid", user, "--setgid", group, "--root"]).arg(&root).arg(format!("/{inside}"));
            command
        } else {
            let mut command = Program::QemuArm64.command();
            command.arg("-L").arg(&root).arg(root.join(inside));
            command
        };
        let said =
            execute(command.arg("--version")).with_context(|| format!("{program} does not start in the image"))?;
        println!("in the image for {}: {}", arch.debian(), said.trim());
    }
    Ok(())
}

fn unpack(tar: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    execute(Program::Tar.command().arg("-xf").arg(tar).arg("-C").arg(to))?;
    Ok(())
}

/// Returns the file of a blob, which has the digest that its descriptor states.
fn stored(oci: &Path, descriptor: &Value) -> Result<PathBuf> {
    let stated = descriptor["digest"].as_str().and_then(|digest| digest.strip_prefix("sha256:"));
    let stated = stated.context("a descriptor without a digest")?;
    let file = oci.join("blobs/sha256").join(stated);
    ensure!(digest(&file)? == stated, "{} is not what its descriptor states", file.display());
    Ok(file)
}

/// Unpacks the lower layer from packages of this machine's Debian.
fn lay_out_base(arch: Arch, work: &Path, base: &Path) -> Result<()> {
    let debs = work.join("debs");
    fs::create_dir_all(&debs)?;
    let names = if arch == Arch::Amd64 { BASE } else { BASE_ARM64 };
    execute(Program::AptGet.command().args(["-q", "download"]).args(names).current_dir(&debs))?;
    for entry in fs::read_dir(&debs)? {
        execute(Program::DpkgDeb.command().arg("-x").arg(entry?.path()).arg(base))?;
    }
    if arch == Arch::Arm64 {
        let libraries = base.join("lib/aarch64-linux-gnu");
        fs::create_dir_all(base.join("lib"))?;
        fs::set_permissions(base.join("lib"), Permissions::from_mode(0o755))?;
        fs::rename(base.join("usr/aarch64-linux-gnu/lib"), &libraries)?;
        symlink("aarch64-linux-gnu/ld-linux-aarch64.so.1", base.join("lib/ld-linux-aarch64.so.1"))?;
    }
    for unused in ["usr/share/doc", "usr/share/man", "usr/share/locale", "usr/share/lintian", "usr/sbin"] {
        let _ = fs::remove_dir_all(base.join(unused));
    }
    for file in ["passwd", "group"] {
        let source = packaging("image").join(file);
        let to = base.join("etc").join(file);
        fs::copy(&source, &to).with_context(|| format!("cannot copy {}", source.display()))?;
        fs::set_permissions(&to, Permissions::from_mode(0o644))?;
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
