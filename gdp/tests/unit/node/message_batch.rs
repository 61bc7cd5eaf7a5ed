//! Unit tests of `node::message_batch`.

use super::*;

#[test]
fn turns_to_sign_are_at_once_until_there_are_too_many() {
    let (turns, start) = (Turns::default(), 1_000_000_000);
    let at_once = (0..100).take_while(|_| turns.take(start) == start).count();
    assert_eq!(at_once as u64, TOGETHER / APART + 1);
    let waits: Vec<u64> = (0..100).map(|_| turns.take(start) - start).collect();
    assert!(waits.is_sorted() && waits[1] - waits[0] == APART && waits[99] <= LONGEST, "{waits:?}");
    let later = start + LONGEST + TOGETHER;
    assert_eq!(turns.take(later), later, "a pause makes up for all of them");
    let steady = (1..1000).all(|i| turns.take(later + i * APART) == later + i * APART);
    assert!(steady, "as many as that never wait");
}

#[test]
fn what_was_gathered_comes_out_as_it_was() {
    let drafts = [
        Draft { origin: &[1, 2], ..Draft::new(Encoding::Cdr, b"body") },
        Draft::new(Encoding::Json, b""),
        Draft { origin: &[3; MAX_ORIGIN], ..Draft::new(Encoding::Bytes, b"x") },
    ];
    let mut gathered = MessageBatch::new(None);
    for draft in &drafts {
        assert!(MessageBatch::takes(std::slice::from_ref(draft)));
        gathered.push(draft);
    }
    assert_eq!(gathered.drafts(), drafts);
    gathered.clear();
    assert!(gathered.is_empty() && gathered.drafts().is_empty());
    let too_long = Draft { origin: &[3; MAX_ORIGIN + 1], ..drafts[0] };
    assert!(!MessageBatch::takes(&[too_long]), "its sealing would fail");
}
