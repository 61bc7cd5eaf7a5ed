//! A data plane of plain collections: what a frame becomes according to `decide` and nothing else.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet};

use gdp_wire::forward::{self, Kind, Plane};
use gdp_wire::replay::{self, Window};
use gdp_wire::table::Tables;
use gdp_wire::{Counter, FibEntry, Header, LinkEntry, Name};
use zerocopy::{FromBytes, IntoBytes};

use crate::frames::fixtures::{Bytes, Expected, Switch, Verdict};

pub struct PlainTables {
    links: HashMap<u32, LinkEntry>,
    routes: HashMap<Name, FibEntry>,
    permits: HashSet<(u32, Name)>,
    next_hops: [u32; 64],
    own_bit: u64,
    ethertype: u16,
    sent: RefCell<HashMap<u32, u64>>,
    windows: HashMap<u32, Window>,
}

impl PlainTables {
    pub fn new(switch: &Switch) -> Self {
        Self {
            links: switch.links().map(|link| (link.id, link)).collect(),
            routes: switch.routes().map(|(name, entry, _)| (name, entry)).collect(),
            permits: switch.routes().flat_map(|(name, _, more)| more.iter().map(move |link| (*link, name))).collect(),
            next_hops: switch.next_hops(),
            own_bit: switch.config().own_bit,
            ethertype: switch.ethertype,
            sent: RefCell::new(switch.links.iter().map(|link| (link.id, link.tx_counter)).collect()),
            windows: switch.links.iter().map(|link| (link.id, window(&link.taken))).collect(),
        }
    }

    /// What becomes of an Ethernet frame.
    pub fn run(&self, frame: &[u8], plane: Plane) -> Expected {
        let outcome = |verdict, counter: Counter| Expected { verdict, counter: counter.as_str().into(), frame: None };
        if frame[12..14] != self.ethertype.to_be_bytes() {
            return outcome(Verdict::Pass, Counter::Foreign);
        }
        match frame.get(14).copied().map(forward::classify) {
            Some(Kind::Data) => {}
            Some(Kind::Control) => return outcome(Verdict::Pass, Counter::Control),
            Some(Kind::Unknown) => return outcome(Verdict::Drop, Counter::Unknown),
            None => return outcome(Verdict::Drop, Counter::Truncated),
        }
        let Ok((mut header, _)) = Header::read_from_prefix(&frame[14..]) else {
            return outcome(Verdict::Drop, Counter::Truncated);
        };
        match forward::decide(&mut header, frame.len() - 14, self, plane) {
            // The fixtures leave this port without an interface.
            forward::Verdict::Send(LinkEntry { port: 63, .. }, _) if plane == Plane::Kernel => {
                outcome(Verdict::Drop, Counter::RedirectFailed)
            }
            forward::Verdict::Send(link, counter) => {
                let mut out = frame.to_vec();
                out[..12].copy_from_slice([link.peer_mac, link.local_mac].as_bytes());
                out[14..14 + Header::LEN].copy_from_slice(header.as_bytes());
                Expected { frame: Some(Bytes::new(&out)), ..outcome(Verdict::Send, counter) }
            }
            forward::Verdict::Slow => outcome(Verdict::Pass, Counter::Slow),
            forward::Verdict::Drop(counter) => outcome(Verdict::Drop, counter),
        }
    }
}

impl Tables for PlainTables {
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        self.links.get(&id)
    }

    fn route(&self, name: &Name) -> Option<FibEntry> {
        self.routes.get(name).copied()
    }

    fn next_hop(&self, bit: u32) -> u32 {
        self.next_hops[bit as usize]
    }

    fn own_bit(&self) -> u64 {
        self.own_bit
    }

    fn is_permitted(&self, link: &LinkEntry, name: &Name) -> bool {
        self.permits.contains(&(link.id, *name))
    }

    fn window(&self, link: &LinkEntry) -> Option<impl replay::Words> {
        self.windows.get(&link.id)
    }

    fn next_count(&self, link: &LinkEntry) -> u64 {
        let mut sent = self.sent.borrow_mut();
        let count = sent.entry(link.id).or_default();
        *count += 1;
        *count
    }
}

fn window(taken: &[u64]) -> Window {
    let window = replay::empty();
    taken.iter().for_each(|count| assert!(replay::take(&window, *count), "{count} is there twice"));
    window
}
