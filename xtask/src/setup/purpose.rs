//! The parts of setup, and the purposes that need them.

use clap::ValueEnum;

/// The purpose of a verb, or of a machine.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub enum Purpose {
    /// Build and run a switch with XDP
    Run,
    /// Build and run a switch with DPDK
    Dpdk,
    /// Build a switch whose RIB has replicas
    Etcd,
    /// Run the tests that need no root
    Unit,
    /// Run all tests
    Test,
    /// Run the demo of the fabric
    Demo,
    /// Run the benchmarks
    Bench,
    /// Make the paper's evaluation again
    Eval,
    /// Measure between own machines
    FieldReport,
    /// Check what the tree depends on
    Deny,
    /// Make packages, and check them
    Package,
    /// Make packages for an old glibc, and for arm64
    Release,
    /// Run unit tests of arm64 on another architecture
    Arm64,
    /// Check the SDK for Windows and macOS
    Portable,
    /// Boot the packages in a virtual machine
    Boot,
    /// Test setup and build on a clean Debian root
    Fresh,
    /// Check the models of the protocols
    Models,
    /// Run `.ci/run`
    Ci,
}

/// A group of steps that are installed together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SetupPart {
    /// Compile the workspace.
    Workspace,
    /// Compile the XDP programs.
    Ebpf,
    /// Check formatting and lints.
    Lints,
    /// Check licences and sources of dependencies.
    Deny,
    /// List the tracked files, and use the tree as a repository.
    Git,
    /// Build networks of namespaces.
    Namespaces,
    /// Compile and run the DPDK data plane.
    Dpdk,
    /// Run replicas of a RIB.
    Etcd,
    /// Check metrics and alert rules.
    Promtool,
    /// Compile the client of etcd.
    EtcdClient,
    /// Run foreign DDS programs against this project's.
    Dds,
    /// Compare messages with those of another implementation.
    Rosbags,
    /// Run a ROS 1 master and rospy nodes against this project's.
    Ros1,
    /// Run rclpy nodes against this project's.
    Ros2,
    /// Test the package for Python.
    Python,
    /// Look at web pages as a browser does.
    Browser,
    /// Compile the bridge that `bench ros` measures against.
    Zenoh,
    /// Run the simplest workload of the evaluation.
    Echo,
    /// Run the others.
    Eval,
    /// Compress archives.
    Archives,
    /// Write and check packages.
    Packages,
    /// Compile for an old glibc.
    Zig,
    /// Compile for arm64.
    StdArm64,
    /// Run programs of arm64.
    Qemu,
    /// Check for Windows and macOS.
    OtherSystems,
    /// Check models of protocols.
    Verifpal,
    /// Boot a virtual machine.
    Machine,
    /// Make a clean Debian root.
    Fresh,
}

impl Purpose {
    pub const fn parts(self) -> &'static [SetupPart] {
        use SetupPart::{
            Archives, Browser, Dds, Deny, Dpdk, Ebpf, Echo, Etcd, EtcdClient, Eval, Fresh, Git, Lints, Machine,
            Namespaces, OtherSystems, Packages, Promtool, Python, Qemu, Ros1, Ros2, Rosbags, StdArm64, Verifpal,
            Workspace, Zenoh, Zig,
        };
        match self {
            Self::Run => &[Workspace, Ebpf],
            Self::Dpdk => &[Workspace, Dpdk],
            Self::Etcd => &[Workspace, EtcdClient],
            Self::Unit => {
                &[Workspace, Git, Deny, Archives, Promtool, Etcd, EtcdClient, Dds, Rosbags, Ros1, Ros2, Browser]
            }
            Self::Test => &[
                Workspace, Git, Deny, Archives, Promtool, Ebpf, Namespaces, Dpdk, Etcd, EtcdClient, Dds, Rosbags, Ros1,
                Ros2, Python, Browser,
            ],
            Self::Demo => &[Workspace, Ebpf, Namespaces, Dds],
            Self::Bench => &[Workspace, Ebpf, Namespaces, Dpdk, EtcdClient, Dds, Ros2, Zenoh],
            Self::Eval => &[Workspace, Ebpf, Namespaces, Dds, Ros1, Echo, Eval],
            Self::FieldReport => &[Workspace, Ebpf, Namespaces, Echo],
            Self::Deny => &[Workspace, Git, Deny],
            Self::Package => &[Workspace, Git, Ebpf, Archives, Packages],
            Self::Release => &[Workspace, Git, Ebpf, Archives, Packages, Zig, StdArm64],
            Self::Arm64 => &[Workspace, StdArm64, Qemu],
            Self::Portable => &[Workspace, Lints, OtherSystems],
            Self::Boot => &[Workspace, Git, Ebpf, Archives, Packages, Fresh, Machine],
            Self::Fresh => &[Fresh, Git, Namespaces],
            Self::Models => &[Verifpal],
            Self::Ci => &[
                Workspace,
                Git,
                Deny,
                Archives,
                Promtool,
                Ebpf,
                Lints,
                Namespaces,
                Dpdk,
                Etcd,
                EtcdClient,
                Dds,
                Rosbags,
                Ros1,
                Ros2,
                Python,
                Browser,
                Eval,
                Fresh,
                Packages,
                StdArm64,
                Qemu,
                OtherSystems,
                Verifpal,
            ],
        }
    }
}
