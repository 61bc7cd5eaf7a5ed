//! The names of remote nodes in the local ROS graph.

use crate::ros2::TopicName;

/// Returns the full name that a remote node has here, or an empty text if the node is unknown.
///
/// An imported name may have a prefix that distinguishes robots: what is `listed` as `/camera` is
/// `/robot7/camera` here. Then its node has the same prefix, by which its parameters are found.
pub fn local_node(local: &TopicName, listed: Option<&str>, node: &str) -> String {
    let prefix = listed.and_then(|listed| local.as_str().strip_suffix(listed)).unwrap_or_default();
    if node.is_empty() { String::new() } else { format!("{prefix}{node}") }
}

#[cfg(test)]
#[path = "../tests/unit/node_name.rs"]
mod tests;
