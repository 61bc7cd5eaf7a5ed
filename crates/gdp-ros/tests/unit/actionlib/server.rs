//! Unit tests of `actionlib::server`.

use super::*;

fn goal(number: u8) -> GoalId {
    [number; 16]
}

fn id(text: &str, seconds: u32) -> message::GoalId {
    message::GoalId { stamp: (seconds, 0), id: text.into() }
}

/// A server with these goals, all sent; with the time of them.
fn with(goals: &[(&str, u8)]) -> (GoalServer, Instant) {
    let (mut server, now) = (GoalServer::default(), Instant::now());
    for (text, number) in goals {
        assert_eq!(server.take_goal(id(text, u32::from(*number)), goal(*number)), Taken::New);
        server.send(goal(*number), Bytes::new());
    }
    assert_eq!(asked(&mut server).len(), goals.len());
    (server, now)
}

fn asked(server: &mut GoalServer) -> Vec<(Part, u8)> {
    std::iter::from_fn(|| server.next_ask()).map(|ask| (ask.part, ask.goal[0])).collect()
}

fn said(number: u8, status: i8) -> Status {
    Status { goal: goal(number), stamp: (0, 0), status }
}

#[test]
fn a_goal_passes_through_the_statuses_of_actionlib() {
    let (mut server, now) = with(&[("a", 1)]);
    let shown = |server: &GoalServer| server.list().iter().map(|status| status.status).collect::<Vec<_>>();
    assert_eq!(server.take_goal(id("a", 1), goal(2)), Taken::Known);
    assert_eq!(shown(&server), [status::PENDING]);
    server.accepted(&goal(1));
    assert_eq!(asked(&mut server), [(Part::GetResult, 1)]);
    assert!(server.take_statuses(now, &[said(1, 2)]).1);
    assert_eq!(shown(&server), [status::ACTIVE]);
    assert!(!server.take_statuses(now, &[said(1, 1), said(9, 2)]).1, "not back, and nothing of others");
    // The result waits for the feedback, which comes before the end in the list.
    assert_eq!(server.take_result(now, &goal(1), 4, Bytes::from_static(b"r")), None);
    assert!(server.live(&goal(1)).is_some() && server.due(now).is_empty());
    let (ended, _) = server.take_statuses(now, &[said(1, 4)]);
    assert_eq!((ended[0].status.status, ended[0].result.as_deref()), (status::SUCCEEDED, Some(&b"r"[..])));
    assert!(server.live(&goal(1)).is_none() && shown(&server) == [status::SUCCEEDED]);
    assert_eq!(server.take_result(now, &goal(1), 4, Bytes::new()), None, "once");
    assert!(!server.sweep(now) && server.sweep(now + LISTED));
    assert!(server.list().is_empty() && server.ids.is_empty());
}

#[test]
fn a_result_does_not_wait_for_ever_and_not_for_a_list_that_came_before() {
    let (mut server, now) = with(&[("a", 1), ("b", 2)]);
    server.take_result(now, &goal(1), 5, Bytes::new());
    let ended = server.due(now + WAIT);
    assert_eq!((ended.len(), ended[0].status.status), (1, status::PREEMPTED));
    assert!(server.take_statuses(now, &[said(2, 6)]).0.is_empty());
    assert_eq!(server.take_result(now, &goal(2), 0, Bytes::new()).unwrap().status.status, status::ABORTED);
}

#[test]
fn a_goal_is_rejected_with_a_text() {
    let (mut server, now) = with(&[("a", 1)]);
    let ended = server.end(now, &goal(1), status::REJECTED, "no").unwrap();
    assert_eq!((ended.status.status, ended.status.text.as_str(), ended.result), (status::REJECTED, "no", None));
    assert!(server.end(now, &goal(1), status::ABORTED, "").is_none());
}

#[test]
fn all_goals_end_with_the_server() {
    let (mut server, now) = with(&[("a", 1), ("b", 2)]);
    server.accepted(&goal(1));
    assert_eq!(server.end_all(now, status::ABORTED, "gone").len(), 2);
    assert!(server.next_ask().is_none() && server.end_all(now, status::ABORTED, "gone").is_empty());
}

#[test]
fn cancellations_are_by_id_by_time_or_of_all() {
    let (mut server, now) = with(&[("a", 1), ("b", 2), ("c", 3)]);
    for number in 1..=2 {
        server.accepted(&goal(number));
    }
    asked(&mut server);
    server.cancel(now, id("a", 0));
    server.cancel(now, id("a", 0));
    assert_eq!(asked(&mut server), [(Part::CancelGoal, 1)]);
    server.cancel(now, id("", 2));
    assert_eq!(asked(&mut server), [(Part::CancelGoal, 1), (Part::CancelGoal, 2)]);
    server.cancel(now, id("", 0));
    assert_eq!(asked(&mut server), [(Part::CancelGoal, 0)]);
    // The third was not accepted yet.
    server.accepted(&goal(3));
    assert_eq!(asked(&mut server), [(Part::GetResult, 3), (Part::CancelGoal, 3)]);
}

#[test]
fn a_goal_that_was_canceled_before_it_came_is_recalled() {
    let (mut server, now) = with(&[]);
    server.cancel(now, id("a", 0));
    server.cancel(now, id("", 5));
    for (text, seconds, recalled) in [("a", 9, true), ("a", 9, false), ("b", 5, true), ("c", 6, false), ("d", 0, false)]
    {
        match server.take_goal(id(text, seconds), [seconds as u8; 16]) {
            Taken::Ended(ended) => assert!(recalled && ended.status.status == status::RECALLED, "{text}"),
            Taken::New => assert!(!recalled, "{text}"),
            Taken::Known => panic!("{text}"),
        }
    }
    for number in 0..2 * MAX_RECALLED {
        server.cancel(now, id(&format!("later{number}"), 0));
    }
    assert_eq!(server.recalled.len(), MAX_RECALLED);
    server.sweep(now + LISTED);
    assert!(server.recalled.is_empty());
}

#[test]
fn goals_are_bounded() {
    let (mut server, now) = with(&[]);
    let new = |number: usize| (id(&number.to_string(), 0), (number as u128 + 1).to_be_bytes());
    for number in 0..MAX_SERVED {
        let (id, goal) = new(number);
        assert_eq!(server.take_goal(id, goal), Taken::New);
    }
    let (id, goal) = new(MAX_SERVED);
    let Taken::Ended(ended) = server.take_goal(id.clone(), goal) else { panic!("a place for one more") };
    assert_eq!(ended.status.status, status::REJECTED);
    server.end(now, &new(0).1, status::ABORTED, "");
    assert_eq!(server.take_goal(id, goal), Taken::New);
    assert_eq!((server.goals.len(), server.ids.len()), (MAX_SERVED, MAX_SERVED));
}
