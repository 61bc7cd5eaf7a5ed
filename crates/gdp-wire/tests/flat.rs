//! Tests of the flat table: against a map of the standard library, with racing threads, and after
//! the death of a writer.

use std::cell::Cell;
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use gdp_wire::flat::{
    BUCKET, Full, Memory, NotATable, Table, Words, buckets_for, count, from_words, lookup, names_in, to_words,
};
use gdp_wire::{FibEntry, Name};

const KEY: [u64; 2] = [0x0123_4567_89ab_cdef, 0xfedc_ba98_7654_3210];

#[test]
fn it_agrees_with_a_map() {
    for (names, meant_for) in [(1u32, 1), (12, 8), (30, 16), (5000, 5000), (6000, 4096)] {
        let mut table = Table::begin(memory(meant_for), KEY).unwrap();
        let mut map = HashMap::new();
        let mut random = Random(names as u64);
        for round in 0..200_000u64 {
            let i = random.below(names as usize * 5 / 4);
            match random.below(8) {
                0..3 => assert_eq!(table.remove(&name(i)), map.remove(&i).is_some()),
                _ if map.len() == names as usize && !map.contains_key(&i) => {}
                _ => {
                    table.insert(&name(i), entry(i, round)).unwrap();
                    map.insert(i, entry(i, round));
                }
            }
            assert_eq!(table.get(&name(i)), map.get(&i).copied());
            let other = random.below(names as usize * 2);
            assert_eq!(table.get(&name(other)), map.get(&other).copied());
            assert_eq!(table.len() as usize, map.len());
        }
        same(&table, &map);
        (0..2 * names as usize).for_each(|i| assert_eq!(table.remove(&name(i)), map.contains_key(&i)));
        assert!(table.is_empty() && table.iter().next().is_none());
    }
}

#[test]
fn a_table_takes_the_names_it_is_meant_for() {
    assert_eq!((buckets_for(0), buckets_for(1), buckets_for(9), buckets_for(1 << 20)), (3, 3, 5, (1 << 18) + 1));
    assert_eq!(names_in(buckets_for(1 << 20)), 1 << 20);
    for names in [8, 64, 1 << 10, 1 << 16] {
        for seed in 0..20 {
            let mut table = Table::begin(memory(names), [seed, !seed]).unwrap();
            assert_eq!(table.capacity(), names);
            table.insert_all(&routes(names as usize, 1)).unwrap();
            assert_eq!(table.len(), names);
            assert!((0..names as usize).all(|i| table.get(&name(i)) == Some(entry(i, 1))));
        }
    }
}

/// The worst case of chosen names: all start in the same line.
#[test]
fn names_that_share_a_path_fill_it_and_no_more() {
    let mut table = Table::begin(memory(1024), KEY).unwrap();
    let same_first_word = |i: usize| {
        let mut bytes = [7; 32];
        bytes[31] = i as u8;
        Name::from_bytes(bytes)
    };
    for round in 0..3 {
        for i in 0..16 {
            table.insert(&same_first_word(i), entry(i, round)).unwrap();
        }
        assert_eq!(table.insert(&same_first_word(16), entry(16, 1)), Err(Full));
        assert_eq!(table.insert(&same_first_word(3), entry(3, round + 9)), Err(Full), "no free line to change it with");
        assert!(table.remove(&same_first_word(5)));
        table.insert(&same_first_word(3), entry(3, round + 9)).unwrap();
        assert_eq!(table.get(&same_first_word(3)), Some(entry(3, round + 9)));
        assert!(
            (0..16).filter(|i| ![3, 5].contains(i)).all(|i| table.get(&same_first_word(i)) == Some(entry(i, round)))
        );
        assert_eq!((table.get(&same_first_word(5)), table.get(&same_first_word(16))), (None, None));
        (0..16).filter(|i| *i != 5).for_each(|i| assert!(table.remove(&same_first_word(i))));
    }
}

#[test]
fn a_name_that_is_not_there_costs_little() {
    let memory = memory(4096);
    let mut table = Table::begin(&*memory, KEY).unwrap();
    for _ in 0..3 {
        table.insert_all(&routes(4096, 0)).unwrap();
        assert_eq!(count(&memory), 4096);
        (0..4096).for_each(|i| assert!(table.remove(&name(i))));
    }
    let touched = Touched { memory: &memory, words: Cell::new(0) };
    (0..1000).for_each(|i| assert_eq!(lookup(&&touched, &name(i)), None));
    assert_eq!(touched.words.get(), 2000, "one word each, read twice: removals leave no marks behind");
}

/// A lookup finds only routes of its name that were valid during the lookup, and always finds names
/// that are never removed. The table has half its regular size, so that names move and use their
/// second bucket.
#[test]
fn readers_that_race_with_the_writer_find_what_was_or_what_is() {
    const NAMES: usize = 96;
    // These names are never removed. The writer adds and removes the others around them.
    const KEPT: usize = 32;
    const CHANGES: u64 = 3_000_000;
    let memory = memory(NAMES as u32 / 2);
    let (begun, done) = ([const { AtomicU64::new(0) }; NAMES], [const { AtomicU64::new(0) }; NAMES]);
    let over = AtomicBool::new(false);
    let mut table = Table::begin(&*memory, KEY).unwrap();
    (0..NAMES).for_each(|i| table.insert(&name(i), entry(i, 0)).unwrap());
    std::thread::scope(|scope| {
        let readers: Vec<_> = (0..3)
            .map(|reader| {
                let (memory, begun, done, over) = (&*memory, &begun, &done, &over);
                scope.spawn(move || {
                    let (mut random, mut found) = (Random(reader), 0u64);
                    while !over.load(Ordering::Relaxed) {
                        let i = random.below(NAMES + 8);
                        if i >= NAMES {
                            assert_eq!(lookup(&memory, &name(i)), None);
                            continue;
                        }
                        let earliest = done[i].load(Ordering::SeqCst);
                        let route = lookup(&memory, &name(i));
                        let latest = begun[i].load(Ordering::SeqCst);
                        match route {
                            Some(route) => {
                                let [change, ..] = to_words(route);
                                assert_eq!(route, entry(i, change), "another name's, or torn");
                                assert!((earliest..=latest).contains(&change), "{change} of {earliest} to {latest}");
                                found += 1;
                            }
                            None => assert!(i >= KEPT, "name {i} was missed"),
                        }
                    }
                    found
                })
            })
            .collect();
        let mut random = Random(99);
        for change in 1..=CHANGES {
            let i = random.below(NAMES);
            if i >= KEPT && random.below(2) == 0 {
                table.remove(&name(i));
                continue;
            }
            begun[i].store(change, Ordering::SeqCst);
            table.insert(&name(i), entry(i, change)).unwrap();
            done[i].store(change, Ordering::SeqCst);
        }
        over.store(true, Ordering::Relaxed);
        for reader in readers {
            assert!(reader.join().expect("no panic") > 1000);
        }
    });
}

/// A writer may die between any two of its accesses. Its successor can adopt the table; only the
/// name in progress may be old or new. The table has half its regular size here, too.
#[test]
fn a_table_is_adopted_wherever_its_writer_died() {
    const NAMES: usize = 48;
    for death in 1.. {
        let memory = memory(NAMES as u32 / 2);
        let mut random = Random(5);
        let mut map = HashMap::new();
        let mut table = Table::begin(&*memory, KEY).unwrap();
        for i in 0..NAMES {
            table.insert(&name(i), entry(i, 0)).unwrap();
            map.insert(i, entry(i, 0));
        }
        let mortal = Mortal { memory: &memory, left: Cell::new(u32::MAX) };
        let mut table = Table::adopt(&mortal).unwrap();
        mortal.left.set(death);
        let mut at = 0;
        let died = catch_unwind(AssertUnwindSafe(|| {
            for round in 1..60 {
                at = random.below(NAMES);
                if random.below(3) == 0 {
                    table.remove(&name(at));
                    map.remove(&at);
                } else {
                    map.insert(at, entry(at, round));
                    table.insert(&name(at), entry(at, round)).unwrap();
                }
            }
        }))
        .is_err();
        let mut table = Table::adopt(&*memory).unwrap();
        for i in (0..NAMES).filter(|i| !died || *i != at) {
            assert_eq!(table.get(&name(i)), map.get(&i).copied(), "death {death}");
        }
        if let Some(route) = table.get(&name(at)) {
            assert_eq!(route, entry(at, to_words(route)[0]), "death {death}");
        }
        let listed: Vec<_> = table.iter().collect();
        assert_eq!(listed.len(), table.len() as usize);
        assert!(listed.iter().all(|(name, entry)| table.get(name) == Some(*entry)), "death {death}");
        table.insert(&name(at), entry(at, 99)).unwrap();
        (0..NAMES).for_each(|i| assert_eq!(table.remove(&name(i)), i == at || map.contains_key(&i), "death {death}"));
        let untouched = table_is_clean(&memory);
        assert!(untouched, "death {death}: marks stay behind");
        if !died {
            return;
        }
    }
}

#[test]
fn what_is_no_table_is_refused() {
    let refused = |words: usize| Table::begin(zeros(words), KEY).err();
    for words in [0, BUCKET, 2 * BUCKET, 3 * BUCKET - 1, 4 * BUCKET, 6 * BUCKET] {
        assert_eq!(refused(words), Some(NotATable), "{words}");
    }
    assert_eq!(Table::adopt(zeros(3 * BUCKET)).err(), Some(NotATable), "no header");
    let small = zeros(3 * BUCKET);
    small[0].store(7, Ordering::Relaxed);
    assert_eq!(Table::adopt(small).err(), Some(NotATable), "another size");
}

fn same(table: &Table<Box<[AtomicU64]>>, map: &HashMap<usize, FibEntry>) {
    let listed: HashMap<Name, FibEntry> = table.iter().collect();
    assert_eq!(listed, map.iter().map(|(i, entry)| (name(*i), *entry)).collect());
}

/// Returns whether no line is live or marked.
fn table_is_clean(memory: &[AtomicU64]) -> bool {
    const LIVE_OR_PASSED: u64 = 3;
    memory[BUCKET..].iter().step_by(8).all(|state| state.load(Ordering::Relaxed) & LIVE_OR_PASSED == 0)
}

/// Returns the first `names` names with their routes after a change.
fn routes(names: usize, change: u64) -> Vec<(Name, FibEntry)> {
    (0..names).map(|i| (name(i), entry(i, change))).collect()
}

/// Returns the `i`-th name.
fn name(i: usize) -> Name {
    let mut random = Random(i as u64 ^ 0x9e37_79b9_7f4a_7c15);
    Name::from_bytes(std::array::from_fn(|_| random.next() as u8))
}

/// Returns an entry that contains its name's number and change in its words.
fn entry(i: usize, change: u64) -> FibEntry {
    from_words([change, i as u64, !change])
}

fn memory(names: u32) -> Box<[AtomicU64]> {
    zeros(buckets_for(names) as usize * BUCKET)
}

fn zeros(words: usize) -> Box<[AtomicU64]> {
    (0..words).map(|_| AtomicU64::new(0)).collect()
}

/// Memory whose owner dies after `left` accesses.
struct Mortal<'m> {
    memory: &'m [AtomicU64],
    left: Cell<u32>,
}

impl AsRef<[AtomicU64]> for Mortal<'_> {
    fn as_ref(&self) -> &[AtomicU64] {
        self.left.set(self.left.get().checked_sub(1).expect("alive"));
        self.memory
    }
}

/// Memory that counts the words read from it, without the header.
struct Touched<'m> {
    memory: &'m [AtomicU64],
    words: Cell<usize>,
}

#[derive(Clone, Copy)]
struct TouchedBucket<'t>(&'t Touched<'t>, u32);

impl<'t> Memory for &'t Touched<'t> {
    type Bucket = TouchedBucket<'t>;

    fn bucket(&self, index: u32) -> Option<TouchedBucket<'t>> {
        Some(TouchedBucket(self, index))
    }
}

impl Words for TouchedBucket<'_> {
    fn load(self, index: usize) -> u64 {
        let Self(touched, bucket) = self;
        touched.words.update(|words| words + usize::from(bucket > 0));
        touched.memory[bucket as usize * BUCKET + index].load(Ordering::Relaxed)
    }

    fn after(self, _: u64) -> Self {
        self
    }
}

/// A linear congruential generator: the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 ^ self.0 >> 29) >> 8
    }

    fn below(&mut self, limit: usize) -> usize {
        self.next() as usize % limit
    }
}
