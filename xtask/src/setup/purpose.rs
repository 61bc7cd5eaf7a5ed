//! The parts of this project's needs, and the purposes that ask for them.

use clap::ValueEnum;

/// What a verb is about to do.
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
    /// Show the fabric at work
    Demo,
    /// Measure
    Bench,
    /// Do on a clean Debian root what a new machine does
    Fresh,
    /// Do what `.ci/run` does
    Ci,
}

/// What is installed together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SetupPart {
    /// Compile the workspace.
    Workspace,
    /// Compile the XDP programs.
    Ebpf,
    /// Check formatting and lints.
    Lints,
    /// Look at the tree as a repository.
    Git,
    /// Build networks of namespaces.
    Namespaces,
    /// Compile and run the DPDK data plane.
    Dpdk,
    /// Run replicas of a RIB.
    Etcd,
    /// Compile the client of etcd.
    EtcdClient,
    /// Run foreign DDS programs against ours.
    Dds,
    /// Compare messages with those that another implementation makes.
    Rosbags,
    /// Run a ROS 1 master and rospy nodes against ours.
    Ros1,
    /// Run rclpy nodes against ours.
    Ros2,
    /// Compile the bridge that `bench ros` measures against.
    Zenoh,
    /// Make a clean Debian root.
    Fresh,
}

impl Purpose {
    pub const fn parts(self) -> &'static [SetupPart] {
        use SetupPart::{
            Dds, Dpdk, Ebpf, Etcd, EtcdClient, Fresh, Git, Lints, Namespaces, Ros1, Ros2, Rosbags, Workspace, Zenoh,
        };
        match self {
            Self::Run => &[Workspace, Ebpf],
            Self::Dpdk => &[Workspace, Dpdk],
            Self::Etcd => &[Workspace, EtcdClient],
            Self::Unit => &[Workspace, Git, Etcd, EtcdClient, Dds, Rosbags, Ros1, Ros2],
            Self::Test => &[Workspace, Git, Ebpf, Namespaces, Dpdk, Etcd, EtcdClient, Dds, Rosbags, Ros1, Ros2],
            Self::Demo => &[Workspace, Ebpf, Namespaces, Dds],
            Self::Bench => &[Workspace, Ebpf, Namespaces, Dpdk, EtcdClient, Dds, Zenoh],
            Self::Fresh => &[Fresh, Git, Namespaces],
            Self::Ci => {
                &[Workspace, Git, Ebpf, Lints, Namespaces, Dpdk, Etcd, EtcdClient, Dds, Rosbags, Ros1, Ros2, Fresh]
            }
        }
    }
}
