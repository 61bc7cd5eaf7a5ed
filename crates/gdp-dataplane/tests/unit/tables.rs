//! Unit tests of `tables`.

use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::groups::Groups;

/// Number of names that always have a route, though it changes. Each name leads to one of two links
/// of its own.
const HELD: u32 = 32;

/// Number of names that are added and removed; the table grows three times for them.
const COMERS: u32 = 6000;

fn name(number: u32) -> Name {
    Name::from_bytes(std::array::from_fn(|at| if at < 4 { number.to_be_bytes()[at] } else { 7 }))
}

fn to(generation: u64) -> LinkAddr {
    LinkAddr::Ethernet { ifindex: generation as u32, mac: [2; 6] }
}

fn link(id: u32, generation: u64) -> LinkEntry {
    let keys = [[generation; 2]; 2];
    LinkEntry { id, role: LinkRole::Endpoint as u32, rx_keys: keys, tx_keys: keys, ..LinkEntry::default() }
}

fn permit(number: u32, link: u32) -> Permit {
    Permit { name: name(number), link, part: Permit::DESTINATION }
}

fn tables(limit: u32) -> UserTables {
    UserTables::new(LinkMemory::new(), limit).unwrap()
}

/// Returns the link ids of a name that always has a route.
fn links_of(number: u32) -> [u32; 2] {
    [100 + 2 * number, 101 + 2 * number]
}

/// Link for which one name always has a permit.
const ALWAYS: u32 = 7;
const NEVER: u32 = 8;
/// Link that is added and removed repeatedly.
const AT_TIMES: u32 = 5;
/// Group that always exists, though its readers change.
const HELD_GROUP: u32 = 1 << 30;
const HELD_READERS: [[u32; 3]; 2] = [[1, 2, 3], [4, 5, 6]];

struct Writer {
    tables: UserTables,
    groups: Groups,
}

impl Writer {
    fn new() -> Self {
        let mut writer = Self { tables: tables(HELD + COMERS + 1), groups: Groups::default() };
        writer.change_held(0);
        writer.tables.set_group(HELD_GROUP, &HELD_READERS[0]);
        let entry = FibEntry { group: HELD_GROUP, ..FibEntry::default() };
        writer.tables.set_route(name(HELD), entry, &[]).unwrap();
        writer
    }

    /// Changes all lasting entries to their next version. As in the planes, a group gets the lowest
    /// free number.
    fn change_held(&mut self, generation: u64) {
        for number in 0..HELD {
            let links = links_of(number);
            links.iter().for_each(|id| drop(self.tables.set_link(link(*id, generation), to(generation))));
            let leads_to = links[generation as usize % 2];
            let readers: Vec<u32> = (0..3).map(|i| number << 8 | (generation as u32 % 4) << 4 | i).collect();
            let (group, is_new) = self.groups.take(&readers);
            if is_new {
                self.tables.set_group(group, &readers);
            }
            let entry = FibEntry { local_link: leads_to, group, writer_link: number, ..FibEntry::default() };
            let others = [permit(number, ALWAYS), permit(number, 20 + generation as u32 % 2)];
            let before = self.tables.set_route(name(number), entry, &others).unwrap();
            if let Some((before, _)) = before
                && self.groups.release(before.group)
            {
                self.tables.set_group(before.group, &[]);
            }
        }
        self.tables.set_group(HELD_GROUP, &HELD_READERS[generation as usize % 2]);
        match generation % 2 {
            0 => drop(self.tables.set_link(link(AT_TIMES, generation), to(generation))),
            _ => drop(self.tables.remove_link(AT_TIMES)),
        }
    }

    fn run(&mut self) {
        let mut generation = 0;
        for number in 0..COMERS {
            let entry = FibEntry { writer_link: number, ..FibEntry::default() };
            self.tables.set_route(name(HELD + 1 + number), entry, &[]).unwrap();
            if number.is_multiple_of(100) {
                generation += 1;
                self.change_held(generation);
            }
        }
        for number in 0..COMERS {
            self.tables.remove_route(&name(HELD + 1 + number)).unwrap();
        }
    }
}

fn read(tables: &View<'_>, pass: u32) {
    for number in 0..HELD {
        tables.prefetch(&name(number + 1));
        let entry = tables.route(&name(number)).expect("it held all the time");
        assert_eq!(entry.writer_link, number);
        assert!(links_of(number).contains(&entry.local_link), "{entry:?}");
        let link = tables.link(entry.local_link).expect("it held all the time");
        assert_eq!((link.id, link.rx_keys), (entry.local_link, link.tx_keys));
        assert_eq!(tables.address(link.id), Some(to(link.rx_keys[0][0])), "they are of one time");
        let members: Vec<u32> = tables.members(entry.group).collect();
        // Empty if the group was removed meanwhile, but never the readers of another group.
        assert!(members.is_empty() || members.len() == 3, "{members:?}");
        assert!(members.iter().zip(&members[members.len().min(1)..]).all(|(a, b)| a + 1 == *b), "{members:?}");
        assert!(members.iter().all(|id| id >> 8 == number), "{members:?} of name {number}");
        assert!(tables.is_permitted(&permit(number, ALWAYS)), "it held all the time");
        assert!(!tables.is_permitted(&permit(number, NEVER)));
    }
    let held = tables.route(&name(HELD)).expect("it held all the time");
    let members: Vec<u32> = tables.members(held.group).collect();
    assert!(HELD_READERS.iter().any(|readers| *readers == members[..]), "{members:?}");
    assert!(tables.link(AT_TIMES).is_none_or(|link| link.id == AT_TIMES));
    for number in (0..COMERS).skip(pass as usize % 61).step_by(61) {
        let found = tables.route(&name(HELD + 1 + number));
        assert!(found.is_none_or(|entry| entry.writer_link == number), "{found:?}");
    }
}

#[test]
fn threads_read_what_holds_and_nothing_wrong_while_all_of_it_changes() {
    for _ in 0..2 {
        let (mut writer, done) = (Writer::new(), AtomicBool::new(false));
        std::thread::scope(|scope| {
            let reader = writer.tables.reader();
            let readers = [(); 3].map(|()| {
                let (mut reader, done) = (reader.clone(), &done);
                scope.spawn(move || {
                    let mut passes = 0;
                    while !done.load(Ordering::Acquire) {
                        read(&reader.enter(), passes);
                        passes += 1;
                    }
                    let tables = reader.enter();
                    assert!((0..COMERS).all(|number| tables.route(&name(HELD + 1 + number)).is_none()));
                    passes
                })
            });
            writer.run();
            done.store(true, Ordering::Release);
            assert!(readers.into_iter().all(|reader| reader.join().unwrap() > 10));
        });
        assert_eq!(writer.tables.routes().count(), HELD as usize + 1);
        assert!(writer.tables.common.groups.len() <= HELD as usize + 1, "no group stays that nothing leads to");
        assert_eq!(writer.tables.common.permits.len(), 2 * HELD as usize);
    }
}

#[test]
fn a_link_lasts_until_the_last_reader_has_entered_again() {
    let mut tables = tables(8);
    tables.set_link(link(1, 1), to(1));
    let of_link_1 = |tables: &UserTables| tables.now.links[1].as_ref().map(Arc::downgrade).unwrap();
    let held = of_link_1(&tables);
    let (mut one, mut other) = (tables.reader(), tables.reader());
    let view = one.enter();
    tables.remove_link(1).unwrap();
    assert_eq!(view.link(1).map(|link| link.id), Some(1), "it is for the batch");
    other.enter();
    assert!(held.upgrade().is_some());
    drop(view);
    assert!(one.enter().link(1).is_none());
    assert!(held.upgrade().is_none(), "nobody can read it any more");

    tables.set_link(link(1, 2), to(2));
    let (held, reader) = (of_link_1(&tables), tables.reader());
    assert!(tables.remove_link(1).is_some_and(|link| link.rx_keys[0] == [2; 2]));
    assert!(tables.remove_link(1).is_none());
    [one, other].iter_mut().for_each(|reader| drop(reader.enter()));
    assert!(held.upgrade().is_some());
    drop(reader);
    assert!(held.upgrade().is_none());
}

#[test]
fn routes_are_as_they_were_set_and_no_more_than_may_be() {
    let mut tables = tables(3000);
    let entry = |number: u32| FibEntry { writer_link: number, group: 9, ..FibEntry::default() };
    tables.set_group(9, &[4, 5]);
    for number in 0..3000 {
        assert!(tables.has_room_for(&name(number)));
        assert_eq!(tables.set_route(name(number), entry(number), &[permit(number, 1)]).unwrap(), None);
    }
    assert!(!tables.has_room_for(&name(3000)) && tables.has_room_for(&name(2999)));
    let error = tables.set_route(name(3000), entry(0), &[permit(3000, 1)]).unwrap_err();
    assert!(matches!(error, UpdateError::FibFull { capacity: 3000 }), "{error}");
    let mut reader = tables.reader();
    assert!(!reader.enter().is_permitted(&permit(3000, 1)), "nothing has changed");

    let before = tables.set_route(name(7), entry(8), &[permit(7, 2)]).unwrap();
    assert_eq!(before, Some((entry(7), [permit(7, 1)].into())));
    assert_eq!([1, 2].map(|link| reader.enter().is_permitted(&permit(7, link))), [false, true]);
    assert_eq!((tables.route(&name(7)), tables.permits(&name(7))), (Some(entry(8)), &[permit(7, 2)][..]));
    let number_1 = tables.routes().find(|(found, _)| *found == name(1));
    assert_eq!(number_1, Some((name(1), entry(1))), "by the number that the group was given");
    assert_eq!(tables.remove_route(&name(7)), Some((entry(8), [permit(7, 2)].into())));
    assert_eq!((tables.remove_route(&name(7)), tables.route(&name(7))), (None, None));
    assert!(!reader.enter().is_permitted(&permit(7, 2)) && tables.has_room_for(&name(3000)));

    let switch = LinkEntry { role: LinkRole::Switch as u32, ..link(6, 1) };
    tables.set_link(switch, to(1));
    assert_eq!((tables.members(9), tables.members(NEIGHBOURS)), (vec![4, 5, 6], vec![6]));
    let view = reader.enter();
    let group = view.route(&name(1)).unwrap().group;
    assert_eq!(view.members(group).collect::<Vec<_>>(), [4, 5, 6]);
    tables.set_group(9, &[]);
    tables.set_group(9, &[3]);
    assert_eq!(view.members(group).collect::<Vec<_>>(), [6], "the number is another's now");
    assert_eq!(tables.members(9), [3, 6]);
}
