//! Unit tests of `config`.

use super::*;

#[test]
fn the_environment_is_read_as_ros_reads_it() {
    for (variables, host, bind) in [
        (&[][..], "robot7", "0.0.0.0"),
        (&[("ROS_IP", "10.0.0.7")], "10.0.0.7", "0.0.0.0"),
        (&[("ROS_IP", "10.0.0.7"), ("ROS_HOSTNAME", "robot")], "robot", "0.0.0.0"),
        (&[("ROS_HOSTNAME", ""), ("ROS_IP", "127.0.0.2")], "127.0.0.2", "127.0.0.2"),
        (&[("ROS_HOSTNAME", "localhost")], "localhost", "127.0.0.1"),
        (&[("ROS_IP", "::1")], "::1", "::1"),
        (&[("ROS_IP", "fd00::7"), ("ROS_IPV6", "on")], "fd00::7", "::"),
    ] {
        let variable = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned());
        let config = NodeConfig::from_variables("/n", variable, "robot7");
        assert_eq!((config.host.as_str(), config.bind), (host, bind.parse().unwrap()), "{variables:?}");
        assert_eq!(config.master_uri, "http://localhost:11311/");
    }
}

#[test]
fn addresses_of_version_6_stand_in_brackets() {
    let variable = |name: &str| (name == "ROS_IP").then(|| "fd00::7".to_owned());
    let config = NodeConfig::from_variables("/n", variable, "");
    assert_eq!(config.uri("http", 80), "http://[fd00::7]:80");
}
