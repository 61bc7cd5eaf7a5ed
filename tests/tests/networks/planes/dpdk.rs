//! The fixtures' switch in DPDK: the code of its loops, on packets in its memory, without a device.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use gdp_dataplane::dpdk::{LoopReader, LoopView};
use gdp_dataplane::forwarder::Shared;
use gdp_dataplane::link_memory::LinkMemory;
use gdp_dataplane::tables::UserTables;
use gdp_dpdk::forwarding::{Counts, Forwarding, Sink};
use gdp_dpdk::local::{Local, NextHop};
use gdp_dpdk::view::Reader as _;
use gdp_dpdk::{Burst, Eal, EalConfig, Mbuf, Pool};
use gdp_tests::frames::fixtures::{Fate, Link, Switch, Verdict, hex};
use gdp_wire::table::{PORT_ROUTED, PORT_USERSPACE, mac_words};
use gdp_wire::{Counter, LocalAddress};

/// The port where frames arrive, which has the VLANs.
const PORT: u32 = 1;

/// Links on this port have no destination, as in the fixtures.
pub const NOWHERE: u32 = 63;

/// Larger than any generated frame.
const LARGEST: usize = 9216;

pub struct DpdkSwitch {
    pool: Pool,
    forwarding: Forwarding,
    reader: LoopReader,
    local: Local,
    ports: Vec<u32>,
    /// The egress port of packets between two stations, keyed by the neighbour's MAC address, then
    /// the switch's.
    ways: BTreeSet<([u8; 12], u32)>,
    _tables: UserTables,
    pub link_memory: LinkMemory,
}

impl DpdkSwitch {
    pub fn new(switch: &Switch) -> Result<Self> {
        let (tables, link_memory) = super::user_tables(switch);
        let reader = LoopReader::new(tables.reader(), Arc::new(Shared::new(tables.queues().clone())));
        // The other links have no route, or an unresolved neighbour.
        let routes = |link: &&Link| link.port.is_some() && link.udp.as_ref().is_some_and(|udp| udp.routed);
        let routed = switch.links.iter().filter(routes);
        let next_hop = |link: &Link| {
            let [peer, local] = link.stations().map(mac_words);
            NextHop { port: PORT, peer, local }
        };
        let ports: BTreeSet<u32> = switch.links().map(|link| link.port).collect();
        let ports = ports.into_iter().filter(|port| ![PORT_ROUTED, PORT_USERSPACE, NOWHERE].contains(port));
        let local = Local {
            ethertype: switch.ethertype,
            addresses: switch.own_addresses().iter().map(|own| LocalAddress::new(own.ip(), own.port())).collect(),
            vlans: switch.vlans().into_iter().map(|id| (PORT, id)).collect(),
            next_hops: routed.map(|link| (link.id, next_hop(link))).collect(),
        };
        let way = |link: &Link| {
            let port = if link.udp.as_ref().is_some_and(|udp| udp.routed) { Some(PORT) } else { link.port };
            Some((<[u8; 12]>::try_from(link.stations().concat()).ok()?, port?))
        };
        let pool = Pool::new(Eal::begin(&EalConfig::default())?, 1023, LARGEST)?;
        Ok(Self {
            forwarding: Forwarding::new(pool.clone()),
            pool,
            reader,
            local,
            ports: ports.chain([PORT]).collect(),
            ways: switch.links.iter().filter_map(way).collect(),
            _tables: tables,
            link_memory,
        })
    }

    /// Returns the results for frames that arrive together, and their total counts. `gathers`:
    /// whether ports accept chained packets, in which copies share their common part.
    pub fn run(&mut self, frames: &[Vec<u8>], gathers: bool) -> Result<(Seen, Counts)> {
        let mut burst = Burst::new();
        for frame in frames {
            let mut mbuf = self.pool.alloc().context("a packet")?;
            ensure!(mbuf.reshape(0, frame.len()), "a frame of {} B does not fit", frame.len());
            mbuf.bytes_mut().context("its bytes")?.copy_from_slice(frame);
            burst.push(mbuf).ok().context("room in a burst")?;
        }
        let (mut seen, mut counts) = (Seen { gathers, ..Seen::default() }, [0; Counter::COUNT]);
        let view: LoopView<'_> = self.reader.enter();
        self.forwarding.run((PORT, &self.ports), &mut burst, (&view, &self.local), &mut seen, &mut counts);
        drop(view);
        ensure!(self.pool.in_use() == 0, "{} packets are lost", self.pool.in_use());
        for (frame, port) in seen.sent.iter().zip(&seen.ports) {
            let stations = *frame.first_chunk().context("a packet with addresses")?;
            ensure!(self.ways.contains(&(stations, *port)), "left by port {port}: {}", hex(&frame[..12]));
        }
        Ok((seen, counts))
    }

    /// Returns the result for one frame.
    pub fn fate(&mut self, frame: &[u8], gathers: bool) -> Result<Fate> {
        let (Seen { sent, passed, .. }, counts) = self.run(&[frame.to_vec()], gathers)?;
        let counted: Vec<_> = Counter::ALL.iter().zip(counts).filter(|(_, count)| *count > 0).collect();
        if counts[Counter::Replicated as usize] == 1 {
            return copied(sent, &counted);
        }
        let [(counter, 1)] = counted[..] else { anyhow::bail!("counted {counted:?}") };
        Ok(match (&sent[..], &passed[..]) {
            ([out], []) => Fate::sent(out.clone(), *counter),
            ([], [host]) => {
                ensure!(host == frame, "a frame that passes was changed");
                Fate::new(Verdict::Pass, *counter)
            }
            ([], []) => Fate::new(Verdict::Drop, *counter),
            _ => anyhow::bail!("{} were sent and {} passed", sent.len(), passed.len()),
        })
    }
}

/// Attributes the total counts to copies by their destinations.
fn copied(sent: Vec<Vec<u8>>, counted: &[(&Counter, u64)]) -> Result<Fate> {
    let of = |counter: Counter| counted.iter().find(|(found, _)| **found == counter).map_or(0, |(_, count)| *count);
    let (forwarded, delivered) = (of(Counter::Forwarded), of(Counter::Delivered));
    ensure!(forwarded + delivered == sent.len() as u64, "{} copies were sent, counted {counted:?}", sent.len());
    let dropped = (0..of(Counter::TooBig)).map(|_| (None, Counter::TooBig));
    let sent = sent.into_iter().map(|frame| {
        let counter = if has_bits(&frame) { Counter::Forwarded } else { Counter::Delivered };
        (Some(frame), counter)
    });
    let copies: Vec<_> = sent.chain(dropped).collect();
    let marked = copies.iter().filter(|(frame, counter)| frame.is_some() && *counter == Counter::Forwarded).count();
    ensure!(marked as u64 == forwarded, "{marked} copies have egress bits, and {forwarded} were forwarded");
    Ok(Fate::copied(copies))
}

/// Returns whether a copy goes to further switches. Ethernet (tagged or not) or UDP carries copies.
fn has_bits(packet: &[u8]) -> bool {
    let at = match (packet[12], packet[13]) {
        (0x81, 0) => 18,
        (0x08, 0) => 42,
        (0x86, 0xdd) => 62,
        _ => 14,
    };
    packet[at + 24..at + 32] != [0; 8]
}

/// The results for a batch's frames.
#[derive(Default)]
pub struct Seen {
    gathers: bool,
    pub sent: Vec<Vec<u8>>,
    /// The ports that sent these frames.
    pub ports: Vec<u32>,
    pub passed: Vec<Vec<u8>>,
}

impl Sink for Seen {
    fn send(&mut self, port: u32, mbuf: Mbuf) {
        self.sent.push(mbuf.to_vec());
        self.ports.push(port);
    }

    fn pass(&mut self, mbuf: Mbuf) {
        self.passed.push(mbuf.to_vec());
    }

    fn gathers(&self, _: u32) -> bool {
        self.gathers
    }
}
