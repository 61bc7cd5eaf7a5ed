//! Unit tests of `ros2::range`.

use super::*;

#[test]
fn the_environment_is_read_as_ros_reads_it() {
    let read = |only: &str, range: &str| {
        Range::from_variables(|variable| match variable {
            "ROS_LOCALHOST_ONLY" => Some(only.to_owned()),
            _ => Some(range.to_owned()),
        })
    };
    assert_eq!(Range::from_variables(|_| None), Ok(Range::Subnet));
    for (only, range, expected) in [
        ("0", "LOCALHOST", Range::Localhost),
        ("1", "SUBNET", Range::Localhost),
        ("", "SUBNET", Range::Subnet),
        ("0", "SYSTEM_DEFAULT", Range::Subnet),
        ("0", "", Range::Subnet),
    ] {
        assert_eq!(read(only, range), Ok(expected), "{only} {range}");
    }
    assert_eq!(read("0", "OFF"), Err(RangeError::Off));
    assert!(read("0", "localhost").unwrap_err().to_string().contains("\"localhost\""));
}

#[test]
fn static_peers_are_addresses_or_hosts() {
    let peers = |range, text: &str| static_peers(range, |_| Some(text.to_owned()));
    let address = |text: &str| text.parse::<IpAddr>().unwrap();
    assert!(static_peers(Range::Subnet, |_| None).is_empty());
    let both = peers(Range::Subnet, "192.0.2.7; localhost;; ::1; 192.0.2.7");
    assert_eq!(both, [address("127.0.0.1"), address("192.0.2.7")]);
    assert!(peers(Range::Localhost, "192.0.2.7").is_empty());
    let many: String = (0..70).map(|i| format!("192.0.2.{i};")).collect();
    assert_eq!(peers(Range::Subnet, &many).len(), MAX_PEERS);
}
