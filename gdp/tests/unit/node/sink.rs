//! Unit tests of `node::sink`.

use std::future::poll_fn;
use std::sync::Arc;

use bytes::Bytes;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;

use super::*;

const MESSAGES: u64 = 20_000;

/// One message in seven goes through the queue, and those that come before it is processed.
#[tokio::test(flavor = "multi_thread")]
async fn the_sink_overtakes_nothing_that_is_queued() {
    let (direct, seen) = (Arc::<DirectPath>::default(), Arc::<Mutex<Vec<u64>>>::default());
    let (sender, mut queue) = mpsc::channel(4);
    let by_sink = seen.clone();
    direct.set(Some(Box::new(move |message| match message.sequence % 7 {
        0 => Some(message),
        _ => {
            by_sink.lock().push(message.sequence);
            None
        }
    })));
    let receiving = std::thread::spawn({
        let direct = direct.clone();
        move || {
            for sequence in 0..MESSAGES {
                if let Some(message) = direct.pass(message(sequence), &sender) {
                    sender.blocking_send(message).unwrap();
                }
            }
        }
    });
    let mut queued = 0;
    while let Some(message) = poll_fn(|context| direct.poll_next(&mut queue, context)).await {
        // The sink runs on another processor meanwhile, if it is asked too early.
        std::thread::yield_now();
        seen.lock().push(message.sequence);
        queued += 1;
    }
    receiving.join().unwrap();
    assert_eq!(*seen.lock(), (0..MESSAGES).collect::<Vec<_>>());
    assert!(queued >= MESSAGES / 7, "{queued}");
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
