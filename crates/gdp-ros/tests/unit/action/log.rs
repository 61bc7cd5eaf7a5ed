//! Unit tests of `action::log`.

use super::*;

fn name(number: u64) -> Name {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&number.to_be_bytes());
    Name::from_bytes(bytes)
}

fn of(callers: &[u64]) -> Log {
    let mut log = Log::default();
    callers.iter().for_each(|caller| log.add_caller(Instant::now(), name(*caller)).unwrap());
    log
}

fn feedback(number: u64) -> Bytes {
    number.to_be_bytes().to_vec().into()
}

#[test]
fn each_is_told_what_it_has_not_heard_and_nothing_of_others() {
    let mut log = of(&[1, 2]);
    assert_eq!(log.after(&name(1), 0), None);
    log.feedback(&name(1), feedback(1));
    log.status(&name(1), Bytes::from_static(b"running"));
    log.feedback(&name(1), feedback(2));
    let told = log.after(&name(1), 0).unwrap();
    let status = Event::Status(Bytes::from_static(b"running"));
    let expected = [Event::Feedback(feedback(1)), status, Event::Feedback(feedback(2))];
    assert_eq!((told.last, told.dropped, &told.events[..]), (3, 0, &expected[..]));
    assert_eq!(log.after(&name(1), 0), Some(told), "a reply may have been lost");
    assert_eq!(log.after(&name(1), 2).unwrap().events, expected[2..]);
    assert_eq!((log.after(&name(1), 3), log.after(&name(2), 0)), (None, None));
    log.status(&name(1), Bytes::from_static(b"running"));
    assert_eq!(log.after(&name(1), 3), None, "that is known");
}

#[test]
fn only_the_newest_status_is_told() {
    let mut log = of(&[1]);
    log.status(&name(1), Bytes::from_static(b"running"));
    log.status(&name(1), Bytes::from_static(b"done"));
    let told = log.after(&name(1), 0).unwrap();
    assert_eq!((told.last, told.events), (2, vec![Event::Status(Bytes::from_static(b"done"))]));
}

#[test]
fn what_waits_is_bounded_and_what_goes_is_counted() {
    let mut log = of(&[1]);
    let dropped: u64 = (0..MAX_WAITING as u64 + 5).map(|number| log.feedback(&name(1), feedback(number))).sum();
    assert_eq!(dropped, 5);
    let told = log.after(&name(1), 0).unwrap();
    assert_eq!((told.dropped, told.events.len()), (5, MAX_WAITING));
    assert_eq!(told.events[0], Event::Feedback(feedback(5)));
    assert_eq!(log.after(&name(1), told.last), None);
    // Bytes are bounded as well, in a reply and before.
    let large = Bytes::from(vec![0; MAX_WAITING_BYTES / 2]);
    let dropped: Vec<u64> = (0..4).map(|_| log.feedback(&name(1), large.clone())).collect();
    assert_eq!(dropped, [0, 0, 1, 1]);
    let told = log.after(&name(1), told.last).unwrap();
    assert_eq!((told.events.len(), told.dropped), (1, 2));
    assert_eq!(log.feedback(&name(9), feedback(1)), 1, "nobody");
}

#[test]
fn callers_are_bounded_and_forgotten() {
    let start = Instant::now();
    let mut log = of(&(0..MAX_CALLERS as u64).collect::<Vec<_>>());
    assert_eq!(log.add_caller(start, name(9999)), Err(LogError));
    log.sweep(start + 2 * LINGER, |caller| *caller == name(7));
    assert_eq!(log.callers().collect::<Vec<_>>(), [&name(7)]);
    assert_eq!(log.add_caller(start, name(9999)), Ok(()));
}
