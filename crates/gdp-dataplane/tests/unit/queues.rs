//! Unit tests of `queues`.

use super::*;

#[test]
fn each_interface_has_its_queue() {
    let queues = Queues::default();
    let to = |ifindex| LinkAddr::Ethernet { ifindex, mac: [2; 6] };
    let udp = LinkAddr::udp(([10, 0, 0, 1], 31415).into());
    let long = || [to(1), to(2), udp].map(|to| queues.is_long_to(to));
    assert_eq!(long(), [false; 3]);
    queues.note(1, LONG);
    assert_eq!(long(), [false; 3]);
    queues.note(1, LONG + 1);
    queues.note(2, LONG + 1);
    assert_eq!(long(), [true, true, false]);
    queues.note(1, 0);
    assert_eq!(long(), [false, true, false]);
    queues.note(2, 0);
    assert_eq!(long(), [false; 3]);
}

#[test]
fn a_long_queue_is_asked_for_until_it_is_not_though_nothing_is_sent_there() {
    let queues = Queues::default();
    let of = |first, second| move |ifindex| [first, second][ifindex as usize];
    queues.look([0].into_iter(), of(LONG + 1, LONG + 1));
    assert_eq!([0, 1].map(|ifindex| queues.is_long(ifindex)), [true, false], "the other was not due");
    queues.look([1].into_iter(), of(LONG + 1, LONG + 1));
    assert_eq!([0, 1].map(|ifindex| queues.is_long(ifindex)), [true, true]);
    queues.look(std::iter::empty(), of(0, LONG + 1));
    assert_eq!([0, 1].map(|ifindex| queues.is_long(ifindex)), [false, true]);
}
