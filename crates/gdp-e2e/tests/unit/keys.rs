//! Tests of writers and readers together, in simulated time.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::time::Duration;

use super::*;
use gdp_core::cert::{Signed, issue};
use gdp_core::crypto::{Backend, NONCE_LEN, TAG_LEN};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::{EpochKey, KeyBox, wrap};
use gdp_core::name::Name;
use gdp_faults::Random;

const NAME: Name = Name::from_bytes([1; 32]);
const START: u64 = 1_800_000_000 * SECOND;
const SECOND: u64 = 1_000_000_000;
const MS: u64 = 1_000_000;

#[test]
fn a_revoked_reader_cannot_open_the_next_epoch() {
    let mut world = World::new(2, Rotation::default());
    world.set_readers(&[0, 1]);
    world.settle();
    assert_eq!(world.who_opens(), BTreeSet::from([0, 1]));

    world.now += 10 * SECOND;
    world.set_readers(&[0]);
    let before = world.ring.current().0;
    world.settle();
    assert!(world.ring.current().0 > before);
    assert_eq!(world.who_opens(), BTreeSet::from([0]));
    // The revoked reader cannot open the boxes of others either.
    for signed in world.published.clone() {
        world.readers[1].offer(world.now, &world.writer, &signed);
    }
    assert_eq!(world.who_opens(), BTreeSet::from([0]));

    world.set_readers(&[0, 1]);
    world.settle();
    assert_eq!(world.who_opens(), BTreeSet::from([0, 1]), "it may read again");
}

#[test]
fn the_epoch_changes_when_its_boxes_are_stored_or_two_seconds_later() {
    let mut world = World::new(2, Rotation::default());
    world.set_readers(&[0, 1]);
    world.settle();
    let first = world.ring.current().0;
    world.now += 10 * SECOND;
    world.set_readers(&[0]);
    let boxes = world.poll().unwrap();
    assert!(boxes.epoch > first && boxes.boxes.len() == 1);
    assert_eq!((world.ring.current().0, world.poll()), (first, None));
    assert_eq!(world.ring.wake_at(), world.now + 2 * SECOND);
    world.ring.boxes_stored(boxes.epoch);
    assert_eq!(world.ring.current().0, boxes.epoch);

    world.now += 10 * SECOND;
    world.set_readers(&[]);
    let at_once = world.poll();
    assert_eq!(at_once, None, "nobody is left who would need a box");
    assert!(world.ring.current().0 > boxes.epoch);

    world.now += 10 * SECOND;
    world.set_readers(&[0, 1]);
    world.settle();
    world.now += 10 * SECOND;
    world.set_readers(&[1]);
    let boxes = world.poll().unwrap();
    world.now += 2 * SECOND - 1;
    assert_eq!(world.poll(), None);
    assert!(world.ring.current().0 < boxes.epoch);
    world.now += 1;
    assert_eq!(world.poll(), None);
    assert_eq!(world.ring.current().0, boxes.epoch, "nobody stores boxes, and the revoked reader reads no longer");
}

#[test]
fn epochs_begin_a_second_apart_and_the_ring_says_when() {
    let mut world = World::new(2, Rotation::default());
    world.set_readers(&[0, 1]);
    assert_eq!(world.ring.wake_at(), 0);
    world.settle();
    assert_eq!(world.ring.wake_at(), START + 3600 * SECOND);
    let first = world.ring.current().0;
    world.now += SECOND / 2;
    world.set_readers(&[0]);
    assert_eq!(world.ring.wake_at(), START + SECOND);
    world.settle();
    assert_eq!(world.ring.current().0, first);
    world.now = START + SECOND;
    let boxes = world.poll().unwrap();
    // The other reader also leaves, before the boxes without the first one are stored.
    world.set_readers(&[]);
    assert_eq!(world.ring.wake_at(), START + 2 * SECOND);
    world.now = START + 2 * SECOND;
    assert_eq!(world.poll(), None);
    assert!(world.ring.current().0 > boxes.epoch);
    assert_eq!(world.ring.wake_at(), world.now + 3600 * SECOND);
}

#[test]
fn a_key_is_replaced_by_age_messages_and_bytes() {
    let rotation = Rotation { age: Duration::from_secs(100), messages: 1000, bytes: 1 << 20 };
    let mut world = World::new(1, rotation);
    world.set_readers(&[0]);
    world.settle();
    let first = world.ring.current().0;

    world.now += 100 * SECOND - 1;
    assert_eq!(world.ring.wake_at(), START + 100 * SECOND);
    world.settle();
    assert_eq!(world.ring.current().0, first);
    world.now += 1;
    world.settle();
    let by_age = world.ring.current().0;
    assert_eq!(by_age, first + 100, "a number is the second at which its epoch began");

    world.now += 10 * SECOND;
    world.ring.used(999, 0);
    world.settle();
    assert_eq!(world.ring.current().0, by_age);
    world.ring.used(1, 0);
    world.settle();
    let by_messages = world.ring.current().0;
    assert_eq!(by_messages, by_age + 10);

    world.now += 10 * SECOND;
    world.ring.used(1, (1 << 20) - 1);
    world.settle();
    assert_eq!(world.ring.current().0, by_messages);
    world.ring.used(1, 1);
    world.settle();
    assert_eq!(world.ring.current().0, by_messages + 10);
    assert_eq!(world.who_opens(), BTreeSet::from([0]));
}

#[test]
fn a_clock_that_is_set_back_replaces_the_key_once() {
    let mut world = World::new(1, Rotation::default());
    world.set_readers(&[0]);
    world.settle();
    let first = world.ring.current().0;
    world.now -= 1000 * SECOND;
    world.settle();
    assert_eq!(world.ring.current().0, first + 1);
    world.now += 10 * SECOND;
    world.settle();
    assert_eq!(world.ring.current().0, first + 1);
    assert_eq!(world.who_opens(), BTreeSet::from([0]));
}

#[test]
fn a_restarted_writer_repeats_no_number_however_often_it_changed_keys() {
    let mut world = World::new(8, Rotation { age: Duration::from_secs(3600), messages: 1, bytes: 1 });
    let mut seen = BTreeSet::new();
    let mut random = Random::new(7);
    for _ in 0..50 {
        // Readers join and leave as fast as possible, and each message ends an epoch.
        for _ in 0..100 {
            world.set_readers(&[random.below(8) as usize, random.below(8) as usize]);
            world.ring.used(1, 1);
            world.settle();
            seen.insert(world.ring.current().0);
            world.now += random.below(300) * MS;
        }
        world.now += SECOND;
        let last = world.ring.current().0;
        assert!(u64::from(last) <= world.now / SECOND, "epochs outran the clock");
        world.restart();
        assert!(seen.insert(world.ring.current().0) && world.ring.current().0 > last);
        world.set_readers(&[0]);
        world.settle();
        assert_eq!(world.who_opens(), BTreeSet::from([0]), "nobody is locked out");
    }
}

#[test]
fn a_writer_that_restarts_with_a_clock_set_back_goes_on_after_the_epochs_that_readers_hold() {
    let mut world = World::new(2, Rotation::default());
    world.set_readers(&[0, 1]);
    world.settle();
    let before = world.ring.current().0;
    // The readers have long settled for the epoch, so older ones are over.
    world.now += 1000 * SECOND;
    let (readers_time, held) = (world.now, world.readers[0].store.newest(&world.writer.name()).unwrap().clone());
    world.now -= 3600 * SECOND;
    world.restart();
    world.set_readers(&[0, 1]);
    let (reader, other) = (world.readers[0].identity.name(), world.readers[1].identity.name());
    for boxes in std::iter::from_fn(|| world.poll()).collect::<Vec<_>>() {
        for signed in &boxes.boxes {
            for reader in &mut world.readers {
                reader.offer(readers_time, &world.writer, signed);
            }
        }
        world.ring.boxes_stored(boxes.epoch);
    }
    assert_eq!(world.who_opens(), BTreeSet::new());

    // What this writer has not signed, or for another reader, moves nothing.
    let mut claims = held.claims_unverified().unwrap();
    claims.epoch = u32::MAX;
    let forged = issue(world.readers[0].identity.key(), &claims).unwrap();
    assert!(!world.ring.take_newest(&reader, &forged) && !world.ring.take_newest(&other, &held));
    assert!(world.ring.take_newest(&reader, &held) && !world.ring.take_newest(&reader, &held), "once");
    world.now += SECOND;
    while let Some(boxes) = world.poll() {
        for signed in &boxes.boxes {
            world.readers.iter_mut().for_each(|reader| reader.offer(readers_time, &world.writer, signed));
        }
        world.ring.boxes_stored(boxes.epoch);
    }
    assert_eq!(world.ring.current().0, before + 1);
    assert_eq!(world.who_opens(), BTreeSet::from([0, 1]));
}

/// Readers join, leave, are revoked and return. Storing takes time or fails, the writer restarts,
/// and the box storage loses its boxes. A message always opens for exactly the readers with a box
/// of the current epoch. Soon afterwards, those are exactly the authorised readers.
#[test]
fn messages_open_for_those_who_hold_boxes() {
    for seed in 0..20 {
        let mut random = Random::new(seed);
        let rotation = Rotation { age: Duration::from_secs(30), messages: 400, bytes: 1 << 30 };
        let mut world = World::new(6, rotation);
        let mut allowed = BTreeSet::new();
        // Start time of each reader's revocation.
        let mut revoked: BTreeMap<usize, u64> = (0..6).map(|reader| (reader, START)).collect();
        let mut storing: Vec<(u64, Boxes)> = Vec::new();
        for _ in 0..400 {
            world.now += random.below(400) * MS;
            match random.below(40) {
                0 => world.ring.republish(),
                1 => {
                    world.now += SECOND;
                    world.restart();
                    storing.clear();
                    world.set_readers(&allowed.iter().copied().collect::<Vec<_>>());
                }
                2..=8 => {
                    let reader = random.below(6) as usize;
                    if allowed.remove(&reader) {
                        revoked.insert(reader, world.now);
                    } else {
                        allowed.insert(reader);
                        revoked.remove(&reader);
                    }
                    world.set_readers(&allowed.iter().copied().collect::<Vec<_>>());
                }
                _ => world.ring.used(random.below(20), 100),
            }
            while let Some(boxes) = world.poll() {
                // One store in four takes longer than the ring waits.
                let delay = if random.below(4) == 0 { 5 * SECOND } else { random.below(500) * MS };
                storing.push((world.now + delay, boxes));
            }
            assert!(world.ring.wake_at() > 0);
            let now = world.now;
            for (_, boxes) in storing.extract_if(.., |(at, _)| *at <= now) {
                world.store(&boxes);
            }
            world.check();
            let opening = world.who_opens();
            for (reader, since) in &revoked {
                let over = world.now >= since + 3 * SECOND + 400 * MS;
                assert!(!over || !opening.contains(reader), "seed {seed}: {reader} reads on after it was revoked");
            }
            // Every authorised reader has a box, or its box is being stored.
            let epoch = world.ring.current().0;
            for reader in &allowed {
                let on_the_way = storing.iter().any(|(_, boxes)| boxes.epoch == epoch);
                assert!(opening.contains(reader) || on_the_way, "seed {seed}: {reader} has no box of {epoch}");
            }
        }
        storing.drain(..).for_each(|(_, boxes)| world.store(&boxes));
        world.settle();
        world.now += 5 * SECOND;
        world.settle();
        assert_eq!(world.who_opens(), allowed, "seed {seed}");
    }
}

#[test]
fn readers_beyond_the_bounds_or_without_a_key_are_named() {
    let mut ring = KeyRing::new(NAME, &identity(1), Rotation::default(), START).unwrap();
    let box_key = identity(2).box_public();
    let mut readers: Vec<_> = (0..MAX_READERS + 2).map(|i| (numbered(i), box_key)).collect();
    readers[5].1 = [0xff; 33];
    let omitted = ring.set_readers(&readers);
    assert_eq!(omitted, [(numbered(5), Omission::BadBoxKey), (numbered(MAX_READERS + 1), Omission::TooMany)]);
    let (mut boxes, mut calls) = (0, 0);
    while let Some(handed) = ring.poll(START).unwrap() {
        assert!(handed.boxes.iter().map(|signed| signed.as_bytes().len()).sum::<usize>() < 48 << 10);
        boxes += handed.boxes.len();
        calls += 1;
    }
    assert_eq!((boxes, calls), (MAX_READERS, MAX_READERS / 16));
}

#[test]
fn a_reader_keeps_two_keys_of_a_writer_and_the_older_for_a_while() {
    let (writer, reader) = (identity(1), identity(2));
    let key = writer.key().verify_key();
    let mut store = KeyStore::new(NAME, &reader);
    let take = |store: &mut KeyStore, now, epoch, byte| {
        let content = EpochKey::from_bytes([byte; 32]);
        let signed = wrap(NAME, &writer, (reader.name(), &reader.box_public()), epoch, &content).unwrap();
        store
            .take(now, writer.name(), &key, &signed)
            .map(|opened| opened.map(|Opened { epoch, key, dropped }| (epoch, key.as_bytes()[0], dropped)))
    };
    let over = |epoch, newest| Err(StoreError::Over { epoch, newest });
    assert_eq!(take(&mut store, START, 12, 12), Ok(Some((12, 12, None))));
    assert_eq!(take(&mut store, START, 12, 12), Ok(None), "wrapped again");
    assert_eq!(take(&mut store, START, 10, 10), Ok(Some((10, 10, None))), "the two came in the other order");
    assert_eq!(take(&mut store, START, 11, 11), Ok(Some((11, 11, Some(10)))));
    assert_eq!(take(&mut store, START, 10, 10), over(10, 12));
    assert_eq!(store.expire(START + 60 * SECOND - 1), []);
    assert_eq!(store.expire(START + 60 * SECOND), [(writer.name(), 11)]);
    assert_eq!(take(&mut store, START + 60 * SECOND, 11, 11), over(11, 12), "repeated by somebody");
    assert_eq!(take(&mut store, START + 61 * SECOND, 13, 13), Ok(Some((13, 13, None))));
    assert_eq!(take(&mut store, START + 62 * SECOND, 14, 14), Ok(Some((14, 14, Some(12)))));
    assert_eq!(take(&mut store, START + 62 * SECOND, 14, 15), Ok(Some((14, 15, None))), "restarted within a second");
    store.forget(&writer.name());
    assert_eq!(take(&mut store, START + 62 * SECOND, 3, 3), Ok(Some((3, 3, None))), "it came back with another clock");
}

#[test]
fn a_reader_keeps_keys_of_so_many_writers() {
    let (writer, reader) = (identity(1), identity(2));
    let key = writer.key().verify_key();
    let mut store = KeyStore::new(NAME, &reader);
    let content = EpochKey::from_bytes([3; 32]);
    let template = wrap(NAME, &writer, (reader.name(), &reader.box_public()), 1, &content).unwrap();
    let claims = template.claims_unverified().unwrap();
    for i in 0..=MAX_WRITERS {
        let named = Identity::new(writer.key().clone(), &i.to_string());
        let signed = wrap(NAME, &named, (reader.name(), &reader.box_public()), 1, &content).unwrap();
        let result = store.take(START, named.name(), &key, &signed);
        assert_eq!(
            result.map(|opened| opened.is_some()),
            if i < MAX_WRITERS { Ok(true) } else { Err(StoreError::TooManyWriters) }
        );
    }
    // A refused box uses no slot.
    let forged = issue(writer.key(), &KeyBox { sealed: vec![0; claims.sealed.len()], ..claims }).unwrap();
    let mut store = KeyStore::new(NAME, &reader);
    assert!(store.take(START, writer.name(), &key, &forged).is_err());
    assert_eq!(format!("{store:?}"), format!("KeyStore({NAME:#}, 0 writers)"));
}

#[test]
fn nothing_prints_a_key() {
    let mut world = World::new(1, Rotation::default());
    world.set_readers(&[0]);
    let boxes = world.poll().unwrap();
    let opened =
        world.readers[0].store.take(START, world.writer.name(), &world.writer.key().verify_key(), &boxes.boxes[0]);
    let opened = opened.unwrap().unwrap();
    let text = format!("{:?} {opened:?} {boxes:?} {:?} {:?}", world.ring, world.readers[0].store, world.writer);
    let (_, key) = world.ring.current();
    assert_eq!(opened.key.as_bytes(), key.as_bytes());
    for secret in [hex::encode(&key.as_bytes()[..4]), format!("{:?}", &key.as_bytes()[..3]).replace(['[', ']'], "")] {
        assert!(!text.contains(&secret), "{text}");
    }
}

/// One writer of [`NAME`], its possible readers, and the stored boxes.
struct World {
    now: u64,
    writer: Identity,
    ring: KeyRing,
    rotation: Rotation,
    readers: Vec<Reader>,
    published: Vec<Signed<KeyBox>>,
    /// The readers that were given a box of each epoch.
    given: BTreeMap<u32, BTreeSet<Name>>,
}

struct Reader {
    identity: Identity,
    store: KeyStore,
    /// The keys for opening messages.
    keys: HashMap<u32, EpochKey>,
}

impl World {
    fn new(readers: u8, rotation: Rotation) -> Self {
        let writer = identity(1);
        let ring = KeyRing::new(NAME, &writer, rotation, START).unwrap();
        let readers = (0..readers).map(|i| Reader::new(identity(10 + i))).collect();
        Self { now: START, writer, ring, rotation, readers, published: vec![], given: BTreeMap::new() }
    }

    fn restart(&mut self) {
        self.ring = KeyRing::new(NAME, &self.writer, self.rotation, self.now).unwrap();
    }

    fn set_readers(&mut self, readers: &[usize]) {
        let keys = |&reader: &usize| (self.readers[reader].identity.name(), self.readers[reader].identity.box_public());
        assert_eq!(self.ring.set_readers(&readers.iter().map(keys).collect::<Vec<_>>()), []);
    }

    fn poll(&mut self) -> Option<Boxes> {
        self.ring.poll(self.now).unwrap()
    }

    /// Stores and delivers all boxes immediately.
    fn settle(&mut self) {
        while let Some(boxes) = self.poll() {
            self.store(&boxes);
        }
    }

    fn store(&mut self, boxes: &Boxes) {
        for signed in &boxes.boxes {
            let claims = signed.claims_unverified().unwrap();
            assert_eq!(claims.epoch, boxes.epoch);
            self.given.entry(claims.epoch).or_default().insert(claims.reader);
            let addressee = self.readers.iter_mut().find(|reader| reader.identity.name() == claims.reader).unwrap();
            addressee.offer(self.now, &self.writer, signed);
        }
        self.published.extend_from_slice(&boxes.boxes);
        self.ring.boxes_stored(boxes.epoch);
    }

    /// Returns the readers that can open a message sealed now.
    fn who_opens(&self) -> BTreeSet<usize> {
        let (epoch, key) = self.ring.current();
        let mut message = *b"a message";
        let tag = aead(key).seal(&[0; NONCE_LEN], &[], &mut message).unwrap();
        let opens = |reader: &Reader| reader.opens(epoch, &message, &tag);
        self.readers.iter().enumerate().filter(|(_, reader)| opens(reader)).map(|(i, _)| i).collect()
    }

    fn check(&mut self) {
        let holds = |reader: &Reader| {
            let given = self.given.get(&self.ring.current().0);
            given.is_some_and(|given| given.contains(&reader.identity.name()))
        };
        let holders = self.readers.iter().enumerate().filter(|(_, reader)| holds(reader)).map(|(i, _)| i);
        assert_eq!(self.who_opens(), holders.collect());
        for reader in &mut self.readers {
            for (_, epoch) in reader.store.expire(self.now) {
                reader.keys.remove(&epoch);
            }
            assert!(reader.keys.len() <= 2);
        }
    }
}

impl Reader {
    fn new(identity: Identity) -> Self {
        Self { store: KeyStore::new(NAME, &identity), identity, keys: HashMap::new() }
    }

    fn offer(&mut self, now: u64, writer: &Identity, signed: &Signed<KeyBox>) {
        if let Ok(Some(opened)) = self.store.take(now, writer.name(), &writer.key().verify_key(), signed) {
            self.keys.insert(opened.epoch, opened.key);
            opened.dropped.map(|epoch| self.keys.remove(&epoch));
        }
    }

    fn opens(&self, epoch: u32, message: &[u8], tag: &[u8; TAG_LEN]) -> bool {
        let opened = |key| aead(key).open(&[0; NONCE_LEN], &[], message, tag, &mut vec![0; message.len()]).is_ok();
        self.keys.get(&epoch).is_some_and(opened)
    }
}

fn aead(key: &EpochKey) -> gdp_core::crypto::Aead {
    Backend::selected().aead(key.as_bytes()).unwrap()
}

fn identity(seed: u8) -> Identity {
    Identity::new(SigningKey::from_secret_bytes(&[seed; 32]).unwrap(), "proxy")
}

fn numbered(i: usize) -> Name {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&(i as u64).to_be_bytes());
    Name::from_bytes(bytes)
}
