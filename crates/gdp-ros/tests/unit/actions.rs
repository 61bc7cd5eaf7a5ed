//! Unit tests of `actions`.

use super::*;

const FIBONACCI: &str = "example_interfaces/action/Fibonacci";
const GOAL: GoalId = [7; 16];

fn types() -> Types {
    Types::load([]).unwrap()
}

#[test]
fn messages_are_converted_both_ways() {
    let types = types().action(FIBONACCI, None).unwrap();
    assert_eq!(types.goal.name, "example_interfaces/FibonacciActionGoal");
    // As genpy computes them.
    assert_eq!(types.cancel.md5sum, "302881f31927c1df708a2dbab0e80ee8");
    assert_eq!(types.status.md5sum, "8b2b82f13216d0a8ea88bd3af735e619");
    let request = types.goal_to_ros2(&GOAL, &[5, 0, 0, 0]).unwrap();
    assert_eq!(request, [&[0, 1, 0, 0][..], &GOAL, &[5, 0, 0, 0]].concat());
    assert_eq!(types.goal_to_ros1(&request).unwrap(), [5, 0, 0, 0][..]);
    let (sequence, ros1) = ([2, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0], &[2, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0][..]);
    let feedback = types.feedback_to_ros2(&GOAL, ros1).unwrap();
    assert_eq!(feedback, [&[0, 1, 0, 0][..], &GOAL, &sequence].concat());
    assert_eq!(types.feedback_to_ros1(&feedback).unwrap(), ros1);
    let response = types.result_to_ros2(4, ros1).unwrap();
    assert_eq!(response, [&[0, 1, 0, 0, 4, 0, 0, 0][..], &sequence].concat());
    assert_eq!(types.result_to_ros1(&response).unwrap(), (4, Bytes::copy_from_slice(ros1)));
    assert_eq!(types.empty_result(), [0; 4][..]);
    for cut in 0..request.len() {
        assert!(types.goal_to_ros1(&request[..cut]).is_err(), "{cut}");
    }
}

#[test]
fn the_servers_proxy_announces_the_definitions() {
    let known = types().describe_action(FIBONACCI.into());
    assert_eq!(known.kind.hash.len(), 32);
    let mut definitions = known.definitions.unwrap();
    let unknown = "my_robot/action/Fibonacci";
    assert!(matches!(types().action(unknown, None), Err(TypeError::Action(_))));
    definitions.request = definitions.request.replace("example_interfaces", "my_robot");
    let made = types().action(unknown, Some(&definitions)).unwrap();
    assert_eq!(made.description.definitions, Some(definitions));
    assert_eq!(made.result.name, "my_robot/FibonacciActionResult");
    let nothing = types().describe_action(unknown.into());
    assert_eq!((nothing.definitions, nothing.kind.hash.len()), (None, 0));
    let wrong = Definitions { request: "no definition".into(), response: String::new() };
    assert!(types().action(unknown, Some(&wrong)).is_err());
}
