//! Unit tests of `actionlib::client`.

use super::*;

fn goal(number: u8) -> GoalId {
    [number; 16]
}

fn named(client: &GoalClient, number: u8, status: u8) -> GoalStatus {
    let id = message::GoalId { stamp: (number.into(), 0), id: client.id(&goal(number)) };
    GoalStatus { goal: id, status, text: String::new() }
}

fn begun(numbers: &[u8], now: Instant) -> GoalClient {
    let mut client = GoalClient::new("/gdp_proxy_a");
    for number in numbers {
        let sent = client.begin(now, goal(*number)).unwrap();
        assert_eq!(sent, message::GoalId { stamp: (0, 0), id: client.id(&goal(*number)) });
    }
    client
}

#[test]
fn a_goal_is_accepted_when_the_server_names_it_and_ends_with_its_result() {
    let now = Instant::now();
    let mut client = begun(&[1, 2], now);
    assert_eq!(client.begin(now, goal(1)), Err(GoalsError::Taken));
    assert_eq!((client.accepted(&goal(1)), client.outcome(&goal(1))), (None, None));
    let (active, rejected) = (named(&client, 1, status::ACTIVE), named(&client, 2, status::REJECTED));
    assert!(client.take_statuses(now, &[active.clone(), rejected.clone()]));
    assert!(!client.take_statuses(now, &[active.clone(), rejected]));
    assert_eq!(client.accepted(&goal(1)), Some(Accepted::Yes((1, 0))));
    assert_eq!(client.accepted(&goal(2)), Some(Accepted::No));
    assert_eq!(client.statuses(now), [Status { goal: goal(1), stamp: (1, 0), status: 2 }]);
    let succeeded = named(&client, 1, status::SUCCEEDED);
    client.take_result(now, &goal(1), &succeeded, Bytes::from_static(b"r"));
    client.take_result(now, &goal(1), &active, Bytes::from_static(b"again"));
    assert_eq!(client.outcome(&goal(1)), Some(GoalOutcome::Result(status::SUCCEEDED, Bytes::from_static(b"r"))));
    // An older list that comes later changes nothing.
    assert!(!client.take_statuses(now, &[active]));
    assert_eq!(client.statuses(now)[0].status, 4);
    assert!(client.statuses(now + LISTED).is_empty());
    client.sweep(now + LINGER);
    assert_eq!(client.outcome(&goal(1)), Some(GoalOutcome::Unknown));
    assert_eq!(client.result_bytes, 0);
}

#[test]
fn goals_of_others_are_not_ours() {
    let client = begun(&[1], Instant::now());
    let id = client.id(&goal(1));
    assert_eq!(client.goal(&id), Some(goal(1)));
    for other in ["/client-1-7.0", "", &id.replace("proxy_a", "proxy_b"), &id.to_uppercase(), &client.id(&goal(2))] {
        assert_eq!(client.goal(other), None, "{other}");
    }
}

#[test]
fn a_goal_that_no_list_names_is_lost() {
    let now = Instant::now();
    let mut client = begun(&[1, 2, 3], now);
    let active = named(&client, 1, status::ACTIVE);
    client.lose(now, &goal(3));
    assert_eq!(client.outcome(&goal(3)), Some(GoalOutcome::Lost));
    client.take_statuses(now + LOST / 2, &[active]);
    assert!(client.take_statuses(now + LOST, &[]));
    assert_eq!((client.accepted(&goal(2)), client.outcome(&goal(1))), (Some(Accepted::Lost), None));
    assert!(client.take_statuses(now + LOST * 3 / 2, &[]));
    assert_eq!(client.outcome(&goal(1)), Some(GoalOutcome::Lost));
    let statuses = client.statuses(now + LOST * 3 / 2).iter().map(|status| status.status).collect::<Vec<_>>();
    assert_eq!(statuses, [6], "only what was accepted");
}

#[test]
fn a_cancellation_names_goals_as_in_ros_1() {
    let now = Instant::now();
    let mut client = begun(&[1, 2, 3], now);
    let listed = [1, 2].map(|number| named(&client, number, status::ACTIVE));
    client.take_statuses(now, &listed);
    let succeeded = named(&client, 3, status::SUCCEEDED);
    client.take_result(now, &goal(3), &succeeded, Bytes::new());
    let all = |id: GoalId, stamp| {
        let (publish, Canceling { code, mut goals }) = client.cancel(id, stamp);
        goals.sort();
        let goals: Vec<u8> = goals.iter().map(|(goal, _)| goal[0]).collect();
        (publish.map(|goal| (goal.stamp, goal.id)), code, goals)
    };
    let id = |number| client.id(&goal(number));
    assert_eq!(all(ANY_GOAL, (0, 0)), (Some(((0, 0), String::new())), 0, vec![1, 2]));
    assert_eq!(all(ANY_GOAL, (1, 0)), (Some(((1, 0), String::new())), 0, vec![1]));
    assert_eq!(all(goal(2), (0, 0)), (Some(((0, 0), id(2))), 0, vec![2]));
    assert_eq!(all(goal(2), (1, 0)), (Some(((1, 0), id(2))), 0, vec![1, 2]));
    assert_eq!(all(goal(3), (0, 0)), (None, 3, vec![]));
    assert_eq!(all(goal(9), (0, 0)), (None, 2, vec![]));
    // In ROS 1 an empty ID without a time means all goals.
    assert_eq!(all(ANY_GOAL, (-1, 5)), (None, 0, vec![]));
    assert_eq!(all(goal(2), (-1, 5)), (Some(((0, 0), id(2))), 0, vec![2]));
}

#[test]
fn goals_and_results_are_bounded() {
    let now = Instant::now();
    let mut client = GoalClient::new("/gdp_proxy_a");
    let id = |number: usize| (number as u128).to_be_bytes();
    for number in 0..MAX_SENT {
        client.begin(now, id(number)).unwrap();
    }
    assert_eq!(client.begin(now, id(MAX_SENT)), Err(GoalsError::Full));
    for number in 0..3 {
        let result = Bytes::from(vec![0; MAX_RESULTS / 2]);
        let status = GoalStatus { status: status::SUCCEEDED, ..GoalStatus::default() };
        client.take_result(now + Duration::from_secs(number as u64), &id(number), &status, result);
    }
    assert_eq!(client.outcome(&id(0)), Some(GoalOutcome::Unknown));
    assert!(client.outcome(&id(1)).is_some() && client.result_bytes == MAX_RESULTS);
    client.begin(now, id(MAX_SENT)).unwrap();
    let large = Bytes::from(vec![0; MAX_RESULTS + 1]);
    client.take_result(now, &id(3), &GoalStatus::default(), large);
    assert!(matches!(client.outcome(&id(3)), Some(GoalOutcome::Result(status::ABORTED, _))), "it is not final");
    client.begin(now, id(MAX_SENT + 1)).unwrap();
    assert_eq!(client.outcome(&id(1)), Some(GoalOutcome::Unknown));
}
