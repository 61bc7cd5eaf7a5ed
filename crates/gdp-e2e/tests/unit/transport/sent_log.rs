//! Unit tests of `transport::sent_log`.

use super::*;

#[test]
fn it_stays_bounded_and_finds_what_is_near() {
    let mut log = SentLog::default();
    let sent = |n: u64| Sent {
        position: Position { sequence: n / 10, index: (n % 10) as u32 },
        at: n,
        total: n * 1000,
        pauses: 0,
    };
    for n in 0..100_000 {
        log.add(sent(n), 5_000_000);
    }
    assert!(log.0.len() <= MOST);
    for n in 99_000..100_000 {
        let found = log.find(sent(n).position).unwrap();
        assert!(found.at <= n && n - found.at <= 5, "{n}: {found:?}");
    }
    assert_eq!(log.find(sent(5).position), None);
}
