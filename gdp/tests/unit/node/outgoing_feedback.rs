//! Unit tests of `node::outgoing_feedback`.

use super::*;

const WRITERS: [Name; 2] = [Name::from_bytes([1; 32]), Name::from_bytes([2; 32])];

fn gone(oldest: u64) -> Feedback {
    Feedback::Unavailable { name: Name::from_bytes([7; 32]), session: [9; 16], oldest }
}

#[test]
fn what_is_for_one_entity_travels_together_as_far_as_it_fits() {
    const MESSAGES: u64 = 40;
    let mut outgoing = OutgoingFeedback::default();
    assert!(outgoing.is_empty());
    for oldest in 0..MESSAGES {
        outgoing.push(&WRITERS[0], gone(oldest));
    }
    outgoing.push(&WRITERS[1], gone(0));
    assert!(WRITERS.iter().all(|writer| outgoing.has(writer)) && !outgoing.has(&Name::from_bytes([3; 32])));
    let mut frames = Vec::new();
    outgoing.flush(|writer, feedback| frames.push((*writer, feedback.to_vec())));
    let (first, second): (Vec<_>, Vec<_>) = frames.into_iter().partition(|(writer, _)| *writer == WRITERS[0]);
    assert_eq!(second, [(WRITERS[1], vec![gone(0)])]);
    let most = MAX_FEEDBACK / gone(0).encoded_len();
    assert_eq!(first.len(), (MESSAGES as usize).div_ceil(most));
    let all: Vec<_> = first.iter().flat_map(|(_, feedback)| feedback.clone()).collect();
    assert_eq!(all, (0..MESSAGES).map(gone).collect::<Vec<_>>(), "each once, in order");
    assert!(outgoing.is_empty());
    outgoing.flush(|writer, _| panic!("nothing is left for {writer}"));
}

#[test]
fn what_earlier_releases_do_not_know_travels_alone() {
    let mut outgoing = OutgoingFeedback::default();
    let answer = Feedback::ClockAnswer { name: Name::from_bytes([7; 32]), challenge: [9; 16], unix_ns: 1 };
    for feedback in [gone(1), answer.clone(), gone(2)] {
        outgoing.push(&WRITERS[0], feedback);
    }
    outgoing.push(&WRITERS[1], answer.clone());
    let mut frames = Vec::new();
    outgoing.flush(|_, feedback| frames.push(feedback.to_vec()));
    assert_eq!(frames, [vec![answer.clone()], vec![gone(1), gone(2)], vec![answer]]);
}
