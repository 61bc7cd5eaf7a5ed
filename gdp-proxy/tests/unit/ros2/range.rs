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
    assert_eq!(static_peers(Range::Subnet, |_| None), Ok(vec![]));
    assert_eq!(peers(Range::Localhost, " ; "), Ok(vec![]));
    let both = peers(Range::Subnet, "192.0.2.7; localhost");
    assert_eq!(both, Ok(vec![address("192.0.2.7"), address("127.0.0.1")]));
    assert_eq!(peers(Range::Localhost, "192.0.2.7"), Err(RangeError::PeersBeyond));
    assert_eq!(peers(Range::Subnet, "::1"), Err(RangeError::Peer("::1".into())));
    assert_eq!(peers(Range::Subnet, &"192.0.2.7;".repeat(65)), Err(RangeError::TooManyPeers(65)));
}
