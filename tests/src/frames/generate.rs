//! Generates millions of frames for one switch. Most are what its neighbours would send. The others
//! have one or a few faults that an attacker who knows the format might try. The same seed yields
//! the same frames.
//!
//! The output is a sequence: link counters increase, and earlier frames repeat. Every plane under
//! comparison must get the whole sequence, in order.

use super::carrier::Carrier;
use super::fixtures::{self, Link, Role, Switch};
use super::{Frame, hop_tag};

/// Number of earlier frames that may repeat.
const REMEMBERED: usize = 512;

/// Initial counters of a link: at its first frame, or shortly before 2³².
const STARTS: [u64; 2] = [0, (1 << 32) - 20_000];

const ETHERNET: usize = 14;
const HEADER: usize = 96;

pub struct Generator {
    random: Random,
    switch: Switch,
    carriers: Vec<Carrier>,
    links: Vec<Sender>,
    names: Vec<[u8; 32]>,
    sizes: Vec<usize>,
    sent: Vec<Vec<u8>>,
}

/// A neighbour that sends frames.
struct Sender {
    link: Link,
    keys: [[u64; 2]; 2],
    /// The neighbour's own name. A neighbour in another domain has all names that it may send as.
    sources: Vec<[u8; 32]>,
    /// Names that the neighbour may send to; a switch may send to all of them.
    destinations: Vec<[u8; 32]>,
    count: u64,
}

impl Generator {
    pub fn new(seed: u64, switch: &Switch) -> Self {
        let name = |route: &fixtures::Route| fixtures::array(&route.name);
        let sender = |(i, link): (usize, &Link)| {
            let foreign: Vec<_> =
                switch.routes.iter().filter(|route| route.sources.contains(&link.id)).map(name).collect();
            let may_send_to = |route: &&fixtures::Route| link.role == Role::Switch || route.writers.contains(&link.id);
            let destinations: Vec<_> = switch.routes.iter().filter(may_send_to).map(name).collect();
            Sender {
                link: link.clone(),
                keys: link.rx_keys.each_ref().map(|text| fixtures::key(text)),
                sources: if foreign.is_empty() { vec![fixtures::array(&link.peer)] } else { foreign },
                destinations,
                count: STARTS[i % STARTS.len()],
            }
        };
        // Payload sizes with which the frame fits a link exactly, barely not, or easily.
        let limits = switch.links.iter().flat_map(|link| [0, 1, 2].map(|less| link.mtu as usize - HEADER + 1 - less));
        Self {
            random: Random(seed ^ 0x9e37_79b9_7f4a_7c15),
            switch: switch.clone(),
            carriers: switch.links.iter().map(Link::arrives_in).collect(),
            links: switch.links.iter().enumerate().map(sender).collect(),
            names: switch.routes.iter().map(name).collect(),
            sizes: limits.filter(|size| *size < 3000).chain([0, 1, 6, 64, 300]).collect(),
            sent: Vec::new(),
        }
    }

    /// Returns the next Ethernet frame.
    pub fn frame(&mut self) -> Vec<u8> {
        if self.random.one_in(12) && !self.sent.is_empty() {
            let mut again = self.random.one_of(&self.sent);
            if self.random.one_in(2) {
                self.damage(&mut again);
            }
            return again;
        }
        let mut frame = self.carried();
        if self.random.one_in(8) {
            self.damage(&mut frame);
        }
        match self.sent.len() {
            REMEMBERED => {
                let at = self.random.below(REMEMBERED);
                self.sent[at] = frame.clone();
            }
            _ => self.sent.push(frame.clone()),
        }
        frame
    }

    /// Returns a frame in its encapsulation. The encapsulation does not identify the link, so any
    /// carrier suits any frame.
    fn carried(&mut self) -> Vec<u8> {
        let mut frame = self.gdp();
        frame.carrier = self.random.one_of(&self.carriers);
        let any = self.random.word() as u8;
        if let Carrier::Udp { class, .. } = &mut frame.carrier {
            *class = self.random.one_of(&[0, 0b10, 0b10, 0b11, any]);
        }
        frame.ethertype = match self.random.below(64) {
            0 => self.random.one_of(&[0x0800, 0x86dd, 0x8100, 0x88b6, 0]),
            _ => self.switch.ethertype,
        };
        if self.random.one_in(64) {
            frame.carrier = match frame.carrier {
                Carrier::Ethernet => Carrier::Vlan(self.random.word() as u16),
                Carrier::Vlan(control) => Carrier::Vlan(control ^ 1 << self.random.below(16)),
                Carrier::Udp { from, mut to, class } => {
                    to.set_port(to.port() ^ 1 << self.random.below(16));
                    Carrier::Udp { from, to, class }
                }
            };
        }
        frame.bytes()
    }

    /// Returns a frame that a neighbour sends and tags, with or without faults.
    fn gdp(&mut self) -> Frame {
        let random = &mut self.random;
        let at = random.below(self.links.len());
        let sender = &mut self.links[at];
        sender.count += match random.below(64) {
            0 => 1 + random.below(5000) as u64,
            1 => 1 + random.below(1 << 20) as u64,
            _ => 1,
        };
        let link_counter = match random.below(16) {
            0 => sender.count.saturating_sub(random.below(6000) as u64),
            _ => sender.count,
        };
        let mut frame = Frame {
            link_id: sender.link.id,
            link_counter,
            hop_limit: random.one_of(&[64, 64, 64, 64, 255, 3, 2, 1, 0]),
            egress_set: random.one_of(&[0, 0, 0, 3, 255]),
            egress_bits: match (sender.link.role, random.below(8)) {
                (Role::Endpoint, 1..) => 0,
                (_, 0) => random.word(),
                (_, 1) => 0,
                (_, 2 | 3) => 1 << self.switch.own_bit,
                (_, 4) => 1 << self.switch.own_bit | 1 << random.below(14),
                (_, 5) => 1 << random.below(14) | 1 << random.below(14),
                _ => 1 << random.below(64),
            },
            destination: match random.below(32) {
                0 => std::array::from_fn(|_| random.word() as u8),
                1..=15 if !sender.destinations.is_empty() => random.one_of(&sender.destinations),
                _ => random.one_of(&self.names),
            },
            source: match random.below(24) {
                0 => std::array::from_fn(|_| random.word() as u8),
                1 => random.one_of(&self.names),
                _ => random.one_of(&sender.sources),
            },
            payload: vec![random.word() as u8; random.one_of(&self.sizes)],
            padding: random.one_of(&[0, 0, 0, 0, 1, 30]),
            ..Frame::default()
        };
        if random.one_in(10) {
            frame.flags = 0x40;
        }
        // Traffic class and ECN.
        let any = random.word() as u8 & 0x1f;
        frame.flags |= random.one_of(&[0, 0, 0b10, 0b10, 0b11, any]);
        if random.one_in(5) {
            match random.below(10) {
                0 => frame.version_type = random.word() as u8,
                1..=3 => frame.version_type = random.one_of(&[0x11, 0x22, 0x23, 0x24, 0x24]),
                4 => frame.flags = random.word() as u8,
                5 => frame.flags = 0x80,
                6 => frame.header_words = random.one_of(&[0, 1, 11, 13, 255]),
                7 => frame.payload_len = Some(random.one_of(&[0, 1, 5, 7, 1404, 1405, 65535])),
                8 => frame.reserved = random.word() as u8,
                _ => frame.egress_set = random.word() as u8,
            }
        }
        // Uses the key of the phase in the flags; occasionally the other phase's, or another
        // link's.
        let phase = usize::from(frame.flags >> 7);
        frame.key = match random.below(40) {
            0 => sender.keys[1 - phase],
            1 => self.links[random.below(self.links.len())].keys[phase],
            _ => sender.keys[phase],
        };
        if random.one_in(40) {
            frame.tag = Some(random.word());
        }
        frame
    }

    /// Damages a packet somewhere. In half of the cases the frame gets a valid tag again, as if its
    /// neighbour had sent the damage.
    fn damage(&mut self, frame: &mut Vec<u8>) {
        let random = &mut self.random;
        match random.below(6) {
            0 => frame.truncate(ETHERNET + random.below(frame.len() - ETHERNET + 1)),
            1 => frame.resize(frame.len() + random.below(200), 0),
            2 => (0..=random.below(4)).for_each(|_| {
                let at = random.below(frame.len());
                frame[at] = random.word() as u8;
            }),
            // Flips a bit in the headers.
            3 => {
                let at = random.below(ETHERNET + 48);
                if let Some(byte) = frame.get_mut(at) {
                    *byte ^= 1 << random.below(8);
                }
            }
            _ => {
                let at = self.switch.find(frame).map_or(ETHERNET, |place| place.at) + random.below(HEADER);
                if let Some(byte) = frame.get_mut(at) {
                    *byte ^= 1 << random.below(8);
                }
            }
        }
        if self.random.one_in(2) {
            self.tag_again(frame);
        }
    }

    /// Tags a frame again with its link's next counter, as the neighbour that its link id and flags
    /// name.
    fn tag_again(&mut self, frame: &mut [u8]) {
        let Some(place) = self.switch.find(frame) else { return };
        let Some(header) = frame[place.at..].first_chunk_mut::<HEADER>() else { return };
        let id = u32::from_be_bytes([header[8], header[9], header[10], header[11]]);
        let Some(sender) = self.links.iter_mut().find(|sender| sender.link.id == id) else { return };
        sender.count += 1;
        header[12..16].copy_from_slice(&(sender.count as u32).to_be_bytes());
        let tag = hop_tag(sender.keys[usize::from(header[1] >> 7)], sender.count, header);
        header[16..24].copy_from_slice(&tag.to_be_bytes());
    }
}

/// A linear congruential generator with the same numbers in every run.
pub struct Random(pub u64);

impl Random {
    pub fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        self.0 ^ self.0 >> 29
    }

    pub fn below(&mut self, limit: usize) -> usize {
        (self.word() >> 8) as usize % limit
    }

    fn one_in(&mut self, times: usize) -> bool {
        self.below(times) == 0
    }

    fn one_of<T: Clone>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())].clone()
    }
}
