//! Unit tests of `call::outbox`.

use super::*;

fn message(byte: u8, length: usize) -> Bytes {
    vec![byte; length].into()
}

fn all(outbox: &mut Outbox) -> Vec<Event> {
    std::iter::from_fn(|| outbox.next()).collect()
}

#[test]
fn feedback_goes_in_order_and_of_statuses_the_newest() {
    let mut outbox = Outbox::default();
    assert_eq!(outbox.feedback(message(1, 1)), 0);
    outbox.status(message(2, 1));
    assert_eq!(outbox.feedback(message(3, 1)), 0);
    outbox.status(message(4, 1));
    let expected = [Event::Feedback(message(1, 1)), Event::Feedback(message(3, 1)), Event::Status(message(4, 1))];
    assert_eq!((all(&mut outbox), outbox.count, outbox.bytes), (expected.to_vec(), 0, 0));
}

#[test]
fn what_is_too_much_replaces_the_oldest_and_is_counted() {
    let mut outbox = Outbox::default();
    outbox.status(message(0, 1));
    let dropped: u64 = (0..MAX_WAITING + 3).map(|i| outbox.feedback(message(i as u8, 1))).sum();
    assert_eq!((dropped, outbox.count, outbox.waiting.len()), (3, MAX_WAITING, MAX_WAITING + 1));
    assert_eq!(outbox.next(), Some(Event::Status(message(0, 1))));
    assert_eq!(outbox.next(), Some(Event::Feedback(message(3, 1))));
    all(&mut outbox);
    let dropped: Vec<u64> = (0..3).map(|_| outbox.feedback(message(7, MAX_WAITING_BYTES / 2))).collect();
    assert_eq!(dropped, [0, 0, 1]);
    assert_eq!((outbox.feedback(message(8, 2 * MAX_WAITING_BYTES)), all(&mut outbox).len()), (2, 1));
}
