//! Unit tests of `node::reading`.

use super::*;
use gdp_core::identity::SigningKey;
use gdp_core::keys::{EpochKey, wrap};

const NAME: Name = Name::from_bytes([1; 32]);
const MINUTE: u64 = 60_000_000_000;

/// The writer restarted with a clock that was set back, and its later epochs count from there.
#[test]
fn a_writer_whose_epochs_are_behind_is_shown_the_newest_until_it_has_a_later_one() {
    let entity = |seed| Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), "proxy");
    let (reader, writer) = (entity(1), entity(2));
    let mut reading = Reading::new(NAME, &reader);
    let (name, key) = (writer.name(), writer.key().verify_key());
    let mut counterpart = Counterpart::for_test(name, NAME, key, u64::MAX, 1);
    counterpart.box_key = writer.box_public();
    let key_box = |epoch| {
        let key = EpochKey::from_bytes([epoch as u8; 32]);
        wrap(NAME, &writer, (reader.name(), &reader.box_public()), epoch, &key).unwrap()
    };
    let told = |effects: Vec<Effect>| {
        let of = |effect| match effect {
            Effect::Tell(to, Feedback::NewestKey { name, key_box }) => Some((to, name, key_box)),
            _ => None,
        };
        effects.into_iter().filter_map(of).collect::<Vec<_>>()
    };
    let newest = key_box(100);
    assert_eq!(told(reading.take(0, [PeerEvent::Joined(counterpart), PeerEvent::KeyBox(newest.clone())])), []);
    let expected = vec![(writer.name(), NAME, newest)];
    assert_eq!(told(reading.take(2 * MINUTE, [PeerEvent::KeyBox(key_box(50))])), expected);
    assert_eq!(told(reading.expire(2 * MINUTE)), expected, "the message may have been lost");
    assert_eq!(told(reading.take(2 * MINUTE, [PeerEvent::KeyBox(key_box(101))])), []);
    assert_eq!(told(reading.take(4 * MINUTE, [PeerEvent::KeyBox(key_box(51))])).len(), 1);
    let more: usize = (0..100).map(|_| told(reading.expire(4 * MINUTE)).len()).sum();
    assert_eq!(more, TELLINGS as usize - 1, "it may be a recording");
}
