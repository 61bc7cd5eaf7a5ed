//! Unit tests of `node::request_queue`.

use bytes::Bytes;

use super::*;
use gdp_e2e::seal::Encoding;

#[tokio::test]
async fn what_waits_is_bounded_and_comes_in_its_order() {
    let (tray, mut desk) = new();
    for sequence in 0..MAX_WAITING as u64 {
        assert!(tray.put(request(1, sequence, 10)));
    }
    assert!(!tray.put(request(1, 0, 10)), "too many");
    assert_eq!(desk.recv().await.unwrap().sequence, 0);
    assert!(!tray.put(request(1, 0, MAX_WAITING_BYTES)), "too much");
    assert!(tray.put(request(1, 7777, 10)));
    for _ in 1..MAX_WAITING {
        desk.recv().await.unwrap();
    }
    assert!(tray.put(request(1, 8888, MAX_WAITING_BYTES - 10)), "there is room again");
    assert_eq!(desk.recv().await.unwrap().sequence, 7777);
    drop(tray);
    assert_eq!(desk.recv().await.unwrap().sequence, 8888, "what was taken in is served");
    assert!(desk.recv().await.is_none());
}

#[test]
fn what_comes_before_its_caller_is_known_waits_for_a_while() {
    let (mut tray, _desk) = new();
    let known = |caller: u8| move |writer: &Name| *writer == Name::from_bytes([caller; 32]);
    assert_eq!(tray.defer(0, request(1, 1, 10)) + tray.defer(1, request(2, 2, 10)), 0);
    let (released, late) = tray.release(2, known(2));
    assert_eq!((released.len(), released[0].sequence, late), (1, 2, 0));
    let (released, late) = tray.release(TIMEOUT + 1, known(2));
    assert_eq!((released.len(), late), (0, 1));
    let dropped: usize = (0..MAX_EARLY as u64 + 3).map(|i| tray.defer(i, request(1, i, 10))).sum();
    assert_eq!(dropped, 3);
    assert_eq!(tray.defer(0, request(3, 1, MAX_EARLY_BYTES)), MAX_EARLY, "bytes are bounded, too");
    let (released, late) = tray.release(0, |_| true);
    assert_eq!((released.len(), late), (1, 0));
    assert_eq!((tray.early_bytes, tray.early.len()), (0, 0));
}

fn request(writer: u8, sequence: u64, size: usize) -> Message {
    Message {
        name: Name::default(),
        writer: Name::from_bytes([writer; 32]),
        session: [0; 16],
        sequence,
        timestamp_ns: 0,
        encoding: Encoding::Bytes,
        in_reply_to: None,
        origin: Bytes::new(),
        latched: None,
        service: None,
        body: vec![0; size].into(),
    }
}
