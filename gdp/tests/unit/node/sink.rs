//! Unit tests of `node::sink`.

use std::sync::Arc;

use bytes::Bytes;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;

use super::*;

#[tokio::test]
async fn the_sink_overtakes_nothing_that_is_queued_or_in_progress() {
    let (direct, (sender, mut queue)) = (DirectPath::default(), mpsc::channel(4));
    let seen = Arc::<Mutex<Vec<u64>>>::default();
    let by_sink = seen.clone();
    direct.set(Some(Box::new(move |message| match message.sequence {
        2 => Some(message),
        sequence => {
            by_sink.lock().push(sequence);
            None
        }
    })));
    let pass = |sequence| direct.pass(message(sequence), &sender).map(|refused| sender.try_send(refused).unwrap());
    assert!(pass(1).is_some(), "the application has not waited yet");
    assert_eq!(poll_once(&direct, &mut queue).unwrap().sequence, 1);
    assert!(poll_once(&direct, &mut queue).is_none());
    assert!(pass(2).is_some(), "the sink does not take it");
    assert!(pass(3).is_some(), "another is queued");
    assert_eq!(poll_once(&direct, &mut queue).unwrap().sequence, 2);
    assert_eq!(poll_once(&direct, &mut queue).unwrap().sequence, 3);
    assert!(pass(4).is_some(), "the application has not processed the last one");
    assert_eq!(poll_once(&direct, &mut queue).unwrap().sequence, 4);
    assert!(poll_once(&direct, &mut queue).is_none());
    assert!(pass(5).is_none() && pass(6).is_none());
    assert_eq!(*seen.lock(), [5, 6]);
}

#[tokio::test]
async fn without_a_sink_everything_is_queued() {
    let (direct, (sender, mut queue)) = (DirectPath::default(), mpsc::channel(4));
    direct.set(Some(Box::new(|_| None)));
    let mut waits = poll_once(&direct, &mut queue);
    assert!(waits.is_none());
    assert!(direct.pass(message(1), &sender).is_none());
    direct.set(None);
    let returned = direct.pass(message(2), &sender).unwrap();
    sender.try_send(returned).unwrap();
    waits = poll_once(&direct, &mut queue);
    assert_eq!(waits.unwrap().sequence, 2);
}

/// Polls once.
fn poll_once(direct: &DirectPath, queue: &mut mpsc::Receiver<Message>) -> Option<Message> {
    let mut context = Context::from_waker(std::task::Waker::noop());
    match direct.poll_next(queue, &mut context) {
        Poll::Ready(message) => message,
        Poll::Pending => None,
    }
}

fn message(sequence: u64) -> Message {
    Message {
        name: Name::from_bytes([1; 32]),
        writer: Name::from_bytes([2; 32]),
        session: [3; 16],
        sequence,
        timestamp_ns: 0,
        encoding: Encoding::Bytes,
        in_reply_to: None,
        origin: Bytes::new(),
        latched: None,
        service: None,
        body: Bytes::new(),
    }
}
