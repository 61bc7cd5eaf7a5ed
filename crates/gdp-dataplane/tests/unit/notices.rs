//! Unit tests of `notices`.

use super::*;

#[test]
fn each_link_has_its_own_and_a_new_one_has_nothing() {
    let notices = Notices::default();
    let (a, b) = (0x1000_0001, 0x1000_0002);
    let mut error = Header::default();
    error.become_error(ErrorCode::HopLimit, 0);
    let mut answer = Header::echo(77);
    let take = |link, header: &Header| notices.take(link, header, &[]);
    assert_eq!(take(a, &answer), Counter::Unknown, "a question is for the plane, not for this node");
    answer.become_answer();
    assert_eq!([take(a, &error), take(a, &error), take(b, &answer)], [Counter::Notice; 3]);
    error.egress_set = 9;
    assert_eq!(take(a, &error), Counter::Unknown);
    assert_eq!((notices.errors(a), notices.errors(b)), ([0, 0, 2, 0], [0; 4]));
    assert_eq!(notices.answer(b), 77);
    notices.begin(a ^ 0x2000_0000);
    assert_eq!((notices.errors(a), notices.answer(b)), ([0; 4], 77));
}

#[tokio::test]
async fn probes_wait_in_order_and_not_without_end() {
    let notices = Notices::default();
    let probe = Header::probe(Name::from_bytes([1; 32]), Name::from_bytes([2; 32]), 5, 3);
    let take = |cookie: u64| notices.take(7, &probe, &cookie.to_be_bytes());
    assert_eq!(notices.take(7, &probe, &[0; 7]), Counter::Truncated);
    for cookie in 0..MAX_PROBES as u64 {
        assert_eq!(take(cookie), Counter::Notice);
    }
    assert_eq!(take(99), Counter::PuntLimit);
    let first = notices.probe().await;
    let (destination, source) = (probe.destination, probe.source);
    assert_eq!(first, Punted { link: 7, destination, source, egress_bits: 1 << 5, cookie: 0 });
    assert_eq!((take(100), notices.probe().await.cookie), (Counter::Notice, 1));
}
