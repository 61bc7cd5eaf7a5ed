//! What proxies say to each other about services and actions, and the messages of actions that they
//! look into.

use std::sync::LazyLock;

use bytes::Bytes;
use gdp_e2e::seal::MessageId;
use gdp_ros::action::cdr::{
    Canceling, Status, aborted, cancel_of, goal_of, is_accepted, result_status, status_array, statuses,
};
use gdp_ros::actionlib::message;
use gdp_ros::actions::ActionTypes;
use gdp_ros::call::{Definitions, Description, Epoch, Event, Events, FailureCode, MAX_EVENTS, Part, Reply, Request};
use gdp_ros::roster::{Dialect, Kind};
use gdp_ros::types::Types;

/// What is taken for a request or a reply is its only encoding; what is taken for a message of an
/// action says the same when it is written by us.
pub fn call(data: &[u8]) {
    let bytes = Bytes::copy_from_slice(data);
    if let Ok(request) = Request::from_bytes(&bytes) {
        assert_eq!(request.to_bytes(), data);
    }
    if let Ok(reply) = Reply::from_bytes(&bytes) {
        assert_eq!(reply.to_bytes().expect("what was decoded"), data);
        assert!(!matches!(&reply, Reply::Events(events) if events.events.len() > MAX_EVENTS));
    }
    if let Ok(list) = statuses(data) {
        assert_eq!(statuses(&status_array(&list)), Ok(list));
    }
    if let Ok(canceling) = Canceling::read(data) {
        assert_eq!(Canceling::read(&canceling.write()), Ok(canceling));
    }
    let _ = (goal_of(data), is_accepted(data), result_status(data), cancel_of(data));
    actionlib(&bytes);
}

/// The same of what clients and servers of ROS 1 say, and what becomes of it for the other version.
fn actionlib(bytes: &Bytes) {
    let now = (1, 2);
    if let Ok(list) = message::read_statuses(bytes) {
        assert_eq!(message::read_statuses(&message::write_statuses(now, &list)), Ok(list));
    }
    if let Ok(goal) = message::read_cancel(bytes) {
        assert_eq!(message::read_cancel(&message::write_cancel(&goal)), Ok(goal));
    }
    if let Ok((goal, body)) = message::read_goal(bytes) {
        assert_eq!(message::read_goal(&message::write_goal(now, &goal, &body)), Ok((goal, body)));
    }
    if let Ok((status, body)) = message::read_update(bytes) {
        assert_eq!(message::read_update(&message::write_update(now, &status, &body)), Ok((status, body)));
    }
    static TYPES: LazyLock<ActionTypes> = LazyLock::new(|| {
        let types = Types::load([]).expect("the embedded definitions");
        types.action("tf2_msgs/action/LookupTransform", None).expect("an embedded action")
    });
    if let Ok(goal) = TYPES.goal_to_ros1(bytes) {
        TYPES.goal_to_ros2(&[9; 16], &goal).expect("what was converted");
    }
    if let Ok(feedback) = TYPES.feedback_to_ros1(bytes) {
        TYPES.feedback_to_ros2(&[9; 16], &feedback).expect("what was converted");
    }
    if let Ok((status, result)) = TYPES.result_to_ros1(bytes) {
        TYPES.result_to_ros2(status, &result).expect("what was converted");
    }
    let _ = (TYPES.goal_to_ros2(&[9; 16], bytes), TYPES.result_to_ros2(4, bytes));
}

pub fn seeds() -> Vec<(String, Vec<u8>)> {
    let (epoch, body) = (Epoch(7), aborted().slice(..40));
    let status = Status { goal: [9; 16], stamp: (1, 2), status: 2 };
    let list = status_array(&[status, Status { status: 6, ..status }]);
    let kind = Kind { dialect: Dialect::Ros1, name: "std_srvs/SetBool".into(), hash: vec![3; 16] };
    let definitions = Definitions { request: "bool data\n".into(), response: "bool success\nstring message\n".into() };
    let description = Description { kind, node: String::new(), definitions: Some(definitions) };
    let events = vec![Event::Feedback(body.clone()), Event::Status(list.clone())];
    let replies = [
        ("a description", Reply::Description(epoch, description)),
        ("an answer", Reply::Answer(body.clone())),
        ("a failure", Reply::failure(FailureCode::Refused, "it stays on")),
        ("events", Reply::Events(Events { last: 2, dropped: 1, events })),
    ];
    let replies = replies.map(|(name, reply)| (name, reply.to_bytes().expect("a reply")));
    let canceling = Canceling { code: 0, goals: vec![([9; 16], (1, 2))] };
    let goal = message::GoalId { stamp: (1, 2), id: "/client-1-1.000".into() };
    let status = message::GoalStatus { goal: goal.clone(), status: 1, text: "under way".into() };
    let others = [
        ("a goal of ROS 1", message::write_goal((1, 2), &goal, &[0; 40]).to_vec()),
        ("feedback of ROS 1", message::write_update((1, 2), &status, &[]).to_vec()),
        ("statuses of ROS 1", message::write_statuses((1, 2), &[status]).to_vec()),
        ("a cancellation of ROS 1", message::write_cancel(&goal).to_vec()),
        ("describe", Request::Describe.to_bytes()),
        ("a goal", Request::Call { epoch, part: Part::SendGoal, body }.to_bytes()),
        ("what is new", Request::Events { epoch, after: 2 }.to_bytes()),
        ("no longer needed", Request::Cancel(MessageId { session: [7; 16], sequence: 2 }).to_bytes()),
        ("statuses", list.to_vec()),
        ("what is cancelled", canceling.write().to_vec()),
    ];
    replies.into_iter().chain(others).map(|(name, bytes)| (name.to_owned(), bytes)).collect()
}
