//! Nanoseconds per frame in a DPDK loop: what `gdp-dpdk` does with a burst. The device makes
//! packets from nothing and takes them back, so the measurement contains no driver and no other
//! core. The comparison is with DPDK's `testpmd`, which swaps two addresses.
//!
//! `net_null` delivers packets with undefined content. Each packet therefore gets a prepared frame
//! before the loop sees it, with a neighbour's counter and tag. The cost of this step is measured
//! separately ([`FED`] less [`EMPTY`]) and subtracted.

use gdp_wire::hop;
use std::cell::RefCell;
use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_dataplane::dpdk::LoopReader;
use gdp_dataplane::forwarder::Shared;
use gdp_dataplane::link_memory::LinkMemory;
use gdp_dataplane::tables::UserTables;
use gdp_dpdk::forwarding::{Counts, Forwarding, Sink};
use gdp_dpdk::local::Local;
use gdp_dpdk::port::{Receive, Send};
use gdp_dpdk::siphash::Tags;
use gdp_dpdk::view::Reader as _;
use gdp_dpdk::{Burst, Eal, EalConfig, Mbuf, Pool, Port, PortConfig};
use gdp_link::port::LinkAddr;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_tests::programs::Executable as _;
use gdp_wire::{Carrier, Counter, FibEntry, Header, LinkEntry, LinkRole, Name};
use zerocopy::IntoBytes;

use crate::testpmd::Testpmd;
use crate::{Bench, lookups};

const NAMES: u32 = 1 << 20;

/// Frames prepared in advance, which then repeat. There are as many as random names: their table
/// entries are in no cache.
const FRAMES: [usize; 2] = [1 << 14, 1 << 20];

/// Bytes of a packet, with 64 bytes of payload.
const LENGTH: usize = ETHERNET + Header::LEN + 64;
const ETHERNET: usize = 14;

const EMPTY: &str = "device alone";
const FED: &str = "device, and frames written";
const TAGS: &str = "device, frames written, two hop tags";
const DPDK: &str = "device, frames written, DPDK switch";
const OWN: &str = "DPDK switch";
const OWN_TAGS: &str = "two hop tags alone";
const TESTPMD: &str = "testpmd macswap";

const HOT: &str = "a million names, one hot";
const RANDOM: &str = "a million names at random";

const IN: u32 = 1;
const OUT: u32 = 2;
const KEY: [u64; 2] = [7, 11];
const WRITER: Name = Name::from_bytes([0x50; 32]);
const EGRESS: u32 = 5;
const PORT: u32 = 1;

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let site = RefCell::new(Site::new()?);
    let device = format!("net_null7,size={LENGTH}");
    let mut testpmd = Testpmd::start(|program| Ok(program.command()), &[device])?;
    let duration = bench.duration();
    let mut contenders = vec![Contender::new(TESTPMD, HOT, move || {
        Ok(Sample { value: 1e9 / testpmd.rate(duration)?, ..Sample::default() })
    })];
    for (case, frames) in [HOT, RANDOM].into_iter().zip(FRAMES) {
        let frames = Arc::new(made(frames));
        for series in [EMPTY, FED, TAGS, DPDK] {
            let (site, frames) = (&site, frames.clone());
            let time =
                move || Ok(Sample { value: site.borrow_mut().time(series, &frames, duration)?, ..Sample::default() });
            contenders.push(Contender::new(series, case, time));
        }
    }
    let mut measures = alternate(bench.rounds, contenders)?;
    site.borrow().check()?;
    for case in [HOT, RANDOM] {
        let of = |series: &str| {
            let found = measures.iter().find(|measure| measure.series == series && measure.case == case);
            found.map(|measure| measure.rounds.clone()).context("it was measured")
        };
        let (empty, fed, tags, all) = (of(EMPTY)?, of(FED)?, of(TAGS)?, of(DPDK)?);
        let own = all.iter().zip(fed.iter().zip(&empty)).map(|(all, (fed, empty))| all - (fed - empty)).collect();
        measures.push(Measure::new(OWN, case, own));
        let tags = tags.iter().zip(&fed).map(|(tags, fed)| tags - fed).collect();
        measures.push(Measure::new(OWN_TAGS, case, tags));
    }
    let title = "One frame in a loop of DPDK between devices that do nothing, devices included";
    let figure = Figure::new("dpdk", title, Unit::Nanoseconds, measures)
        // Equals 0.6 times as many frames per second.
        .compare(OWN, TESTPMD, |case| (case == HOT).then_some(Aim::AtMost(1.0 / 0.6)))
        .aim(OWN, RANDOM, Aim::AtMost(150.0));
    Ok(vec![figure])
}

/// Returns headers of frames as the neighbour on [`IN`] sends them, each to another name. If there
/// are few, all have the same name.
fn made(frames: usize) -> Vec<Header> {
    let link = LinkEntry { id: IN, peer_id: IN, tx_keys: [KEY; 2], ..LinkEntry::default() };
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let header = |i: usize| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let name = if frames < NAMES as usize { 0 } else { random >> 32 & u64::from(NAMES - 1) };
        let mut header = Header::data(lookups::name(name), WRITER, (LENGTH - ETHERNET - Header::LEN) as u16);
        hop::stamp(&mut header, &link, i as u64 + 1);
        header
    };
    (0..frames).map(header).collect()
}

/// A switch between two links on one device.
struct Site {
    receive: Vec<Receive>,
    send: Vec<Send>,
    _port: Port,
    forwarding: Forwarding,
    reader: LoopReader,
    local: Local,
    link_memory: LinkMemory,
    counts: Counts,
    frames: u64,
    _tables: UserTables,
}

impl Site {
    fn new() -> Result<Self> {
        let link_memory = LinkMemory::new();
        let mut tables = UserTables::new(link_memory.clone(), NAMES)?;
        let link = LinkEntry {
            peer_id: IN,
            rx_keys: [KEY; 2],
            tx_keys: [KEY; 2],
            mtu: 1500,
            port: PORT,
            carrier: Carrier::ethernet([2; 6], [4; 6]),
            ..LinkEntry::default()
        };
        let to = LinkAddr::Ethernet { ifindex: PORT, mac: [2; 6] };
        tables.set_link(LinkEntry { id: IN, role: LinkRole::Endpoint as u32, peer: WRITER, ..link }, to);
        tables.set_link(LinkEntry { id: OUT, role: LinkRole::Switch as u32, reach: 1 << EGRESS, ..link }, to);
        let entry = FibEntry { egress_bits: 1 << EGRESS, writer_link: IN, ..FibEntry::default() };
        for i in 0..NAMES.into() {
            tables.set_route(lookups::name(i), entry, &[])?;
        }
        let mut next_hops = [0; 64];
        next_hops[EGRESS as usize] = OUT;
        tables.set_next_hops(&next_hops);
        tables.set_own_bit(1);
        let eal = Eal::begin(&EalConfig::default())?;
        let pool = Pool::new(eal, 8191, 2048)?;
        let device = format!("net_null0,size={LENGTH}");
        let (port, receive, send) =
            Port::open(eal, &PortConfig { device, receive_queues: 1, send_queues: 1, mtu: 1500 }, &pool)?;
        Ok(Self {
            receive,
            send,
            _port: port,
            forwarding: Forwarding::new(pool),
            reader: LoopReader::new(tables.reader(), Arc::new(Shared::new(tables.queues().clone()))),
            local: Local { ethertype: gdp_wire::ETHERTYPE, ..Local::default() },
            link_memory,
            counts: [0; Counter::COUNT],
            frames: 0,
            _tables: tables,
        })
    }

    /// Returns nanoseconds per frame.
    fn time(&mut self, series: &str, frames: &[Header], duration: Duration) -> Result<f64> {
        // Registers the thread, as loops do: it gets its own allocation caches.
        let _registered = Eal::begin(&EalConfig::default())?.register()?;
        self.begin_again();
        let (mut burst, mut back, mut tags) = (Burst::new(), Back::default(), Tags::new());
        let (mut next, mut done, start) = (0, 0u64, Instant::now());
        while done % (1 << 14) != 0 || start.elapsed() < duration {
            let received = self.receive[0].receive(&mut burst);
            ensure!(received == Burst::SIZE, "{received} packets of a device that makes them");
            if series != EMPTY {
                write(&mut burst, &frames[next..next + received])?;
                next = (next + received) % frames.len();
            }
            if series == TAGS {
                make_tags(&mut tags, &frames[next..next + received]);
            }
            if series == DPDK {
                let view = self.reader.enter();
                let at = (PORT, &[PORT][..]);
                self.forwarding.run(at, &mut burst, (&view, &self.local), &mut back, &mut self.counts);
                drop(view);
                self.frames += received as u64;
                self.send[0].send(&mut back.burst);
                if next == 0 {
                    self.begin_again();
                }
            } else {
                self.send[0].send(&mut burst);
            }
            done += received as u64;
        }
        Ok(start.elapsed().as_nanos() as f64 / done as f64)
    }

    /// Resets the receive windows: the same counters may repeat.
    fn begin_again(&self) {
        self.link_memory.begin(IN);
    }

    /// Fails unless every frame took the path under measurement.
    fn check(&self) -> Result<()> {
        let forwarded = self.counts[Counter::Forwarded as usize];
        let others = self.counts.iter().sum::<u64>() - forwarded;
        ensure!(forwarded == self.frames && others == 0, "{} frames, counted {:?}", self.frames, self.counts);
        Ok(())
    }
}

/// Computes the tags that every switch needs: one to verify each frame, one for its next link.
fn make_tags(tags: &mut Tags, headers: &[Header]) {
    for _ in 0..2 {
        tags.clear();
        (0..).zip(headers).for_each(|(place, _)| tags.add(place, KEY, place.into()));
        tags.make(headers);
        black_box(tags.tags());
    }
}

/// Writes these frames into packets of a device.
fn write(burst: &mut Burst, headers: &[Header]) -> Result<()> {
    for (mbuf, header) in burst.iter_mut().zip(headers) {
        let packet = mbuf.bytes_mut().context("a packet of its own")?;
        let room = packet.get_mut(..ETHERNET + Header::LEN).context("room for a frame")?;
        room[12..ETHERNET].copy_from_slice(&gdp_wire::ETHERTYPE.to_be_bytes());
        room[ETHERNET..].copy_from_slice(header.as_bytes());
    }
    Ok(())
}

/// Collects the frames that leave.
#[derive(Default)]
struct Back {
    burst: Burst,
}

impl Sink for Back {
    fn send(&mut self, _: u32, mbuf: Mbuf) {
        // The burst has room: as many frames leave as arrived.
        let _ = self.burst.push(mbuf);
    }

    fn pass(&mut self, _: Mbuf) {}

    fn gathers(&self, _: u32) -> bool {
        false
    }
}
