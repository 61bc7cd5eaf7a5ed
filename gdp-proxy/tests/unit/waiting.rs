//! Unit tests of `waiting`.

use super::*;

#[test]
fn each_end_that_is_missing_is_named() {
    let ends = |local, remote| TopicEnds { local, remote };
    for (outward, inward, ends) in [
        (Some(Waiting::LocalPublisher), None, ends(false, None)),
        (Some(Waiting::LocalPublisher), Some(Waiting::RemotePublisher), ends(false, Some(0))),
        (Some(Waiting::LocalPublisher), Some(Waiting::LocalSubscriber), ends(false, Some(2))),
        (None, None, ends(true, None)),
        (Some(Waiting::Reader), Some(Waiting::RemotePublisher), ends(true, Some(0))),
        (None, None, ends(true, Some(1))),
    ] {
        assert_eq!((ends.outward(), ends.inward()), (outward, inward), "{ends:?}");
    }
}

#[test]
fn the_log_has_each_reason_once_and_only_if_it_lasts() {
    let start = Instant::now();
    let at = |seconds| start + Duration::from_secs(seconds);
    let mut log = WaitLog::default();
    let publisher = Some(Waiting::LocalPublisher);
    for second in 0..5 {
        assert!(!log.look(at(second), publisher), "{second}");
    }
    assert!(log.look(at(5), publisher));
    assert!(!log.look(at(6), publisher), "once");
    assert!(!log.look(at(7), None));
    assert_eq!(log.current(), None);
    assert!(!log.look(at(8), Some(Waiting::Reader)));
    assert!(!log.look(at(12), Some(Waiting::LocalSubscriber)), "the time begins again with another reason");
    assert!(log.look(at(17), Some(Waiting::LocalSubscriber)));
    assert!(!log.look(at(20), publisher));
    assert!(!log.look(at(99), publisher), "a topic that comes and goes does not fill the log");
    assert_eq!(log.current(), publisher);
}

#[test]
fn what_other_lines_say_is_not_said_again() {
    let start = Instant::now();
    let mut log = WaitLog::default();
    for waiting in [Waiting::Permission, Waiting::Switch] {
        log.look(start, Some(waiting));
        assert!(!log.look(start + Duration::from_secs(60), Some(waiting)), "{waiting:?}");
        assert_eq!(log.current(), Some(waiting));
    }
}
