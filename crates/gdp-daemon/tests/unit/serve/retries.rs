//! Unit tests of `serve::retries`.

use gdp_proto::control::NameRole;

use super::*;

#[test]
fn attempts_get_rarer_and_are_never_many_at_once() {
    let (mut retries, one) = (Retries::default(), neighbour(1));
    let (mut now, mut waits) = (Duration::from_secs(100), vec![]);
    for times in 1..=10 {
        assert_eq!(retries.refused(now, one, place(0)), times);
        let next = retries.next_tick().unwrap();
        waits.push((next - now).as_secs());
        assert_eq!(retries.take_due(next - Duration::from_millis(1)), []);
        assert_eq!(retries.take_due(next), [place(0)]);
        assert_eq!(retries.next_tick(), None, "it is being tried");
        now = next;
    }
    assert_eq!(waits, [1, 2, 4, 8, 16, 32, 60, 60, 60, 60]);
    retries.settled(&place(0));
    assert_eq!(retries.refused(now, one, place(0)), 1, "it had been taken meanwhile");
    retries.settled(&place(0));

    (0..100).for_each(|i| _ = retries.refused(now, one, place(i)));
    now = retries.next_tick().unwrap();
    assert_eq!(retries.take_due(now).len(), AT_ONCE);
    assert_eq!(retries.take_due(now), []);
    assert_eq!(retries.next_tick(), Some(now + BETWEEN));
    assert_eq!(retries.take_due(now + BETWEEN).len(), 100 - AT_ONCE);
}

#[test]
fn no_neighbour_waits_for_what_others_told() {
    let (mut retries, mut now) = (Retries::default(), Duration::from_secs(100));
    let [many, few, third] = [1, 2, 3].map(neighbour);
    // This neighbour comes first in any order, by time or by name.
    for i in 0..250 {
        retries.refused(now, many, place(i));
    }
    now += BETWEEN;
    [few, third].iter().zip(250..).for_each(|(other, i)| _ = retries.refused(now, *other, place(i)));
    now += BETWEEN;
    let taken = retries.take_due(now);
    assert!(taken.len() == AT_ONCE && [250, 251].iter().all(|i| taken.contains(&place(*i))), "{taken:?}");
    taken.iter().for_each(|place| retries.settled(place));
    for neighbour in [few, third] {
        (0..40).for_each(|i| _ = retries.refused(now, neighbour, RecordKey { switch: neighbour, ..place(i) }));
    }
    now += BETWEEN;
    let taken = retries.take_due(now);
    let of = |neighbour| taken.iter().filter(|place| place.switch == neighbour).count();
    let shares = [of(few), of(third), taken.len() - of(few) - of(third)];
    assert!(shares.iter().all(|share| [21, 22].contains(share)), "{shares:?}");
}

#[test]
fn a_place_waits_as_the_last_neighbour_told_it() {
    let (mut retries, now) = (Retries::default(), Duration::from_secs(100));
    let [one, other] = [1, 2].map(neighbour);
    assert_eq!([retries.refused(now, one, place(0)), retries.refused(now, one, place(0))], [1, 2]);
    assert_eq!(retries.refused(now, other, place(0)), 1, "another's word");
    assert_eq!(retries.take_due(now + LONGEST), [place(0)]);
    retries.settled(&place(0));
    assert_eq!((retries.next_tick(), retries.due.len(), retries.refused.len()), (None, 0, 0));
}

fn neighbour(i: u8) -> Name {
    Name::from_bytes([i; 32])
}

fn place(i: u8) -> RecordKey {
    let name = Name::from_bytes([i; 32]);
    RecordKey { name, role: NameRole::Publisher, entity: name, switch: name }
}
