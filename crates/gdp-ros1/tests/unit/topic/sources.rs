//! Unit tests of `topic::sources`.

use super::*;

fn uris<const N: usize>(hosts: [&str; N]) -> Vec<String> {
    hosts.map(|host| format!("http://{host}:1/")).to_vec()
}

fn connect(host: &str) -> SourceAction {
    SourceAction::Connect(format!("http://{host}:1/"))
}

fn dropped(host: &str) -> SourceAction {
    SourceAction::Drop(format!("http://{host}:1/"))
}

fn sources() -> (Sources, Instant) {
    (Sources::new("http://own:1/".to_owned()), Instant::now())
}

#[test]
fn publishers_come_and_go_as_the_master_says_and_oneself_is_none() {
    let (mut sources, now) = sources();
    assert_eq!(sources.listed(1, &uris(["a", "own", "b"]), now), [connect("a"), connect("b")]);
    assert_eq!(sources.listed(1, &uris(["b", "b", "c"]), now), [dropped("a"), connect("c")]);
    assert_eq!(sources.next_due(), None);
}

#[test]
fn what_ends_is_tried_again_ever_later_until_it_is_gone() {
    let (mut sources, mut now) = sources();
    sources.listed(1, &uris(["a"]), now);
    let mut waits = Vec::new();
    for _ in 0..8 {
        assert!(sources.ended("http://a:1/", now));
        let due = sources.next_due().unwrap();
        assert_eq!(sources.due(due - Duration::from_millis(1)), []);
        waits.push((due - now).as_millis());
        now = due;
        assert_eq!(sources.due(now), [connect("a")]);
    }
    assert_eq!(waits, [200, 400, 800, 1600, 3200, 6400, 10_000, 10_000]);
    now += STABLE_AFTER;
    assert!(sources.ended("http://a:1/", now));
    assert_eq!(sources.next_due(), Some(now + Duration::from_secs(10)), "it took long to fail");
    sources.due(now + Duration::from_secs(10));
    sources.connected("http://a:1/", now);
    now += STABLE_AFTER;
    assert!(sources.ended("http://a:1/", now));
    assert_eq!(sources.next_due(), Some(now + Duration::from_millis(200)), "it held");
    assert_eq!(sources.listed(1, &[], now), [dropped("a")]);
    assert_eq!(sources.next_due(), None);
}

#[test]
fn a_new_master_that_knows_nobody_ends_no_connection() {
    let (mut sources, now) = sources();
    sources.listed(1, &uris(["a", "b"]), now);
    assert_eq!(sources.listed(2, &[], now), []);
    assert_eq!(sources.listed(2, &uris(["a"]), now), [], "connected already");
    assert_eq!(sources.listed(2, &[], now), [dropped("a")], "listed in this run, and now not");
    assert!(!sources.ended("http://b:1/", now), "b was not listed in this run: not tried again");
    assert_eq!(sources.listed(2, &uris(["b"]), now), [connect("b")]);
}

#[test]
fn a_topic_has_so_many_publishers() {
    let (mut sources, now) = sources();
    let many: Vec<String> = (0..MAX_SOURCES + 7).map(|i| format!("http://h{i}:1/")).collect();
    assert_eq!(sources.listed(1, &many, now).len(), MAX_SOURCES);
}
