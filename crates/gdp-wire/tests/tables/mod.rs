//! A data plane of plain collections, which applies `decide` and nothing else.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet};

use gdp_wire::forward::{self, Copy, Kind};
use gdp_wire::header::FIRST_QUIC_BYTE;
use gdp_wire::replay::{self, Window};
use gdp_wire::table::MAX_COPIED_FRAME;
use gdp_wire::tables::Tables;
use gdp_wire::{Counter, FibEntry, Header, LinkEntry, LinkRole, Name, Permit};
use zerocopy::{FromBytes, IntoBytes};

use crate::frames::carrier::Place;
use crate::frames::fixtures::{Switch, Verdict};

pub use crate::frames::fixtures::Fate;

/// The tables. With `KERNEL`, the plane leaves frames that it cannot send to another plane.
pub struct PlainTables<const KERNEL: bool> {
    links: HashMap<u32, LinkEntry>,
    routes: HashMap<Name, FibEntry>,
    permits: HashSet<Permit>,
    /// All links of each group.
    groups: HashMap<u32, Vec<u32>>,
    next_hops: [u32; 64],
    own_bit: u64,
    switch: Switch,
    sent: RefCell<HashMap<u32, u64>>,
    windows: HashMap<u32, Window>,
    /// Egress bits of each group that the kernel copies frames for.
    served: HashMap<u32, u64>,
    /// Length of the longest frame that the plane copies, in bytes.
    longest_copy: usize,
    makes_copies: bool,
    /// Port that the plane does not serve. Frames for it go to the next plane.
    without_port: Option<u32>,
    /// Links with a queue.
    queues: HashSet<u32>,
    /// Whether the daemon has just received a probe.
    punted: bool,
}

impl<const KERNEL: bool> PlainTables<KERNEL> {
    pub fn new(switch: &Switch) -> Self {
        Self {
            links: switch.links().map(|link| (link.id, link)).collect(),
            routes: switch.routes().map(|(name, entry, _)| (name, entry)).collect(),
            permits: switch.routes().flat_map(|(_, _, permits)| permits).collect(),
            groups: switch
                .groups_with_neighbours()
                .map(|(group, links)| (group, links.iter().map(|link| link.id).collect()))
                .collect(),
            next_hops: switch.next_hops(),
            own_bit: switch.config().own_bit,
            switch: switch.clone(),
            sent: RefCell::new(switch.links.iter().map(|link| (link.id, link.tx_counter)).collect()),
            windows: switch.links.iter().map(|link| (link.id, window(&link.taken))).collect(),
            served: switch.kernel_groups().map(|(group, _, served)| (group, served)).collect(),
            longest_copy: MAX_COPIED_FRAME,
            makes_copies: true,
            without_port: None,
            queues: HashSet::new(),
            punted: false,
        }
    }

    /// Returns the tables of a kernel under a test run, which makes its copies later.
    #[allow(dead_code, reason = "each test that includes this uses a part of it")]
    pub fn without_copies(self) -> Self {
        Self { makes_copies: false, ..self }
    }

    /// Returns the tables of a plane that copies every frame it can send, on all ports but this
    /// one.
    #[allow(dead_code, reason = "each test that includes this uses a part of it")]
    pub fn with_all_copies_but_by(self, port: u32) -> Self {
        let without = Self { without_port: Some(port), longest_copy: usize::MAX, ..self };
        let own = without.own_bit;
        let groups = without.groups.iter().map(|(group, links)| {
            let links =
                links.iter().filter_map(|id| without.links.get(id)).filter(|link| !without.resolve(link, &mut ()));
            let bits_of = |link: &LinkEntry| if link.role == LinkRole::Switch as u32 { link.reach } else { own };
            (*group, links.fold(u64::MAX, |served, link| served & !bits_of(link)))
        });
        let served = groups.collect();
        Self { served, ..without }
    }

    /// Returns the tables of a switch with queues on these links.
    #[allow(dead_code, reason = "each test that includes this uses a part of it")]
    pub fn with_queues(self, links: &[u32]) -> Self {
        Self { queues: links.iter().copied().collect(), ..self }
    }

    /// Returns the tables of a switch whose daemon has just received a probe.
    #[allow(dead_code, reason = "each test that includes this uses a part of it")]
    pub fn punted(self) -> Self {
        Self { punted: true, ..self }
    }

    /// Returns the fate of an Ethernet frame.
    pub fn run(&self, frame: &[u8]) -> Fate {
        let Some(Place { at, length, over_udp, class }) = self.switch.find(frame) else {
            return Fate::new(Verdict::Pass, Counter::Foreign);
        };
        let gdp = &frame[at..at + length];
        match gdp.first().copied() {
            Some(FIRST_QUIC_BYTE..) if over_udp => return Fate::new(Verdict::Pass, Counter::Control),
            Some(first) => match forward::classify(first) {
                Kind::Headed => {}
                Kind::Control => return Fate::new(Verdict::Pass, Counter::Control),
                Kind::Unknown => return Fate::new(Verdict::Drop, Counter::Unknown),
            },
            None => return Fate::new(Verdict::Drop, Counter::Truncated),
        }
        let Ok((mut header, payload)) = Header::read_from_prefix(gdp) else {
            return Fate::new(Verdict::Drop, Counter::Truncated);
        };
        let ingress = header.link_id();
        let payload = payload.get(..header.payload_len().into()).unwrap_or(payload);
        let send = |link: &LinkEntry, header: &Header, payload: &[u8], counter| {
            // The fixtures leave this port without an interface.
            if KERNEL && link.port == 63 && self.without_port.is_none() {
                return Fate::new(Verdict::Drop, Counter::RedirectFailed);
            }
            Fate::sent(self.carried(link, header, payload), counter)
        };
        match forward::decide(&mut header, length, class, self) {
            forward::Verdict::Send(link, (), counter) => send(link, &header, payload, counter),
            forward::Verdict::Answer(link, (), counter) => send(link, &header, &[], counter),
            forward::Verdict::Copies(group) => Fate::copied(self.copies(&header, payload, group, ingress)),
            forward::Verdict::Notice(_) => Fate::new(Verdict::Pass, Counter::Notice),
            forward::Verdict::Slow => Fate::new(Verdict::Pass, Counter::Slow),
            forward::Verdict::Drop(counter) => Fate::new(Verdict::Drop, counter),
        }
    }

    fn copies(&self, header: &Header, payload: &[u8], group: u32, ingress: u32) -> Vec<(Option<Vec<u8>>, Counter)> {
        if !self.makes_copies {
            return Vec::new();
        }
        self.links_of(group)
            .filter_map(|link| {
                let mut header = *header;
                let length = Header::LEN + payload.len();
                match forward::copy(&mut header, length, link, &self.links[&ingress], self) {
                    Copy::Send(counter) => Some((Some(self.carried(link, &header, payload)), counter)),
                    Copy::Drop(counter) => Some((None, counter)),
                    Copy::None => None,
                }
            })
            .collect()
    }

    fn links_of(&self, group: u32) -> impl Iterator<Item = &LinkEntry> {
        self.groups.get(&group).into_iter().flatten().filter_map(|id| self.links.get(id))
    }

    fn carried(&self, link: &LinkEntry, header: &Header, payload: &[u8]) -> Vec<u8> {
        let link = self.switch.link(link.id).expect("a link of the switch");
        link.carry(self.switch.ethertype, &[header.as_bytes(), payload].concat())
    }
}

impl<const KERNEL: bool> Tables for PlainTables<KERNEL> {
    const LAST: bool = !KERNEL;

    type NextHop = ();

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

    fn is_permitted(&self, permit: &Permit) -> bool {
        self.permits.contains(permit)
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

    fn resolve(&self, link: &LinkEntry, _: &mut ()) -> bool {
        self.without_port != Some(link.port) && self.switch.link(link.id).is_some_and(|link| link.port.is_some())
    }

    fn can_copy(&self, group: u32, bits: u64, length: usize) -> bool {
        let served = self.served.get(&group).copied().unwrap_or(0);
        length <= self.longest_copy && bits & !served == 0
    }

    fn has_queue(&self, link: &LinkEntry) -> bool {
        self.queues.contains(&link.id)
    }

    fn may_send_error(&self, _: &LinkEntry) -> bool {
        true
    }

    fn send_error(&self, _: &LinkEntry) {}

    fn may_punt(&self, _: &LinkEntry) -> bool {
        !self.punted
    }

    fn punt(&self, _: &LinkEntry) {}
}

fn window(taken: &[u64]) -> Window {
    let window = replay::empty();
    taken.iter().for_each(|count| assert!(replay::take(&window, *count), "{count} is there twice"));
    window
}
