//! Unit tests of `action::cdr`.

use super::*;
use gdp_msg::{Dialect, Encoding, Mapping, Options, Registry, Schema, TypeName};

/// What the transcoder, which is tested against other implementations, makes of JSON.
fn cdr(kind: &str, json: &str, encoding: Encoding) -> Vec<u8> {
    let schema = Schema::resolve(&Registry::embedded(), Dialect::Ros2, &TypeName::parse(kind).unwrap()).unwrap();
    let (mapping, mut bytes) = (Mapping::within(&schema, Encoding::Json, encoding).unwrap(), Vec::new());
    mapping.transcode(json.as_bytes(), &mut bytes, &Options::default()).unwrap();
    bytes
}

fn goal(number: u8, stamp: (i32, u32)) -> String {
    let id: Vec<String> = (0..16).map(|i| (number + i).to_string()).collect();
    let (seconds, nanoseconds) = stamp;
    format!(r#"{{"goal_id":{{"uuid":[{}]}},"stamp":{{"sec":{seconds},"nanosec":{nanoseconds}}}}}"#, id.join(","))
}

fn id(number: u8) -> GoalId {
    std::array::from_fn(|i| number + i as u8)
}

#[test]
fn statuses_are_read_and_written_as_ros_lays_them_out() {
    let expected: Vec<Status> = [(1, (5, 6), 2), (40, (-7, 8), 4), (90, (9, 10), -1)]
        .map(|(number, stamp, status)| Status { goal: id(number), stamp, status })
        .into();
    let list = [(1, (5, 6), 2), (40, (-7, 8), 4), (90, (9, 10), -1)]
        .map(|(number, stamp, status)| format!(r#"{{"goal_info":{},"status":{status}}}"#, goal(number, stamp)));
    let json = format!(r#"{{"status_list":[{}]}}"#, list.join(","));
    for encoding in [Encoding::Cdr, Encoding::CdrBigEndian] {
        assert_eq!(statuses(&cdr("action_msgs/msg/GoalStatusArray", &json, encoding)).unwrap(), expected);
    }
    let written = status_array(&expected);
    let exact = cdr("action_msgs/msg/GoalStatusArray", &json, Encoding::Cdr);
    assert_eq!(written[..exact.len()], exact);
    assert!(written.len() - exact.len() < 4 && expected[1].is_final() && !expected[0].is_final());
    for end in 0..exact.len() {
        assert_eq!(statuses(&exact[..end]), Err(Malformed), "{end}");
    }
}

#[test]
fn answers_about_cancelling_are_read_written_and_merged() {
    let json = format!(r#"{{"return_code":0,"goals_canceling":[{},{}]}}"#, goal(1, (5, 6)), goal(2, (7, 8)));
    let exact = cdr("action_msgs/srv/CancelGoal_Response", &json, Encoding::Cdr);
    let read = Canceling::read(&exact).unwrap();
    assert_eq!(read, Canceling { code: 0, goals: vec![(id(1), (5, 6)), (id(2), (7, 8))] });
    assert_eq!(read.write(), exact);
    let none = Canceling { code: 2, goals: vec![] };
    let other = Canceling { code: 0, goals: vec![(id(3), (0, 0))] };
    let merged = Canceling::merge([none.clone(), read, other]).unwrap();
    assert_eq!((merged.code, merged.goals.len()), (0, 3));
    assert_eq!(Canceling::merge([none.clone(), none.clone()]), Some(none));
    assert_eq!(Canceling::merge([]), None);
}

#[test]
fn goals_are_found_where_messages_begin() {
    let request =
        cdr("action_msgs/srv/CancelGoal_Request", &format!(r#"{{"goal_info":{}}}"#, goal(9, (1, 2))), Encoding::Cdr);
    assert_eq!(goal_of(&request), Ok(id(9)));
    assert_eq!(goal_of(&request[..19]), Err(Malformed));
    assert_eq!(goal_of(&[&[1, 1, 0, 0][..], &[0; 16]].concat()), Err(Malformed), "another encapsulation");
    assert_eq!((is_accepted(&[0, 1, 0, 0, 1]), is_accepted(&[0, 1, 0, 0])), (Ok(true), Err(Malformed)));
    assert_eq!(result_status(&[0, 1, 0, 0, 6, 0, 0, 0]), Ok(ABORTED));
}

#[test]
fn refusals_are_what_ros_makes_of_them() {
    assert_eq!(rejected(), [&[0, 1, 0, 0][..], &[0; 12]].concat());
    assert_eq!(Canceling::read(&not_canceling()), Ok(Canceling { code: 1, goals: vec![] }));
    assert_eq!((result_status(&aborted()), is_accepted(&rejected())), (Ok(ABORTED), Ok(false)));
}

#[test]
fn lengths_that_nothing_follows_are_refused() {
    for count in [1, 4096, 4097, u32::MAX] {
        let message = [&[0, 1, 0, 0][..], &count.to_le_bytes()].concat();
        assert_eq!(statuses(&message), Err(Malformed), "{count}");
    }
}

#[test]
fn requests_about_goals_are_laid_out_as_ros_does_it() {
    let goal = [7; 16];
    assert_eq!(result_request(&goal), [&[0, 1, 0, 0][..], &goal].concat());
    let request = cancel_request(&goal);
    assert_eq!(request, [&[0, 1, 0, 0][..], &goal, &[0; 8]].concat());
    assert_eq!(cancel_of(&request), Ok((goal, (0, 0))));
    assert_eq!(cancel_of(&request[..27]), Err(Malformed));
    assert_eq!(accepted((3, 4)), [0, 1, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, 4, 0, 0, 0][..]);
    assert_eq!((is_accepted(&accepted((3, 4))), result_status(&unknown())), (Ok(true), Ok(UNKNOWN)));
}
