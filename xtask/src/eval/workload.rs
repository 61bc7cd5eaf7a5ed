//! The workloads of Table I: Python programs in `eval/`, one on the robot and one on the edge.

use gdp_tests::topics::FabricTopic;
use serde_json::Value;

/// What the robot asks of the edge.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
pub enum Workload {
    /// Visual SLAM: colour and depth images, back comes the camera's pose
    Slam,
    /// Motion planning: meshes and a goal, back comes a path
    Motion,
    /// Grasp planning with 5.6 MB
    Grasp,
    /// Grasp planning with 1.4 MB
    GraspSmall,
}

impl Workload {
    /// Returns the name that the programs know.
    pub fn name(self) -> &'static str {
        match self {
            Self::Slam => "slam",
            Self::Motion => "motion",
            Self::Grasp => "grasp",
            Self::GraspSmall => "grasp-small",
        }
    }

    pub fn describe(self) -> &'static str {
        match self {
            Self::Slam => "vSLAM, 1.5 MB at 10 Hz",
            Self::Motion => "motion planning, 0.2 MB",
            Self::Grasp => "grasp planning, 5.6 MB",
            Self::GraspSmall => "grasp planning, 1.4 MB",
        }
    }

    /// Says in a few words what the robot reports of its results.
    pub fn result(self, result: &Value) -> String {
        let number = |key: &str| result[key].as_f64().unwrap_or(f64::NAN);
        match self {
            Self::Slam => format!("{:.0} tracked, error {:.1} cm", number("tracked"), 100.0 * number("ate_m")),
            _ => format!("digest {:.8}", result["digest"].as_str().unwrap_or("none")),
        }
    }

    /// Returns whether the robot reports a useful result: most frames tracked within 0.3 m, a path,
    /// or a grasp.
    pub fn has_found(self, result: &Value) -> bool {
        let number = |key: &str| result[key].as_f64().unwrap_or(0.0);
        match self {
            Self::Slam => {
                let is_near = result["ate_m"].as_f64().is_some_and(|error| error < 0.3);
                is_near && number("tracked") >= 0.9 * number("frames")
            }
            Self::Motion => number("solved") > 0.0,
            Self::Grasp | Self::GraspSmall => number("grasps") > 0.0,
        }
    }

    /// What the paper's system adds to ROS 2, in milliseconds for both directions (its Table I).
    pub fn paper_adds(self) -> f64 {
        match self {
            Self::Slam => 14.0,
            Self::Motion => 15.0,
            Self::Grasp | Self::GraspSmall => 24.0,
        }
    }

    pub fn topics(self) -> &'static [FabricTopic] {
        const fn to_edge(topic: &'static str, kind: &'static str) -> FabricTopic {
            FabricTopic { topic, kind, from_robot: true, in_ros1: false }
        }
        const fn to_robot(topic: &'static str, kind: &'static str) -> FabricTopic {
            FabricTopic { topic, kind, from_robot: false, in_ros1: false }
        }
        const IMAGE: &str = "sensor_msgs/msg/Image";
        const POSE: &str = "geometry_msgs/msg/PoseStamped";
        match self {
            Self::Slam => {
                &const {
                    [
                        to_edge("/camera/color/image_raw", IMAGE),
                        to_edge("/camera/depth/image_raw", IMAGE),
                        to_robot("/slam/pose", POSE),
                    ]
                }
            }
            Self::Motion => {
                &const {
                    [
                        to_edge("/planner/scene", "visualization_msgs/msg/Marker"),
                        to_edge("/planner/goal", POSE),
                        to_robot("/planner/path", "nav_msgs/msg/Path"),
                    ]
                }
            }
            Self::Grasp | Self::GraspSmall => {
                &const {
                    [
                        to_edge("/grasp/depth", IMAGE),
                        to_edge("/grasp/color", IMAGE),
                        to_robot("/grasp/grasps", "geometry_msgs/msg/PoseArray"),
                    ]
                }
            }
        }
    }
}
