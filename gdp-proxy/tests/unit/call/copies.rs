//! Unit tests of `call::copies`.

use super::*;

#[test]
fn a_copy_waits_until_its_own_server_replies() {
    let (copies, [one, other]) = (Copies::default(), [1, 2].map(|byte| Name::from_bytes([byte; 32])));
    let id = |sequence| MessageId { session: [7; 16], sequence };
    copies.begin(one, id(1));
    assert_eq!(*copies.waiting.lock(), None, "the request goes to one server only");
    copies.record();
    copies.begin(one, id(1));
    copies.begin(other, id(1));
    copies.end(one);
    assert_eq!(*copies.waiting.lock(), Some(vec![(other, id(1))]));
    let by_other = |server| {
        copies.win(server);
        copies.is_won_by_other()
    };
    assert_eq!([0, 1].map(by_other), [false, true]);
}
