//! Unit tests of `call::running`.

use futures::FutureExt;

use super::*;

#[test]
fn a_client_cancels_its_own_calls_and_no_others() {
    let (running, [one, other]) = (RunningCalls::default(), [1, 2].map(|byte| Name::from_bytes([byte; 32])));
    let id = |sequence| MessageId { session: [7; 16], sequence };
    let mut first = running.begin(one, id(1));
    let mut second = running.begin(one, id(2));
    let mut foreign = running.begin(other, id(1));
    running.cancel(one, id(1));
    running.cancel(other, id(2));
    assert_eq!(first.cancelled().now_or_never(), Some(()));
    assert_eq!([&mut second, &mut foreign].map(|call| call.cancelled().now_or_never()), [None, None]);
    drop((first, second, foreign));
    assert!(running.0.lock().is_empty());
    running.cancel(one, id(2));
}
