//! Unit tests of `node::receiver`.

use super::*;
use gdp_wire::{ErrorCode, LinkEntry, hop, replay};
use std::collections::BTreeMap;
use std::sync::Weak;

use super::super::options::SubscribeOptions;
use super::super::shared_entry::SharedEntry;
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_link::port::LinkAddr;
use tokio::sync::mpsc as async_mpsc;
use zerocopy::IntoBytes;

const NAME: Name = Name::from_bytes([1; 32]);

#[test]
fn the_rest_of_a_message_is_waited_for_only_where_it_comes_soon() {
    let mut rest = Rest::default();
    rest.on_frames(false);
    assert!(!rest.is_near(), "there is none");
    let mut looked = 0;
    for _ in 0..100 {
        rest.on_frames(true);
        looked += usize::from(rest.is_near());
        rest.since = rest.since.map(|since| since - Rest::NEAR);
        assert!(!rest.is_near());
    }
    assert!((1..10).contains(&looked), "{looked} times in vain");
    for _ in 0..20 {
        rest.on_frames(true);
    }
    let looked = (0..20).filter(|_| (rest.on_frames(true), rest.is_near()).1).count();
    assert_eq!(looked, 20, "it comes soon by now");
}

#[test]
fn frames_of_unknown_sources_wait_a_moment() {
    let (mut subscriptions, link) = (subscribed(), links());
    let mut batch = RecvBatch::new(1500);
    for source in 0..50 {
        let mut header = Header::data(NAME, Name::from_bytes([source; 32]), 0);
        hop::stamp(&mut header, &link.current.entry, source.into());
        assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }, false));
    }
    subscriptions.take(&mut batch, &link);
    let counters = subscriptions.send_path.counters.snapshot(0);
    assert_eq!((counters.frames_received, counters.drops), (50, BTreeMap::new()));
}

#[test]
fn what_strangers_tell_this_node_is_counted_and_no_more() {
    let (mut subscriptions, link) = (subscribed(), links());
    let mut batch = RecvBatch::new(1500);
    let mut header = Header::data(subscriptions.send_path.links.name(), Name::from_bytes([9; 32]), 0);
    hop::stamp(&mut header, &link.current.entry, 1);
    assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }, false));
    subscriptions.take(&mut batch, &link);
    let drops = subscriptions.send_path.counters.snapshot(0).drops;
    assert_eq!(drops, BTreeMap::from([("drop_feedback_unknown", 1)]));
}

#[test]
fn a_frame_that_comes_again_on_its_link_is_refused() {
    let mut subscriptions = subscribed();
    let entry = SharedEntry::new(keyed(0)).get();
    let mut take = |link: &Ingresses, counts: &[u64]| {
        let mut batch = RecvBatch::new(1500);
        for count in counts {
            let mut header = Header::data(NAME, Name::from_bytes([9; 32]), 0);
            hop::stamp(&mut header, &entry, *count);
            assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }, false));
        }
        subscriptions.take(&mut batch, link);
        subscriptions.send_path.counters.refused[Counter::Replayed as usize].get()
    };
    let link = links();
    assert_eq!(take(&link, &[1, 3, 2, 1]), 1);
    assert_eq!(take(&link, &[4, 3, 2]), 3, "in another batch");
    assert_eq!(take(&links(), &[1, 2]), 3, "a new link counts anew");
}

#[test]
fn errors_are_told_to_the_publisher_of_their_name_and_to_no_other() {
    let (mut subscriptions, link) = (subscribed(), links());
    let (node, send_path) = (subscriptions.send_path.links.name(), subscriptions.send_path.clone());
    let (told, other) = (subscriptions.feedback.of(NAME), subscriptions.feedback.of(Name::from_bytes([3; 32])));
    let mut take = |count: u32, source: Name, code: u8| {
        let mut header = Header::data(NAME, source, 0);
        header.set_link_counter(1000 + count);
        header.become_error(ErrorCode::TooBig, 700);
        header.egress_set = code;
        hop::stamp(&mut header, &link.current.entry, count.into());
        let mut batch = RecvBatch::new(1500);
        assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }, false));
        subscriptions.take(&mut batch, &link);
    };
    take(1, node, ErrorCode::TooBig as u8);
    take(2, Name::from_bytes([9; 32]), ErrorCode::TooBig as u8);
    take(3, node, ErrorCode::NoRoute as u8);
    take(4, node, 0);
    take(5, node, ErrorCode::COUNT as u8 + 1);
    let errors = |too_big| BTreeMap::from([("no_route", 1), ("too_big", too_big)]);
    let counters = send_path.counters.snapshot(0);
    assert_eq!((counters.errors_received, told.errors()), (errors(2), errors(1)), "one was not about this node");
    assert_eq!(counters.drops, BTreeMap::from([("drop_unknown", 2)]), "codes that nobody knows");
    let last = told.last().unwrap();
    assert_eq!((last.code, last.mtu), (ErrorCode::NoRoute, None));
    assert_eq!(other.last(), None);
}

fn links() -> Ingresses {
    Ingresses::new(Ingress::new(SharedEntry::new(keyed(0)), Weak::new(), Arc::default()))
}

/// Returns the entry of a link with the same keys at both ends.
fn keyed(id: u32) -> LinkEntry {
    LinkEntry { id, peer_id: id, rx_keys: [[1, 2]; 2], tx_keys: [[1, 2]; 2], ..LinkEntry::default() }
}

#[test]
fn a_link_that_fell_silent_keeps_its_window_through_attempts_to_replace_it() {
    let entry = |id| SharedEntry::new(keyed(id));
    let link = |id| Ingress::new(entry(id), Weak::new(), Arc::default());
    let until = Instant::now() + Duration::from_secs(60);
    let first = Ingresses::new(link(1));
    assert!(replay::take(&*first.current.window, 7));
    let second = Ingresses::after(Some(first), link(2), Some((link(1), until)));
    let third = Ingresses::after(Some(second), link(3), Some((link(1), until)));
    let ids: Vec<u32> = third.stale.iter().map(|(link, _)| link.entry.id).collect();
    assert_eq!((third.current.entry.id, ids), (3, vec![1]), "2 never came into service");
    assert!(!replay::is_fresh(&*third.stale[0].0.window, 7));
}

fn subscribed() -> Subscriptions {
    let node = Identity::generate("proxy").unwrap();
    let send_path =
        Arc::new(SendPath::new(&node, Arc::default(), &["udp://127.0.0.1:1".parse::<LinkTarget>().unwrap().into()]));
    let mut subscriptions = Subscriptions::new(send_path, Arc::new(Feedbacks::new(node.name())));
    let intake =
        SubscriptionReceiver::new(NAME, SubscribeOptions::best_effort(), async_mpsc::channel(1).0, Arc::default());
    subscriptions.receivers.insert(NAME, Box::new(intake));
    subscriptions
}
