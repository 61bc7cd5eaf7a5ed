//! Unit tests of `actionlib::message`.

use super::*;

fn status() -> GoalStatus {
    let goal = GoalId { stamp: (7, 8), id: "/client-1-7.000".into() };
    GoalStatus { goal, status: 3, text: "done".into() }
}

#[test]
fn what_is_written_is_read() {
    let GoalStatus { goal, .. } = status();
    let message = write_goal((1, 2), &goal, b"goal");
    assert_eq!(read_goal(&message).unwrap(), (goal.clone(), Bytes::from_static(b"goal")));
    let message = write_update((1, 2), &status(), b"result");
    assert_eq!(read_update(&message).unwrap(), (status(), Bytes::from_static(b"result")));
    assert_eq!(read_cancel(&write_cancel(&goal)).unwrap(), goal);
    let message = write_statuses((1, 2), &[status(), status()]);
    assert_eq!(read_statuses(&message).unwrap(), [status(), status()]);
    // As genpy writes an empty `GoalStatusArray` with this stamp.
    assert_eq!(write_statuses((1, 2), &[]), [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0][..]);
}

#[test]
fn what_is_cut_or_too_long_is_refused() {
    let message = write_statuses((1, 2), &[status()]);
    for cut in 0..message.len() {
        assert!(read_statuses(&message.slice(..cut)).is_err(), "{cut}");
    }
    let many = [&message[..16], &u32::MAX.to_le_bytes()].concat();
    assert!(read_statuses(&many.into()).is_err());
    let mut long = GoalId { stamp: (0, 0), id: "x".repeat(MAX_ID) };
    assert!(read_cancel(&write_cancel(&long)).is_ok());
    long.id.push('x');
    assert!(read_cancel(&write_cancel(&long)).is_err());
    let text = GoalStatus { text: "y".repeat(2 * MAX_TEXT), ..status() };
    let cut = write_update((0, 0), &text, &[]);
    assert_eq!(read_update(&cut).unwrap().0.text.len(), MAX_TEXT);
    let invalid = Bytes::from_iter(cut.iter().map(|byte| if *byte == b'y' { 0xff } else { *byte }));
    assert!(read_update(&invalid).unwrap().0.text.len() <= MAX_TEXT);
}
