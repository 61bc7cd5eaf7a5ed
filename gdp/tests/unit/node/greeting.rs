//! Unit tests of `node::greeting`.

use super::*;

#[test]
fn it_is_said_a_few_times_soon_then_ever_more_rarely_and_again_when_there_is_reason() {
    let mut greeting = Greeting::default();
    greeting.ask(0).unwrap();
    let mut said = Vec::new();
    for at in 0..10_000 {
        said.extend(greeting.poll(at * MS).map(|challenge| (at, challenge)));
    }
    let at: Vec<u64> = said.iter().map(|(at, _)| *at).collect();
    assert_eq!(at, [0, 100, 200, 300, 400, 500, 700, 1100, 1900, 3500, 6700]);
    assert!(said.iter().all(|(_, challenge)| *challenge == said[0].1));
    // Frames of an unconfirmed session arrive continuously.
    let mut said = 0;
    for at in 10_000..20_000 {
        greeting.ask(at * MS).unwrap();
        said += u32::from(greeting.poll(at * MS).is_some());
    }
    assert_eq!(said, 5);
}

#[test]
fn only_the_answer_to_the_last_challenge_counts_and_once() {
    let mut greeting = Greeting::default();
    greeting.ask(0).unwrap();
    let challenge = greeting.poll(0).unwrap();
    assert_eq!(greeting.answered(5 * MS, &[0; 16]), None);
    assert_eq!(greeting.answered(5 * MS, &challenge), Some(5 * MS));
    assert_eq!(greeting.answered(5 * MS, &challenge), None);
    assert_eq!(greeting.next_wake(), None);
    greeting.ask(6 * MS).unwrap();
    assert_eq!(greeting.poll(6 * MS), None, "not so soon again");
    assert_ne!(greeting.poll(100 * MS).unwrap(), challenge);
}
