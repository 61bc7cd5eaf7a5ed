//! `cargo xtask setup`: installs what this machine lacks, saying what and why before it acts.
//!
//! The table [`STEPS`] is all there is: to need something new, add a step. Other verbs call [`ensure`] with the parts
//! they need; when nothing is missing that costs a few file look-ups and prints nothing.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, bail};

use crate::{shell, workspace};

#[derive(clap::Args)]
pub struct Options {
    /// Only say what is missing, and how it would be installed
    #[arg(long)]
    dry_run: bool,
    /// Only what the DPDK data plane needs to be built and run
    #[arg(long)]
    dpdk: bool,
}

/// What a verb is about to do, and so what it needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Part {
    /// Compile the workspace.
    Workspace,
    /// Compile the XDP programs.
    Ebpf,
    /// Check formatting and lints.
    Lints,
    /// Build networks of namespaces.
    Namespaces,
    /// Compile and run the DPDK data plane.
    Dpdk,
    /// Run replicas of a RIB.
    Etcd,
    /// Run foreign DDS programs against ours.
    Dds,
    /// Compare messages with what another implementation makes of them.
    Rosbags,
    /// Run a ROS 1 master and rospy nodes against ours.
    Ros1,
    /// Run rclpy nodes against ours.
    Ros2,
    /// Compile the bridge that `bench ros` measures against; nothing else needs it.
    Zenoh,
}

pub fn run(options: Options) -> Result<()> {
    let all = [
        Part::Workspace,
        Part::Ebpf,
        Part::Lints,
        Part::Namespaces,
        Part::Dpdk,
        Part::Etcd,
        Part::Dds,
        Part::Rosbags,
        Part::Ros1,
        Part::Ros2,
    ];
    let missing = missing(if options.dpdk { &[Part::Workspace, Part::Dpdk] } else { &all });
    if missing.is_empty() {
        println!("Nothing to do: everything is installed.");
        return Ok(());
    }
    if options.dry_run {
        return announce(&missing);
    }
    install(&missing)
}

/// Installs what is missing of `parts`.
pub fn ensure(parts: &[Part]) -> Result<()> {
    let missing = missing(parts);
    if missing.is_empty() { Ok(()) } else { install(&missing) }
}

/// Whether all of `part` is there.
pub fn has(part: Part) -> bool {
    missing(&[part]).is_empty()
}

/// The compiler for the eBPF target. Compiler and `bpf-linker` must share an LLVM major, so each comes as a pair.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EbpfCompiler {
    /// Debian's `rustc-web` with the prebuilt `core` of `libstd-rust-web-dev-bpf` (LLVM 22).
    Debian,
    /// A rustup nightly with `rust-src`; `core` is built on the way.
    Nightly,
}

impl EbpfCompiler {
    pub fn find() -> Option<Self> {
        let debian = Path::new("/usr/lib/rustlib/bpfel-unknown-none/lib");
        if Path::new("/usr/bin/rustc").is_file() && debian.is_dir() {
            return Some(Self::Debian);
        }
        let toolchains = std::fs::read_dir(home("RUSTUP_HOME", ".rustup").join("toolchains")).ok()?;
        toolchains
            .flatten()
            .filter(|entry| entry.file_name().to_string_lossy().starts_with("nightly-"))
            .any(|entry| entry.path().join("lib/rustlib/src/rust/library/core").is_dir())
            .then_some(Self::Nightly)
    }
}

struct Step {
    part: Part,
    what: &'static str,
    why: &'static str,
    present: fn() -> bool,
    /// Shell commands for Debian 12, run as printed.
    debian: &'static [&'static str],
    /// What to do on a system this program does not know; only printed.
    elsewhere: &'static str,
}

const STEPS: &[Step] = &[
    Step {
        part: Part::Workspace,
        what: "a C and C++ compiler",
        why: "the cryptography (aws-lc) is C and assembly; the Fast DDS test peer is C++",
        present: || shell::which("cc").is_some() && shell::which("c++").is_some(),
        debian: &["apt-get install -y --no-install-recommends gcc g++ libc6-dev"],
        elsewhere: "install gcc and g++",
    },
    Step {
        part: Part::Lints,
        what: "rustfmt and clippy",
        why: "CI checks formatting and lints",
        present: || rust_component("cargo-fmt") && rust_component("cargo-clippy"),
        debian: &["rustup component add rustfmt clippy"],
        elsewhere: "rustup component add rustfmt clippy",
    },
    Step {
        part: Part::Ebpf,
        what: "a Rust compiler with `core` for bpfel-unknown-none",
        why: "rustup's stable toolchain cannot compile the XDP programs; Debian ships the prebuilt library",
        present: || EbpfCompiler::find().is_some(),
        debian: &["apt-get install -y --no-install-recommends rustc-web libstd-rust-web-dev-bpf"],
        elsewhere: "rustup toolchain install nightly --profile minimal --component rust-src",
    },
    Step {
        part: Part::Ebpf,
        what: "bpf-linker 0.13.0",
        why: "links the XDP programs; built against LLVM 22, the LLVM of the compiler above",
        present: bpf_linker_present,
        debian: &[
            "apt-get install -y --no-install-recommends llvm-22-dev",
            "LLVM_PREFIX=/usr/lib/llvm-22 cargo install bpf-linker --version 0.13.0 --no-default-features --features llvm-22 --locked",
        ],
        elsewhere: "cargo install bpf-linker --version 0.13.0 --locked   # its LLVM must be that of the eBPF compiler",
    },
    Step {
        part: Part::Namespaces,
        what: "iproute2, ethtool and nftables",
        why: "tests, demo and benchmarks build networks of namespaces and veth pairs, some of them behind NAT",
        present: || ["ip", "ethtool", "nft"].iter().all(|program| shell::which(program).is_some()),
        debian: &["apt-get install -y --no-install-recommends iproute2 ethtool nftables"],
        elsewhere: "install iproute2, ethtool and nftables",
    },
    Step {
        part: Part::Dpdk,
        what: "DPDK 22.11 with its headers, drivers and testpmd, and libclang",
        why: "the DPDK data plane is linked with it, bindgen reads its headers with libclang, and `bench forward` compares with testpmd",
        present: dpdk_present,
        debian: &["apt-get install -y --no-install-recommends dpdk libdpdk-dev pkg-config libclang-22-dev"],
        elsewhere: "install DPDK 22.11, 23.03 or 23.07 (headers, libraries, drivers, testpmd), pkg-config and libclang",
    },
    Step {
        part: Part::Etcd,
        what: "etcd and etcdctl",
        why: "tests run replicas of a RIB on clusters of their own; the service that Debian starts with it is not used",
        present: || shell::which("etcd").is_some() && shell::which("etcdctl").is_some(),
        debian: &["apt-get install -y --no-install-recommends etcd-server etcd-client"],
        elsewhere: "install etcd 3.4 or later, with etcdctl",
    },
    Step {
        part: Part::Dds,
        what: "Fast DDS with its IDL compiler",
        why: "one of the two DDS vendors that tests and demo run as unmodified applications",
        present: || Path::new("/usr/include/fastdds/dds").is_dir() && shell::which("fastddsgen").is_some(),
        debian: &["apt-get install -y --no-install-recommends libfastrtps-dev fastddsgen"],
        elsewhere: "install Fast DDS 2.9 or later (headers and library) and fastddsgen",
    },
    python(Part::Dds, "Cyclone DDS comes as a Python wheel, which Debian wants in an environment of its own"),
    Step {
        part: Part::Dds,
        what: "Cyclone DDS 11.0.1 in a Python environment under the target folder",
        why: "the other of the two DDS vendors",
        present: cyclone_present,
        debian: &[
            "/usr/bin/python3 -m venv \"$GDP_VENV\"",
            "\"$GDP_VENV/bin/pip\" install --quiet --disable-pip-version-check cyclonedds==11.0.1",
            "touch \"$GDP_VENV/gdp-cyclonedds-11.0.1\"",
        ],
        elsewhere: "python3 -m venv $GDP_VENV && $GDP_VENV/bin/pip install cyclonedds==11.0.1 && touch $GDP_VENV/gdp-cyclonedds-11.0.1",
    },
    python(Part::Rosbags, "rosbags comes as a Python wheel, which Debian wants in an environment of its own"),
    Step {
        part: Part::Rosbags,
        what: "rosbags 0.11.9 in a Python environment under the target folder",
        why: "tests compare messages of every ROS type with what it makes of them",
        present: || venv().join("gdp-rosbags-0.11.9").is_file(),
        debian: &[
            "/usr/bin/python3 -m venv \"$GDP_VENV\"",
            "\"$GDP_VENV/bin/pip\" install --quiet --disable-pip-version-check rosbags==0.11.9",
            "touch \"$GDP_VENV/gdp-rosbags-0.11.9\"",
        ],
        elsewhere: "python3 -m venv $GDP_VENV && $GDP_VENV/bin/pip install rosbags==0.11.9 && touch $GDP_VENV/gdp-rosbags-0.11.9",
    },
    Step {
        part: Part::Zenoh,
        what: "cmake and libclang",
        why: "the bridge that `bench ros` measures against contains Cyclone DDS, which is C; of LLVM 22, as the eBPF compiler",
        present: || shell::which("cmake").is_some() && has_libclang(),
        debian: &["apt-get install -y --no-install-recommends cmake libclang-22-dev"],
        elsewhere: "install cmake and libclang",
    },
    Step {
        part: Part::Zenoh,
        what: "openssl",
        why: "makes the certificates of that bridge",
        present: || shell::which("openssl").is_some(),
        debian: &["apt-get install -y --no-install-recommends openssl"],
        elsewhere: "install openssl",
    },
    Step {
        part: Part::Ros1,
        what: "rosmaster, rospy and the common message packages",
        why: "the master and the applications of ROS 1 that tests run; rospy needs netifaces, though its package only recommends it",
        present: ros1_present,
        debian: &[
            "apt-get install -y --no-install-recommends python3-rosmaster python3-rospy python3-netifaces rosout \
                   ros-std-msgs python3-std-msgs ros-sensor-msgs python3-sensor-msgs ros-std-srvs python3-std-srvs \
                   ros-geometry-msgs python3-geometry-msgs ros-tf2-msgs python3-tf2-msgs python3-rostopic python3-rosservice",
        ],
        elsewhere: "install ROS 1 Noetic's rosmaster, rospy, rostopic, rosservice, std_msgs, sensor_msgs, std_srvs, geometry_msgs and tf2_msgs for \
                    /usr/bin/python3, and netifaces",
    },
    python(Part::Ros2, "rclpy comes as Python wheels, which Debian wants in an environment of its own"),
    Step {
        part: Part::Ros2,
        what: "ROS 2 Kilted's rclpy on Fast DDS in a Python environment under the target folder",
        why: "applications of ROS 2 that tests run; its other middlewares are no wheels",
        present: || venv().join("gdp-rclpy-9.1.2").is_file(),
        debian: &[
            "/usr/bin/python3 -m venv \"$GDP_VENV\"",
            "\"$GDP_VENV/bin/pip\" install --quiet --disable-pip-version-check ros-rclpy==9.1.2 ros-rmw-fastrtps-cpp==9.3.3 \
                   ros-std-msgs==5.5.1 ros-std-srvs==5.5.1 ros-test-msgs==2.3.0",
            "touch \"$GDP_VENV/gdp-rclpy-9.1.2\"",
        ],
        elsewhere: "python3.11 -m venv $GDP_VENV && $GDP_VENV/bin/pip install ros-rclpy==9.1.2 ros-rmw-fastrtps-cpp==9.3.3 \
                    ros-std-msgs==5.5.1 ros-std-srvs==5.5.1 ros-test-msgs==2.3.0 && touch $GDP_VENV/gdp-rclpy-9.1.2",
    },
];

/// What the environment under the target folder is made with.
const fn python(part: Part, why: &'static str) -> Step {
    Step {
        part,
        what: "Python with its venv module",
        why,
        present: || venv().join("bin/pip").is_file() || Path::new("/usr/share/doc/python3-venv").is_dir(),
        debian: &["apt-get install -y --no-install-recommends python3-venv"],
        elsewhere: "install python3 with venv",
    }
}

fn missing(parts: &[Part]) -> Vec<&'static Step> {
    STEPS.iter().filter(|step| parts.contains(&step.part) && !(step.present)()).collect()
}

fn announce(missing: &[&Step]) -> Result<()> {
    eprintln!("Missing on this machine:");
    for step in missing {
        eprintln!("  {}: {}", step.what, step.why);
    }
    eprintln!("\nCommands (GDP_VENV={}):", venv().display());
    let known = is_debian_12();
    for step in missing {
        if known {
            commands(step).iter().for_each(|line| eprintln!("  {line}"));
        } else {
            eprintln!("  {}", step.elsewhere);
        }
    }
    Ok(())
}

fn install(missing: &[&Step]) -> Result<()> {
    announce(missing)?;
    if !is_debian_12() {
        bail!("this system is not Debian 12, so nothing was installed: run the commands above, then try again");
    }
    if missing.iter().any(|step| step.debian.iter().any(|line| line.contains("apt-get"))) {
        execute(&privileged("apt-get update -q"))?;
    }
    for step in missing {
        eprintln!("\n{} ({})", step.what, step.why);
        for line in commands(step) {
            execute(&line)?;
        }
        if !(step.present)() {
            bail!("{} is still missing after its commands succeeded", step.what);
        }
    }
    Ok(())
}

fn commands(step: &Step) -> Vec<String> {
    step.debian.iter().map(|line| privileged(line)).collect()
}

/// `apt-get` needs root; the rest must not have it.
fn privileged(line: &str) -> String {
    let prefix = if workspace::is_root() { "" } else { "sudo " };
    line.replace("apt-get ", &format!("{prefix}DEBIAN_FRONTEND=noninteractive apt-get "))
}

fn execute(line: &str) -> Result<()> {
    eprintln!("+ {line}");
    shell::run(Command::new("sh").args(["-ec", line]).env("GDP_VENV", venv()).current_dir(workspace::root()))
}

fn is_debian_12() -> bool {
    let release = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    let has = |line: &str| release.lines().any(|l| l.replace('"', "") == line);
    has("ID=debian") && has("VERSION_ID=12")
}

fn bpf_linker_present() -> bool {
    bpf_linker().is_some_and(|file| {
        shell::output_of(file, &["--version"]).is_some_and(|version| version.starts_with("bpf-linker 0.13."))
    })
}

/// `bpf-linker` on `PATH`, or where `cargo install` puts it.
pub fn bpf_linker() -> Option<PathBuf> {
    shell::which("bpf-linker")
        .or_else(|| Some(home("CARGO_HOME", ".cargo").join("bin/bpf-linker")).filter(|file| file.is_file()))
}

/// Components lie beside the cargo that runs us: asking rustup would take half a second.
fn rust_component(program: &str) -> bool {
    let beside = std::env::var_os("CARGO").and_then(|cargo| Some(Path::new(&cargo).parent()?.join(program).is_file()));
    beside.unwrap_or_else(|| shell::which(program).is_some())
}

fn home(variable: &str, default: &str) -> PathBuf {
    std::env::var_os(variable)
        .map(PathBuf::from)
        .unwrap_or_else(|| PathBuf::from(std::env::var_os("HOME").unwrap_or_default()).join(default))
}

/// The marker is made last, so that an installation that was cut off does not count.
fn cyclone_present() -> bool {
    venv().join("gdp-cyclonedds-11.0.1").is_file()
}

/// What Debian's packages contain, by their folders: asking Python would take a third of a second.
fn ros1_present() -> bool {
    let python = Path::new("/usr/lib/python3/dist-packages");
    let modules = [
        "rosmaster",
        "rospy",
        "rostopic",
        "rosservice",
        "std_msgs",
        "sensor_msgs",
        "std_srvs",
        "geometry_msgs",
        "tf2_msgs",
    ];
    let has_netifaces = || {
        let names = std::fs::read_dir(python).into_iter().flatten().flatten().map(|entry| entry.file_name());
        names.into_iter().any(|name| name.to_string_lossy().starts_with("netifaces."))
    };
    let shares = ["std_msgs", "sensor_msgs", "std_srvs", "geometry_msgs"];
    Path::new("/usr/bin/rosmaster").is_file()
        && modules.iter().all(|module| python.join(module).is_dir())
        && shares.iter().all(|package| Path::new("/usr/share").join(package).is_dir())
        && has_netifaces()
}

/// The headers, and what bindgen and the linker find them by.
fn dpdk_present() -> bool {
    let programs = ["pkg-config", "dpdk-testpmd"].iter().all(|program| shell::which(program).is_some());
    programs && has_libclang() && shell::output_of("pkg-config", &["--modversion", "libdpdk"]).is_some()
}

/// Where Debian's versions of LLVM lie.
fn has_libclang() -> bool {
    let versions = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
    versions.filter(|path| path.to_string_lossy().contains("/llvm-")).any(|path| path.join("lib/libclang.so").exists())
}

fn venv() -> PathBuf {
    workspace::target().join("venv")
}
