//! `cargo xtask build`: builds the XDP programs, then the executables that embed them.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::programs::{Executable as _, Program, own};

use crate::setup::{self, EbpfCompiler, Purpose};
use crate::workspace::{self, Profile};
use crate::{debug_symbols, remap, shell};

#[path = "../../gdp-ebpf/fingerprint.rs"]
mod fingerprint;

#[derive(clap::Args)]
pub struct Options {
    /// Build only the XDP programs
    #[arg(long)]
    ebpf_only: bool,
    /// Build with overflow checks and debug assertions, as the tests do
    #[arg(long)]
    checked: bool,
    /// Build as for releases and benchmarks: with link-time optimisation, stripped, and with debug
    /// symbols in separate files
    #[arg(long, conflicts_with = "checked")]
    dist: bool,
    #[command(flatten)]
    features: Features,
}

/// Optional features of `gdp-ctl`.
#[derive(clap::Args, Clone, Copy, Default)]
pub struct Features {
    /// Build gdp-ctl with the DPDK data plane
    #[arg(long)]
    pub dpdk: bool,
    /// Build gdp-ctl with the storage of RIB replicas
    #[arg(long)]
    pub etcd: bool,
}

impl Features {
    /// Installs the packages that the features need.
    pub fn ensure(self) -> Result<()> {
        let purposes = [(self.dpdk, Purpose::Dpdk), (self.etcd, Purpose::Etcd)];
        purposes.into_iter().filter(|(is_wanted, _)| *is_wanted).try_for_each(|(_, purpose)| setup::ensure(purpose))
    }
}

/// The executables to build.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Executables {
    /// Only `gdp-ctl`, which is all that a switch needs.
    Switch,
    All,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Run)?;
    if options.ebpf_only {
        return ebpf();
    }
    options.features.ensure()?;
    let profile = match (options.checked, options.dist) {
        (true, _) => Profile::Checked,
        (_, true) => Profile::Dist,
        _ => Profile::Release,
    };
    executables(Executables::All, profile, options.features)
}

/// Builds executables that embed the XDP programs. Fails if the result does not contain them.
pub fn executables(which: Executables, profile: Profile, features: Features) -> Result<()> {
    ebpf()?;
    let mut command = shell::cargo();
    command.args(["build", "--profile", profile.name(), "--bin", SWITCH]);
    match which {
        // Builds only this package. Otherwise Cargo would also compile the dependencies' features
        // that other packages request.
        Executables::Switch => command.args(["--package", SWITCH]),
        Executables::All => command.args(["--bin", PROXY]),
    };
    if profile == Profile::Checked {
        // As the tests are built, so that nothing is compiled twice. Without a test among the
        // targets, Cargo would leave out the features that only tests ask of dependencies.
        command.args(["--workspace", "--features", workspace::FEATURES, "--test", "fixtures"]);
    }
    for (is_wanted, feature) in [(features.dpdk, "gdp-ctl/dpdk"), (features.etcd, "gdp-ctl/etcd")] {
        if is_wanted {
            command.args(["--features", feature]);
        }
    }
    shell::run(&mut command)?;
    ensure_embedded(&profile.executables().join(SWITCH))?;
    if profile == Profile::Checked {
        return Ok(());
    }
    let names: &[&str] = if which == Executables::Switch { &[SWITCH] } else { &[SWITCH, PROXY] };
    names.iter().try_for_each(|name| debug_symbols::split(&profile.executables().join(name)))
}

const SWITCH: &str = "gdp-ctl";
const PROXY: &str = "gdp-proxy";

/// Compiles `gdp-ebpf` with the compiler that [`EbpfCompiler`] finds. Copies the object to
/// [`workspace::ebpf_object`], and to the folder where the executables' build script looks for it.
pub fn ebpf() -> Result<()> {
    shell::run(&mut ebpf_cargo("build", "bpf")?)?;
    let built = workspace::target().join("bpf/bpfel-unknown-none/release/gdp-ebpf");
    copy_if_changed(&built, &workspace::ebpf_object())?;
    let embedded = fingerprint::object(workspace::root())?;
    let folder = workspace::root().join(fingerprint::FOLDER);
    for entry in std::fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let file = entry?.path();
        // Objects of earlier source versions.
        if file.extension().is_some_and(|extension| extension == "o") && file != embedded {
            std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
        }
    }
    copy_if_changed(&built, &embedded)
}

/// Compiles the XDP programs to different instructions, as a later release would have them. Tests
/// use them for a daemon that takes over. The object is beside [`workspace::ebpf_object`], as
/// `gdp-ebpf-rebuilt`.
pub fn ebpf_rebuilt() -> Result<()> {
    let mut command = ebpf_cargo("build", "bpf-rebuilt")?;
    shell::run(command.args(["--bin", "gdp-ebpf", "--config", "profile.release.opt-level=2"]))?;
    let built = workspace::target().join("bpf-rebuilt/bpfel-unknown-none/release/gdp-ebpf");
    copy_if_changed(&built, &workspace::ebpf_object().with_file_name("gdp-ebpf-rebuilt"))
}

/// Compiles the XDP programs with a hop tag without cost, for `bench forward`, to
/// [`workspace::ebpf_untagged_object`].
pub fn ebpf_untagged() -> Result<()> {
    shell::run(ebpf_cargo("build", "bpf")?.args(["--package", "gdp-ebpf-untagged"]))
}

/// Returns `cargo VERB --release` for the eBPF target in the eBPF workspace. The output goes to the
/// folder `into` of Cargo's target folder.
fn ebpf_cargo(verb: &str, into: &str) -> Result<Command> {
    let Some(compiler) = EbpfCompiler::find() else { bail!("no compiler for eBPF: run `cargo xtask setup run`") };
    let Some(linker) = setup::bpf_linker() else { bail!("no bpf-linker: run `cargo xtask setup run`") };
    // rustup's cargo, which accepts `+nightly`.
    let mut command = Program::Cargo.command();
    let linker = format!("linker={}", linker.display());
    let flags = ["-C", "target-cpu=v3", "-C", "debuginfo=2", "-C", "link-arg=--btf", "-C", &linker].join("\u{1f}");
    if compiler == EbpfCompiler::Nightly {
        command.arg("+nightly");
    }
    command
        .args([verb, "--release", "--target", "bpfel-unknown-none", "--target-dir"])
        .arg(workspace::target().join(into))
        .current_dir(workspace::root().join("gdp-ebpf"))
        .env("CARGO_ENCODED_RUSTFLAGS", format!("{flags}\u{1f}{}", remap::flags()?))
        .env_remove("RUSTUP_TOOLCHAIN");
    match compiler {
        EbpfCompiler::Debian => {
            // This is Debian's stable compiler. The crates use a few features that otherwise only
            // nightly has.
            command.env("RUSTC", "/usr/bin/rustc").env("RUSTC_BOOTSTRAP", "1");
        }
        EbpfCompiler::Nightly => {
            command.args(["-Z", "build-std=core"]).env_remove("RUSTC");
        }
    }
    Ok(command)
}

/// Runs the executable to check that it embeds the XDP programs, because Cargo does not report what
/// its build script did.
fn ensure_embedded(executable: &Path) -> Result<()> {
    let version = shell::output(own(executable).arg("--version"));
    let version = version.with_context(|| format!("{} does not tell its version", executable.display()))?;
    ensure!(version.ends_with("(with XDP)"), "{} was built without the XDP programs: {version}", executable.display());
    Ok(())
}

/// Replaces `to` atomically, so that a concurrent reader never sees an incomplete file.
fn copy_if_changed(from: &Path, to: &Path) -> Result<()> {
    let new = std::fs::read(from).with_context(|| format!("cannot read {}", from.display()))?;
    if std::fs::read(to).is_ok_and(|old| old == new) {
        return Ok(());
    }
    let folder = to.parent().context("the target has a folder")?;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let temporary = to.with_extension("new");
    std::fs::write(&temporary, new).with_context(|| format!("cannot write {}", temporary.display()))?;
    // Keeps the time of the source file, so that Cargo does not recompile the crates that embed it.
    let time = std::fs::metadata(from).and_then(|from| from.modified());
    let set = time.and_then(|time| std::fs::File::open(&temporary)?.set_modified(time));
    set.with_context(|| format!("cannot set the time of {}", temporary.display()))?;
    std::fs::rename(&temporary, to).with_context(|| format!("cannot replace {}", to.display()))
}
