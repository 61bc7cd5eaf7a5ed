//! Unit tests of `idle`.

use super::*;

#[test]
fn it_asks_for_a_while_then_sleeps_ever_longer_until_something_comes() {
    let mut rest = Rest::new(Idle::Sleep(Duration::from_micros(70)));
    for _ in 0..2 {
        assert!((0..TIMEOUT).all(|_| rest.after(false).is_none()));
        let sleeps: Vec<_> = (0..6).filter_map(|_| rest.after(false)).map(|sleep| sleep.as_micros()).collect();
        assert_eq!(sleeps, [10, 20, 40, 70, 70, 70]);
        assert_eq!(rest.after(true), None);
    }
    let mut busy = Rest::new(Idle::Busy);
    assert!((0..10 * TIMEOUT).all(|_| busy.after(false).is_none()));
}
