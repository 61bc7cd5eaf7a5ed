//! Unit tests of `serve::routes`: pushes, links, restarts, and the resulting data-plane changes.

use gdp_wire::LinkEntry;

use super::*;

#[test]
fn names_become_links_and_follow_them() {
    let mut r = Routes::default();
    let first = push(1, Extent::Full { part: 0, last: true }, vec![route(1, 0, &[7]), route(2, 4, &[])]);
    let changes = r.push(&first).unwrap();
    assert_eq!(changes[0], PlaneChange::OwnBit(2));
    assert!(changes.contains(&PlaneChange::Remove(name(1))), "its endpoint has no link yet");
    assert!(changes.contains(&set(2, 4, &[], &[])));

    assert_eq!(r.link_up(LinkRole::Endpoint, name(7), 0, 70), [set(1, 0, &[70], &[])]);
    assert_eq!(r.link_ready(LinkRole::Endpoint, name(7), 70), [], "it is the one in use already");
    assert_eq!(
        r.link_up(LinkRole::Endpoint, name(7), 0, 71),
        [set(1, 0, &[70], &[])],
        "not before it takes frames there"
    );
    assert_eq!(r.link_ready(LinkRole::Endpoint, name(7), 71), [set(1, 0, &[71], &[])], "it moved");
    assert!(r.is_replaced(LinkRole::Endpoint, &name(7), 70));
    assert_eq!(
        gone(&mut r, LinkRole::Endpoint, name(7), 70),
        [set(1, 0, &[71], &[])],
        "the old link no longer matters"
    );
    assert_eq!(gone(&mut r, LinkRole::Endpoint, name(7), 71), [PlaneChange::Remove(name(1))]);

    assert_eq!(hops(&r.set_paths(&paths(), &name(0))[0])[..4], [0; 4], "there is no link");
    let changes = r.link_up(LinkRole::Switch, name(9), 0, 90);
    assert_eq!(changes[0], PlaneChange::Reach { link: 90, bits: 0b101 });
    assert_eq!(hops(&changes[1])[..4], [90, 0, 90, 0]);
    let changes = gone(&mut r, LinkRole::Switch, name(9), 90);
    assert_eq!(hops(&changes[0])[..4], [0; 4]);
}

#[test]
fn writers_become_links_and_lose_their_permission_with_them() {
    let mut r = Routes::default();
    let written = |by: &[u8]| Route { writers: by.iter().copied().map(name).collect(), ..route(1, 4, &[]) };
    let by = |writers: &[u32]| set(1, 4, &[], writers);
    let first = r.push(&push(1, Extent::Full { part: 0, last: true }, vec![written(&[7, 8, 9])])).unwrap();
    assert!(first.contains(&by(&[])), "none of them has a link");
    assert_eq!(r.link_up(LinkRole::Endpoint, name(8), 0, 80), [by(&[80])]);
    assert_eq!(r.link_up(LinkRole::Endpoint, name(7), 0, 70), [by(&[70, 80])]);
    assert_eq!([7, 6].map(|entity| r.leading_from(&name(entity))), [1, 0]);
    assert_eq!(r.link_up(LinkRole::Endpoint, name(9), 0, 90), [by(&[70, 80, 90])]);
    assert_eq!(r.link_up(LinkRole::Endpoint, name(6), 0, 60), [], "this one does not publish it");
    assert_eq!(r.push(&push(2, Extent::Delta, vec![written(&[8, 9])])).unwrap(), [by(&[80, 90])]);
    assert_eq!(gone(&mut r, LinkRole::Endpoint, name(7), 70), [], "nor does this one any more");
    assert_eq!(gone(&mut r, LinkRole::Endpoint, name(8), 80), [by(&[90])]);
    assert_eq!(gone(&mut r, LinkRole::Endpoint, name(9), 90), [by(&[])]);
}

#[test]
fn each_local_reader_has_its_link_and_a_reader_may_write() {
    let mut r = Routes::default();
    let both = Route { writers: vec![name(8)], ..route(1, 3, &[7, 8, 9]) };
    r.push(&push(1, Extent::Full { part: 0, last: true }, vec![both])).unwrap();
    assert_eq!(r.link_up(LinkRole::Endpoint, name(8), 0, 80), [set(1, 3, &[80], &[80])]);
    assert_eq!(r.link_up(LinkRole::Endpoint, name(9), 0, 60), [set(1, 3, &[60, 80], &[80])]);
    assert_eq!(gone(&mut r, LinkRole::Endpoint, name(8), 80), [set(1, 3, &[60], &[])]);
    assert_eq!(r.push(&push(2, Extent::Delta, vec![route(1, 0, &[7, 8])])).unwrap(), [PlaneChange::Remove(name(1))]);
}

#[test]
fn an_endpoint_with_two_links_takes_a_name_on_one_or_on_each() {
    let mut r = Routes::default();
    let each = Route { everywhere: vec![name(7)], ..route(2, 1, &[7, 8]) };
    let written = Route { writers: vec![name(7)], ..route(3, 4, &[]) };
    r.push(&push(1, Extent::Full { part: 0, last: true }, vec![route(1, 1, &[7]), each, written])).unwrap();
    for (lane, link) in [(0, 70), (1, 71)] {
        r.link_up(LinkRole::Endpoint, name(7), lane, link);
        r.link_ready(LinkRole::Endpoint, name(7), link);
    }
    let changes = r.link_up(LinkRole::Endpoint, name(8), 0, 80);
    assert_eq!(changes, [set(2, 1, &[70, 71, 80], &[])]);
    assert_eq!(r.link_preferred(name(7), 70), [], "it is the first");
    assert_eq!(r.link_preferred(name(7), 71), [set(1, 1, &[71], &[])]);
    assert_eq!(r.link_to(&name(7)), Some(71));
    let changes = gone(&mut r, LinkRole::Endpoint, name(7), 71);
    assert_eq!(changes, [set(1, 1, &[70], &[]), set(2, 1, &[70, 80], &[]), set(3, 4, &[], &[70])]);
}

#[test]
fn the_whole_sweeps_what_it_does_not_name() {
    let mut r = Routes::default();
    r.push(&push(1, Extent::Full { part: 0, last: true }, vec![route(1, 1, &[]), route(2, 1, &[])])).unwrap();
    let changes = r.push(&push(9, Extent::Full { part: 0, last: false }, vec![route(3, 1, &[])])).unwrap();
    assert_eq!(changes, [set(3, 1, &[], &[])], "nothing is swept before the last part");
    let changes = r.push(&push(10, Extent::Full { part: 1, last: true }, vec![route(2, 1, &[])])).unwrap();
    assert_eq!(changes, [PlaneChange::Remove(name(1))], "and what was confirmed is not touched");
    assert_eq!(r.len(), 2);
}

/// An earlier daemon with endpoint 7 as a reader and neighbour 9 toward switches 0 and 2, adopted
/// by a second daemon.
#[test]
fn what_a_daemon_left_is_forwarded_by_until_the_rib_knows_all() {
    let mut r = Routes::default();
    let plane = |readers: &[u32], writers: &[u32]| PlaneRoute {
        egress_bits: 6,
        readers: readers.to_vec(),
        writers: writers.to_vec(),
        sources: vec![],
    };
    let mut next_hops = [0; 64];
    (next_hops[0], next_hops[2]) = (90, 90);
    let routes =
        vec![(name(1), plane(&[70], &[80])), (name(2), plane(&[], &[ANY_WRITER])), (name(3), plane(&[60], &[]))];
    let link = |id, role: LinkRole, peer| (LinkEntry { id, peer: name(peer), ..LinkEntry::default() }.into(), role);
    let links = [
        link(70, LinkRole::Endpoint, 7),
        link(69, LinkRole::Endpoint, 7),
        link(80, LinkRole::Endpoint, 8),
        link(90, LinkRole::Switch, 9),
    ];
    let left = Left { own_bit: 2, links: vec![], routes, next_hops };
    assert_eq!(r.adopt(&left, &links), [set(3, 6, &[], &[])], "one link was not found again");
    assert_eq!((r.own_bit(), r.len()), (Some(1), 3));

    // The writer is back before the first push of the RIB, and may send on both links.
    assert_eq!(r.link_up(LinkRole::Endpoint, name(8), 0, 81), [set(1, 6, &[70], &[80, 81])]);
    // The neighbour is back, but is ready on the new link a little later.
    let changes = r.link_up(LinkRole::Switch, name(9), 0, 91);
    assert_eq!(changes[0], PlaneChange::Reach { link: 90, bits: 0b101 });
    assert_eq!(hops(&changes[1])[..3], [90, 0, 90]);
    assert_eq!(changes[2], PlaneChange::Reach { link: 91, bits: 0 }, "no frame goes twice");
    let changes = r.link_ready(LinkRole::Switch, name(9), 91);
    assert_eq!(changes[0], PlaneChange::Reach { link: 91, bits: 0b101 });
    assert_eq!(hops(&changes[1])[..3], [91, 0, 91]);
    assert_eq!(changes[2], PlaneChange::Reach { link: 90, bits: 0 });

    // The new RIB does not know them yet.
    let mut first = push(1, Extent::Full { part: 0, last: true }, vec![route(1, 2, &[6])]);
    first.settling = true;
    let same = set(1, 6, &[70], &[80, 81]);
    assert_eq!(r.push(&first).unwrap(), [same], "it adds an endpoint that has no link yet");
    assert_eq!(r.link_up(LinkRole::Endpoint, name(6), 0, 65), [set(1, 6, &[65, 70], &[80, 81])]);
    let mut taken_back = push(2, Extent::Delta, vec![]);
    (taken_back.settling, taken_back.remove) = (true, vec![name(2)]);
    assert_eq!(r.push(&taken_back).unwrap(), [PlaneChange::Remove(name(2))]);

    // The RIB now knows everything.
    let whole = push(3, Extent::Full { part: 0, last: true }, vec![route(1, 2, &[6])]);
    let mut changes = r.push(&whole).unwrap();
    changes.sort_by_key(|change| format!("{change:?}"));
    assert_eq!(changes, [PlaneChange::Remove(name(3)), set(1, 2, &[65], &[])]);
}

#[test]
fn what_a_daemon_left_of_an_endpoint_with_two_links_stays_on_them() {
    let mut r = Routes::default();
    let plane = |readers: &[u32]| PlaneRoute { egress_bits: 6, readers: readers.to_vec(), ..PlaneRoute::default() };
    let routes = vec![(name(1), plane(&[71])), (name(2), plane(&[70, 71]))];
    let link = |id, lane| (LinkEntry { id, lane, peer: name(7), ..LinkEntry::default() }.into(), LinkRole::Endpoint);
    let links = [link(70, 0), link(71, 1), link(69, 1)];
    let left = Left { own_bit: 2, links: vec![], routes, next_hops: [0; 64] };
    assert_eq!(r.adopt(&left, &links), [], "nothing moves");
    assert_eq!(r.link_to(&name(7)), Some(71));

    // One lane is back before the other.
    r.link_up(LinkRole::Endpoint, name(7), 1, 81);
    let changes = r.link_ready(LinkRole::Endpoint, name(7), 81);
    assert_eq!(changes, [set(1, 6, &[81], &[]), set(2, 6, &[70, 81], &[])]);
}

#[test]
fn in_the_end_nobody_writes_who_is_not_known_to() {
    let mut r = Routes::default();
    let open = PlaneRoute { egress_bits: 6, writers: vec![ANY_WRITER], ..PlaneRoute::default() };
    let routes = vec![(name(1), open.clone()), (name(2), open)];
    let left = Left { own_bit: 2, links: vec![], routes, next_hops: [0; 64] };
    r.adopt(&left, &[]);
    r.link_up(LinkRole::Endpoint, name(8), 0, 80);
    let known = Route { writers: vec![name(8)], ..route(1, 6, &[]) };
    let mut first = push(1, Extent::Full { part: 0, last: true }, vec![known]);
    first.settling = true;
    r.push(&first).unwrap();
    let mut changes = r.end_any_writer();
    changes.sort_by_key(|change| format!("{change:?}"));
    assert_eq!(changes, [set(1, 6, &[], &[80]), set(2, 6, &[], &[])]);
    assert_eq!(r.end_any_writer(), []);
}

#[test]
fn another_rib_sweeps_nothing_before_it_has_settled() {
    let mut r = Routes::default();
    r.push(&push(7, Extent::Full { part: 0, last: true }, vec![route(1, 1, &[]), route(2, 1, &[])])).unwrap();
    let by = |mut push: FibPush, settling| {
        (push.run, push.settling) = (2, settling);
        push
    };
    assert!(r.push(&by(push(8, Extent::Delta, vec![]), true)).is_err(), "it does not know what the switch holds");
    let whole = |generation, set| push(generation, Extent::Full { part: 0, last: true }, set);
    assert_eq!(r.push(&by(whole(1, vec![]), true)).unwrap(), []);
    assert_eq!(r.push(&by(push(2, Extent::Delta, vec![route(1, 2, &[])]), true)).unwrap(), [set(1, 3, &[], &[])]);
    assert_eq!(r.push(&by(whole(3, vec![route(1, 2, &[])]), true)).unwrap(), [], "nor the next time");
    assert_eq!(r.push(&by(whole(4, vec![]), true)).unwrap(), [set(1, 1, &[], &[])], "but what it said itself");
    let changes = r.push(&by(whole(5, vec![route(1, 2, &[])]), false)).unwrap();
    // The changes of each name are in order; the names are not.
    let (of_two, of_one) = changes.into_iter().partition::<Vec<_>, _>(|change| *change == PlaneChange::Remove(name(2)));
    assert_eq!((of_one, of_two.len()), (vec![set(1, 3, &[], &[]), set(1, 2, &[], &[])], 1));
}

/// An earlier daemon with neighbour 9 toward switches 0 and 2, and another neighbour.
#[test]
fn held_paths_count_where_the_topology_knows_none() {
    let mut r = Routes::default();
    let mut next_hops = [0; 64];
    (next_hops[0], next_hops[2]) = (90, 90);
    let link = LinkEntry { id: 90, peer: name(9), ..LinkEntry::default() };
    let left = Left { own_bit: 2, links: vec![], routes: vec![], next_hops };
    r.adopt(&left, &[(link.into(), LinkRole::Switch)]);
    r.link_up(LinkRole::Switch, name(8), 0, 80);
    let way = |neighbour, bits| Paths { reach: [(name(neighbour), bits)].into(), ..Paths::default() };
    let changes = r.set_paths(&way(8, 0b1100), &name(0));
    let next = changes.iter().find(|change| matches!(change, PlaneChange::NextHops(_))).unwrap();
    assert_eq!(hops(next)[..4], [90, 0, 80, 80]);
    assert!(changes.contains(&PlaneChange::Reach { link: 90, bits: 1 }));
    assert!(changes.contains(&PlaneChange::Reach { link: 80, bits: 0b1100 }));
    let changes = r.end_stale_paths();
    assert!(changes.contains(&PlaneChange::Reach { link: 90, bits: 0 }));
    assert_eq!(r.end_stale_paths(), []);
}

#[test]
fn a_bit_that_another_switch_had_before_is_not_taken() {
    let mut r = Routes::default();
    r.push(&push(1, Extent::Full { part: 0, last: true }, vec![])).unwrap();
    let of = |switch| Paths { bits: [(1, name(switch))].into(), ..Paths::default() };
    assert_eq!(r.set_paths(&of(0), &name(0)), []);
    assert_eq!(r.set_paths(&of(9), &name(0)), [PlaneChange::OwnBit(0)]);
    let another = FibPush { own_bit: 7, ..push(2, Extent::Delta, vec![]) };
    assert_eq!(r.push(&another).unwrap(), [], "not before the topology has it");
    assert_eq!(r.set_paths(&of(9), &name(0)), [PlaneChange::OwnBit(1 << 7)]);
}

/// A border with switch 7 of another domain, behind which is name 5.
#[test]
fn what_is_behind_a_border_is_reached_by_its_link_and_comes_by_it() {
    let mut r = Routes::default();
    let read = Route { writers: vec![name(8)], ..route(1, 2, &[7, 9]) };
    let written = Route { writers: vec![name(7)], ..route(2, 4, &[]) };
    let source = Route { arrives_by: vec![name(7)], ..route(5, 0, &[]) };
    r.push(&push(1, Extent::Full { part: 0, last: true }, vec![read, written, source])).unwrap();
    r.set_paths(&paths(), &name(0));
    let mut changes = r.link_up(LinkRole::Border, name(7), 0, 70);
    changes.sort_by_key(|change| format!("{change:?}"));
    let mut expected = [set(1, 2, &[70], &[]), set(2, 4, &[], &[70]), from(5, &[70])];
    expected.sort_by_key(|change| format!("{change:?}"));
    assert_eq!(changes, expected, "no masks, and no next hops");
    assert_eq!(r.link_up(LinkRole::Endpoint, name(8), 0, 80), [set(1, 2, &[70], &[80])]);

    // The link was made anew, so frames may arrive on both.
    assert!(r.link_up(LinkRole::Border, name(7), 0, 71).contains(&from(5, &[70, 71])));
    let changes = r.link_ready(LinkRole::Border, name(7), 71);
    assert!(changes.contains(&set(1, 2, &[71], &[80])) && changes.contains(&set(2, 4, &[], &[70, 71])));
    assert!(gone(&mut r, LinkRole::Border, name(7), 70).contains(&from(5, &[71])));
    let changes = gone(&mut r, LinkRole::Border, name(7), 71);
    assert!(changes.contains(&PlaneChange::Remove(name(5))) && changes.contains(&set(2, 4, &[], &[])));
}

#[test]
fn only_a_border_is_where_others_come_from() {
    let mut r = Routes::default();
    let source = Route { arrives_by: vec![name(7)], ..route(5, 0, &[]) };
    r.push(&push(1, Extent::Full { part: 0, last: true }, vec![source])).unwrap();
    assert_eq!(r.link_up(LinkRole::Endpoint, name(7), 0, 70), [PlaneChange::Remove(name(5))]);
}

#[test]
fn what_a_daemon_left_of_a_border_stays_until_its_link_is_back() {
    let mut r = Routes::default();
    let known = PlaneRoute { egress_bits: 6, readers: vec![70], writers: vec![70], sources: vec![] };
    let source = PlaneRoute { sources: vec![70], ..PlaneRoute::default() };
    let link = LinkEntry { id: 70, peer: name(7), ..LinkEntry::default() };
    let routes = vec![(name(1), known), (name(5), source)];
    let left = Left { own_bit: 2, links: vec![], routes, next_hops: [0; 64] };
    assert_eq!(r.adopt(&left, &[(link.into(), LinkRole::Border)]), []);
    let mut changes = r.link_up(LinkRole::Border, name(7), 0, 71);
    changes.sort_by_key(|change| format!("{change:?}"));
    assert_eq!(changes, [set(1, 6, &[70], &[70, 71]), from(5, &[70, 71])]);
}

/// Applies random pushes of a well-behaved RIB, links and RIB restarts. The resulting data plane
/// equals a model's.
#[test]
fn the_data_plane_follows_any_sequence() {
    let mut seed = 5u64;
    let mut below = move |bound: u64| {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) % bound
    };
    for _ in 0..30 {
        let (mut r, mut plane) = (Routes::default(), BTreeMap::new());
        let (mut run, mut generation, mut settling) = (1, 0, false);
        let (mut wanted, mut held) = (BTreeMap::<Name, Route>::new(), BTreeMap::<Name, Route>::new());
        let mut links = BTreeMap::<Name, u32>::new();
        for step in 0..200 {
            let (mut changes, mut said) = (Vec::new(), None);
            let whole = Extent::Full { part: 0, last: true };
            match below(10) {
                0 => {
                    // Another RIB takes over.
                    (run, settling) = (run + 1, true);
                    let mut joint = joined(&wanted, &held);
                    std::mem::swap(&mut held, &mut joint);
                    wanted.clear();
                    said = Some((whole, vec![], vec![]));
                }
                1 if run > 1 => {
                    settling = false;
                    held.clear();
                    said = Some((whole, wanted.values().cloned().collect(), vec![]));
                }
                2..=4 => {
                    let (peer, link) = (name(10 + below(4) as u8), 1000 + step);
                    if let Some(old) = links.remove(&peer) {
                        changes.extend(gone(&mut r, LinkRole::Endpoint, peer, old));
                    } else {
                        changes.extend(r.link_up(LinkRole::Endpoint, peer, 0, link));
                        changes.extend(r.link_ready(LinkRole::Endpoint, peer, link));
                        links.insert(peer, link);
                    }
                }
                kind if run > 1 => {
                    let it = name(below(6) as u8);
                    if kind == 5 {
                        wanted.remove(&it);
                        held.remove(&it);
                        said = Some((Extent::Delta, vec![], vec![it]));
                    } else {
                        let some = |bits: u64| (0..4).filter(|i| bits & 1 << i != 0).map(|i| name(10 + i)).collect();
                        let (egress_bits, locals, writers) = (below(4), some(below(16)), some(below(16)));
                        let route =
                            Route { name: it, egress_bits, locals, everywhere: vec![], writers, arrives_by: vec![] };
                        wanted.insert(it, route.clone());
                        said = Some((Extent::Delta, vec![route], vec![]));
                    }
                }
                _ => {}
            }
            if let Some((extent, set, remove)) = said {
                generation += 1;
                let said = FibPush { run, settling, remove, ..push(generation, extent, set) };
                changes = r.push(&said).expect("in step");
            }
            for change in changes {
                match change {
                    PlaneChange::Set(name, route) => drop(plane.insert(name, route)),
                    PlaneChange::Remove(name) => drop(plane.remove(&name)),
                    _ => {}
                }
            }
            let at = |names: &[Name]| sorted(names.iter().filter_map(|name| links.get(name).copied()));
            let model = joined(&wanted, &held).into_iter().map(|(name, route)| {
                let (readers, writers) = (at(&route.locals), at(&route.writers));
                (name, PlaneRoute { egress_bits: route.egress_bits, readers, writers, sources: vec![] })
            });
            let leads = |route: &PlaneRoute| route.egress_bits != 0 || !route.readers.is_empty();
            assert_eq!(plane, model.filter(|(_, route)| leads(route)).collect());
        }
    }
}

fn joined(some: &BTreeMap<Name, Route>, more: &BTreeMap<Name, Route>) -> BTreeMap<Name, Route> {
    let mut all = some.clone();
    for (name, route) in more {
        let both = all.entry(*name).or_insert_with(|| route.clone());
        both.egress_bits |= route.egress_bits;
        both.locals = sorted(both.locals.iter().chain(&route.locals).copied());
        both.writers = sorted(both.writers.iter().chain(&route.writers).copied());
    }
    all
}

#[test]
fn a_push_out_of_step_changes_nothing() {
    let mut r = Routes::default();
    let set = vec![route(1, 1, &[])];
    assert!(r.push(&push(1, Extent::Delta, set.clone())).is_err(), "a change of nothing");
    assert!(r.push(&push(1, Extent::Full { part: 1, last: true }, set.clone())).is_err(), "a part without a first");
    r.push(&push(5, Extent::Full { part: 0, last: true }, set.clone())).unwrap();
    for generation in [4, 5, 7] {
        assert_eq!(r.push(&push(generation, Extent::Delta, vec![])), Err(OutOfStep { current: 5, got: generation }));
    }
    let mut delta = push(6, Extent::Delta, vec![]);
    delta.remove = vec![name(1), name(2)];
    assert_eq!(r.push(&delta).unwrap(), [PlaneChange::Remove(name(1))]);
    r.push(&push(7, Extent::Full { part: 0, last: false }, vec![])).unwrap();
    assert!(r.push(&push(8, Extent::Delta, vec![])).is_err(), "a change in the middle of a transfer");
    assert!(r.push(&push(8, Extent::Full { part: 2, last: true }, vec![])).is_err(), "a part is missing");
}

/// Removes a link.
fn gone(r: &mut Routes, role: LinkRole, peer: Name, link: u32) -> Vec<PlaneChange> {
    r.link_removed(role, peer, link).0
}

fn push(generation: u64, extent: Extent, set: Vec<Route>) -> FibPush {
    FibPush { switch: name(0), run: 1, settling: false, generation, extent, own_bit: 1, set, remove: vec![] }
}

/// Paths on which neighbour 9 leads to switches 0 and 2.
fn paths() -> Paths {
    Paths { reach: [(name(9), 0b101)].into(), ..Paths::default() }
}

fn route(i: u8, egress_bits: u64, locals: &[u8]) -> Route {
    Route { name: name(i), egress_bits, locals: locals.iter().copied().map(name).collect(), ..Route::default() }
}

fn set(i: u8, egress_bits: u64, readers: &[u32], writers: &[u32]) -> PlaneChange {
    PlaneChange::Set(
        name(i),
        PlaneRoute { egress_bits, readers: readers.to_vec(), writers: writers.to_vec(), sources: vec![] },
    )
}

/// The change after which frames from the name arrive on these links, and none go to it.
fn from(i: u8, sources: &[u32]) -> PlaneChange {
    PlaneChange::Set(name(i), PlaneRoute { sources: sources.to_vec(), ..PlaneRoute::default() })
}

fn hops(change: &PlaneChange) -> &[u32; 64] {
    let PlaneChange::NextHops(hops) = change else { panic!("{change:?}") };
    hops
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
