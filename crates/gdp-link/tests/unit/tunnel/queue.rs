//! Unit tests of the queue of datagrams.

use super::*;
use gdp_wire::header::FIRST_QUIC_BYTE;

fn frame(number: u8, length: usize) -> Bytes {
    let mut bytes = vec![FrameType::Data.first_byte(); length];
    bytes[1] = number;
    bytes.into()
}

#[test]
fn datagrams_leave_in_order_and_quic_packets_first() {
    let (mut queue, now) = (DatagramQueue::default(), Instant::now());
    let packet = Bytes::from_static(&[FIRST_QUIC_BYTE, 9]);
    queue.push(now, frame(1, 100));
    queue.push(now, frame(2, 100));
    queue.push(now, packet.clone());
    queue.push(now, Bytes::new());
    assert_eq!(queue.pop(now), Some(packet));
    assert_eq!(queue.pop(now), Some(frame(1, 100)));
    assert_eq!(queue.pop(now), Some(frame(2, 100)));
    assert_eq!(queue.pop(now), None);
    assert_eq!(queue.bytes, 0);
}

#[test]
fn the_oldest_frames_are_dropped_when_the_queue_is_full() {
    let (mut queue, now) = (DatagramQueue::default(), Instant::now());
    let packet = Bytes::from_static(&[FIRST_QUIC_BYTE, 9]);
    queue.push(now, packet.clone());
    for number in 0..200 {
        queue.push(now, frame(number, 8 << 10));
        assert!(queue.bytes <= MAX_BYTES);
    }
    assert_eq!(queue.pop(now), Some(packet));
    let first = queue.pop(now).unwrap();
    assert_eq!(first[1], 73, "127 of the newest frames and the packet fit");
    for number in 0..200 {
        let large = [vec![FIRST_QUIC_BYTE, number], vec![0; 8 << 10]].concat();
        queue.push(now, large.into());
        assert!(queue.bytes <= MAX_BYTES);
    }
    assert!(queue.data.is_empty(), "QUIC packets remain longer");
}

#[test]
fn frames_that_waited_too_long_are_dropped() {
    let (mut queue, then) = (DatagramQueue::default(), Instant::now());
    let now = then + MAX_AGE + Duration::from_millis(1);
    queue.push(then, frame(1, 100));
    queue.push(now, frame(2, 100));
    assert_eq!(queue.pop(now), Some(frame(2, 100)));
    assert_eq!((queue.pop(now), queue.bytes), (None, 0));
}
