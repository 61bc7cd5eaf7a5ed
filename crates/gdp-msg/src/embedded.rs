//! Embeds the definitions of the common interfaces, so that these types need no files.
//! `definitions/README.md` lists their sources.

use std::sync::LazyLock;

use crate::dialect::Dialect;
use crate::name::{InterfaceKind, TypeName};
use crate::registry::Registry;

macro_rules! packages {
    ($dialect:literal: $($package:literal)*) => {
        &[$(($package, include_str!(concat!("../definitions/", $dialect, "/", $package, ".txt")))),*]
    };
}

/// The packages of ROS 1 Noetic.
const ROS1: &[(&str, &str)] = packages!("ros1":
    "actionlib_msgs" "diagnostic_msgs" "geometry_msgs" "nav_msgs" "rosgraph_msgs" "sensor_msgs" "shape_msgs" "std_msgs" "std_srvs"
    "stereo_msgs" "tf" "tf2_msgs" "trajectory_msgs" "visualization_msgs"
);

/// The packages of ROS 2 Kilted. Definitions that Jazzy has too are Jazzy's.
const ROS2: &[(&str, &str)] = packages!("ros2":
    "action_msgs" "actionlib_msgs" "builtin_interfaces" "diagnostic_msgs" "example_interfaces" "geometry_msgs" "lifecycle_msgs"
    "nav_msgs" "rcl_interfaces" "rosgraph_msgs" "sensor_msgs" "service_msgs" "shape_msgs" "std_msgs" "std_srvs" "stereo_msgs"
    "tf2_msgs" "trajectory_msgs" "type_description_interfaces" "unique_identifier_msgs" "visualization_msgs"
);

static REGISTRY: LazyLock<Registry> = LazyLock::new(|| {
    let mut registry = Registry::default();
    for (dialect, packages) in [(Dialect::Ros1, ROS1), (Dialect::Ros2, ROS2)] {
        for (package, text) in packages {
            for section in text.split("=== ").skip(1) {
                let (head, body) = section.split_once('\n').expect("a section has a head");
                let (kind, name) = head.split_once('/').expect("a head has a kind");
                let kind = InterfaceKind::from_folder(kind).expect("a kind");
                let name = TypeName::new(package, kind, name).expect("a name");
                registry.add_file(dialect, &name, body).expect("a definition");
            }
        }
    }
    registry
});

impl Registry {
    /// Returns a registry with the common interfaces of ROS 1 Noetic, ROS 2 Jazzy and ROS 2 Kilted.
    pub fn embedded() -> Self {
        REGISTRY.clone()
    }
}

#[cfg(test)]
#[path = "../tests/unit/embedded.rs"]
mod tests;
