//! What proxies say to each other about services and actions, and the messages of actions that they
//! look into.

use bytes::Bytes;
use gdp_ros::action::cdr::{Canceling, Status, aborted, goal_of, is_accepted, result_status, status_array, statuses};
use gdp_ros::call::{Definitions, Description, Epoch, Event, Events, FailureCode, MAX_EVENTS, Part, Reply, Request};
use gdp_ros::roster::{Dialect, Kind};

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
    let _ = (goal_of(data), is_accepted(data), result_status(data));
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
    let others = [
        ("describe", Request::Describe.to_bytes()),
        ("a goal", Request::Call { epoch, part: Part::SendGoal, body }.to_bytes()),
        ("what is new", Request::Events { epoch, after: 2 }.to_bytes()),
        ("statuses", list.to_vec()),
        ("what is cancelled", canceling.write().to_vec()),
    ];
    replies.into_iter().chain(others).map(|(name, bytes)| (name.to_owned(), bytes)).collect()
}
