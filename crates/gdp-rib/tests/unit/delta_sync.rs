//! Unit tests of `delta_sync`.

use std::collections::BTreeMap;

use super::*;

const S: Duration = Duration::from_secs(1);

/// Composes and delivers the next message, with at most `room` entries.
fn deliver(sync: &mut DeltaSync<u8>, entries: &BTreeMap<u8, u32>, copy: &mut BTreeMap<u8, u32>, room: usize) -> bool {
    match sync.next_message() {
        None => return false,
        Some(NextMessage::Part { after }) => {
            let mut rest = entries.range((after.map_or(Unbounded, Excluded), Unbounded));
            let page: Vec<_> = rest.by_ref().take(room).map(|(key, value)| (*key, *value)).collect();
            let end = rest.next().and(page.last()).map(|(key, _)| *key);
            let part = sync.part_composed(end);
            assert_eq!((part.number == 0, part.is_last), (after.is_none(), end.is_none()));
            if part.number == 0 {
                copy.clear();
            }
            copy.extend(page);
        }
        Some(NextMessage::Delta) => {
            for i in 0..room {
                let Some((key, ())) = sync.next_change(|_| true) else {
                    assert!(i > 0, "a delta without a change");
                    break;
                };
                match entries.get(&key) {
                    Some(value) => _ = copy.insert(key, *value),
                    None => _ = copy.remove(&key),
                }
            }
            assert_eq!(sync.next_change(|_| false), None);
        }
    }
    true
}

/// Random changes, losses and restarts between messages of random sizes, from a fixed seed.
#[test]
fn the_copy_equals_the_set_after_any_changes_and_losses() {
    let mut seed = 7u32;
    let mut random = |below: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 16) % below
    };
    for _ in 0..200 {
        let (mut sync, mut entries, mut copy) = (DeltaSync::new(), BTreeMap::new(), BTreeMap::new());
        for step in 0..300 {
            let key = random(40) as u8;
            match random(12) {
                0..5 => {
                    entries.insert(key, step);
                    sync.change(key, ());
                }
                5..7 => {
                    entries.remove(&key);
                    sync.change(key, ());
                }
                7 => sync.failed(S),
                8 => sync.restart(),
                _ => _ = deliver(&mut sync, &entries, &mut copy, 1 + random(9) as usize),
            }
            let sent = (0..40).filter(|key| sync.is_sent(key));
            assert!(sent.into_iter().all(|key| copy.get(&key) == entries.get(&key)), "sent but not delivered");
        }
        if sync.retry_at().is_some() {
            sync.restart();
        }
        while deliver(&mut sync, &entries, &mut copy, 3) {}
        assert!(sync.is_following() && !sync.has_changes());
        assert_eq!(copy, entries);
    }
}

#[test]
fn nothing_is_sent_between_a_loss_and_the_restart() {
    let mut sync = DeltaSync::following();
    sync.change(1, ());
    assert_eq!(sync.next_message(), Some(NextMessage::Delta));
    sync.failed(3 * S);
    assert_eq!((sync.next_message(), sync.retry_at()), (None, Some(3 * S)));
    sync.restart();
    assert_eq!((sync.next_message(), sync.retry_at()), (Some(NextMessage::Part { after: None }), None));
}

#[test]
fn of_two_changes_the_greater_one_counts() {
    let mut sync = DeltaSync::following();
    [(1, 1), (1, 2), (2, 2), (2, 1)].into_iter().for_each(|(key, change)| sync.change(key, change));
    assert_eq!([(); 3].map(|()| sync.next_change(|_| true)), [Some((1, 2)), Some((2, 2)), None]);
}
