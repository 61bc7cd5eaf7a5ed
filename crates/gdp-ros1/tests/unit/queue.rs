//! Unit tests of `queue`.

use super::*;

#[test]
fn the_oldest_give_way_by_number_and_by_bytes() {
    let queue = Queue::new(QueueLimits { messages: 3, bytes: 10 });
    for i in 0..5 {
        queue.push(i, 1);
    }
    assert_eq!((queue.try_pop(), queue.dropped()), (Some(2), 2));
    queue.push(5, 9);
    assert_eq!((queue.try_pop(), queue.try_pop(), queue.dropped()), (Some(4), Some(5), 3));
    queue.push(6, 1);
    queue.push(7, 11);
    assert_eq!((queue.try_pop(), queue.try_pop(), queue.dropped()), (Some(7), None, 4));
}
