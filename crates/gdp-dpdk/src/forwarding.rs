//! What becomes of the packets that arrive together: in phases over all of them, so that what one
//! waits for is fetched while others are worked on. No device is touched here, so tests see the
//! very code that loops run.
//!
//! 1. Each packet's frame is found and its header copied out; its route is prefetched.
//! 2. What the hop tags must be is computed for all of them at once.
//! 3. Each frame is decided about. What leaves is noted with the header it leaves with, or the
//!    headers if there are copies; if there are many, these leave before the next frame is decided
//!    about.
//! 4. What leaves is stamped for its link: those that leave by one are counted at once, and the
//!    tags are made together.
//! 5. Each frame is dressed for its link and handed over.

use gdp_wire::counter::is_sampled;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::header::FIRST_QUIC_BYTE;
use gdp_wire::hop;
use gdp_wire::tables::Tables as _;
use gdp_wire::{Counter, Header, LinkEntry};
use zerocopy::{FromBytes, IntoBytes};

use crate::batch::{self, BatchTables};
use crate::carrier::{self, FrameLocation, Payload, Stations};
use crate::local::{At, Local};
use crate::mbuf::{Burst, Mbuf, Pool};
use crate::siphash::Tags;
use crate::view::View;

/// Where packets go.
pub trait Sink {
    /// By a port of this plane.
    fn send(&mut self, port: u32, mbuf: Mbuf);

    /// To this host, as it arrived.
    fn pass(&mut self, mbuf: Mbuf);

    /// Whether the port takes packets that are chains of mbufs.
    fn gathers(&self, port: u32) -> bool;
}

/// How often each of the counters was counted.
pub type Counts = [u64; Counter::COUNT];

/// Payloads of copies from this size on are not copied but referred to, where the port takes that.
/// Two mbufs more cost about as much.
const REFERRED: usize = 512;

/// Frames and copies that are enough to leave together: a burst, if there are no copies.
const ENOUGH: usize = Burst::SIZE;

const ETHERNET_HEADER: usize = 14;

/// Working memory of a loop; nothing is kept in it between batches.
pub struct Forwarding {
    /// Where copies are made.
    pool: Pool,
    batch: Batch,
    /// Those that frames must have, and those of frames that leave.
    arriving: Tags,
    departing: Tags,
}

/// What is there of the packets that arrived together.
struct Batch {
    frames: Vec<Frame>,
    /// Those of the frames, and behind them those of copies. They stay where they are until they
    /// leave: what has just been written byte by byte is slow to read as a whole.
    headers: Vec<Header>,
    leaving: Vec<Way>,
}

/// A packet with a frame that has a header.
struct Frame {
    /// Until it is handed over.
    mbuf: Option<Mbuf>,
    carried: FrameLocation,
}

/// Which frame leaves, and by which link.
struct Way {
    frame: u32,
    /// The place of its header: the frame's, unless it is a copy.
    header: u32,
    link: u32,
    counter: Counter,
}

impl Way {
    fn is_copy(&self) -> bool {
        self.frame != self.header
    }

    fn has_link_of(&self, other: &Self) -> bool {
        self.link == other.link
    }
}

impl Forwarding {
    pub fn new(pool: Pool) -> Self {
        let batch = Batch {
            frames: Vec::with_capacity(Burst::SIZE),
            headers: Vec::with_capacity(Burst::SIZE),
            leaving: Vec::with_capacity(Burst::SIZE),
        };
        Self { pool, batch, arriving: Tags::new(), departing: Tags::new() }
    }

    /// Forwards what arrived at `port`. `ports`: all that this plane drives.
    pub fn run<V: View>(
        &mut self,
        (port, ports): (u32, &[u32]),
        burst: &mut Burst,
        (view, local): (&V, &Local),
        sink: &mut impl Sink,
        counts: &mut Counts,
    ) {
        let Self { pool, batch, arriving, departing } = self;
        batch.find(&At { local, port }, burst, view, sink, counts);
        batch::expect(arriving, &batch.headers, view.tables());
        let tables = BatchTables::new(view, local, ports, arriving);
        let mut decided = 0;
        while decided < batch.frames.len() {
            decided = batch.decide(decided, &tables, view, sink, counts);
            for ways in batch.leaving.chunks(Tags::SIZE) {
                stamp(ways, &mut batch.headers, departing, view);
                let mut tags = departing.tags().iter();
                for ways in ways.chunk_by(Way::has_link_of) {
                    let by = By::find(ways[0].link, &tables, local.ethertype);
                    for (way, tag) in ways.iter().zip(&mut tags) {
                        let leave = |by: &By<'_>| by.leave((way, *tag), &batch.headers, &mut batch.frames, pool, sink);
                        let left = by.as_ref().and_then(leave);
                        counts[if left.is_some() { way.counter } else { Counter::RedirectFailed } as usize] += 1;
                    }
                }
            }
            batch.leaving.clear();
            batch.headers.truncate(batch.frames.len());
        }
        batch.frames.clear();
        batch.headers.clear();
    }
}

impl Batch {
    /// Phase 1.
    #[inline(always)]
    fn find<V: View>(&mut self, at: &At<'_>, burst: &mut Burst, view: &V, sink: &mut impl Sink, counts: &mut Counts) {
        // Packets may be in another CPU's caches.
        burst.iter().for_each(Mbuf::fetch);
        for mbuf in burst.drain() {
            match locate(&mbuf, at) {
                Located::Frame(carried) => {
                    let frame = mbuf.bytes().get(carried.at..).unwrap_or_default();
                    // A copy, because a frame may lie anywhere.
                    match Header::read_from_prefix(frame) {
                        Ok((header, _)) => {
                            view.prefetch(&header.destination);
                            self.headers.push(header);
                            self.frames.push(Frame { mbuf: Some(mbuf), carried });
                        }
                        Err(_) => counts[Counter::Truncated as usize] += 1,
                    }
                }
                Located::Host(counter) => {
                    counts[counter as usize] += 1;
                    sink.pass(mbuf);
                }
                Located::Drop(counter) => counts[counter as usize] += 1,
            }
        }
    }

    /// Phase 3, from a frame on, until so much leaves that it should before there is more. Says
    /// where it stopped.
    #[inline(always)]
    fn decide<V: View>(
        &mut self,
        from: usize,
        tables: &BatchTables<'_, V>,
        view: &V,
        sink: &mut impl Sink,
        counts: &mut Counts,
    ) -> usize {
        let (mut arrivals, mut i) = (Arrivals::default(), from);
        while i < self.frames.len() && self.leaving.len() < ENOUGH {
            let (header, frame) = (&mut self.headers[i], &mut self.frames[i]);
            let (ingress, tag) = (header.link_id(), header.tag());
            tables.turn_to(i);
            // What is sent is counted when it leaves.
            let counter = match forward::decide(header, frame.carried.available, frame.carried.traffic, tables) {
                Verdict::Send(link, (), counter) => {
                    if is_sampled(tag) {
                        view.sample(&header.destination);
                    }
                    self.leaving.push(Way { frame: i as u32, header: i as u32, link: link.id, counter });
                    counter
                }
                Verdict::Answer(link, (), counter) => {
                    self.leaving.push(Way { frame: i as u32, header: i as u32, link: link.id, counter });
                    counter
                }
                Verdict::Copies(group) => {
                    if is_sampled(tag) {
                        view.sample(&header.destination);
                    }
                    self.copy(i, (ingress, group), view, tables, counts);
                    counted(counts, Counter::Replicated)
                }
                // Another plane's: that is behind this host's interface.
                Verdict::Notice(_) | Verdict::Slow => {
                    frame.mbuf.take().into_iter().for_each(|mbuf| sink.pass(mbuf));
                    counted(counts, Counter::Slow)
                }
                Verdict::Drop(counter) => counted(counts, counter),
            };
            arrivals.count(view, ingress, counter);
            i += 1;
        }
        arrivals.tell(view);
        i
    }

    /// Notes the copies of a frame that leave.
    fn copy<V: View>(
        &mut self,
        frame: usize,
        (ingress, group): (u32, u32),
        view: &V,
        tables: &BatchTables<'_, V>,
        counts: &mut Counts,
    ) {
        let (links, original) = (view.tables(), self.headers[frame]);
        let Some(ingress) = links.link(ingress) else { return };
        for link in view.members(group).filter_map(|id| links.link(id)) {
            let mut header = original;
            match forward::copy(&mut header, original.frame_len(), link, ingress, tables) {
                Copy::Send(counter) => {
                    let (frame, place) = (frame as u32, self.headers.len() as u32);
                    self.leaving.push(Way { frame, header: place, link: link.id, counter });
                    self.headers.push(header);
                }
                Copy::Drop(counter) => counts[counter as usize] += 1,
                Copy::None => {}
            }
        }
    }
}

/// Phase 4, of at most as many as there are tags of at once.
#[inline(always)]
fn stamp<V: View>(ways: &[Way], headers: &mut [Header], tags: &mut Tags, view: &V) {
    tags.clear();
    for ways in ways.chunk_by(Way::has_link_of) {
        let link = view.tables().link(ways[0].link);
        let first = link.map_or(0, |link| view.next_counts(link, ways.len() as u64));
        for (count, way) in (first..).zip(ways) {
            let header = &mut headers[way.header as usize];
            tags.add(way.header, link.map_or([0; 2], |link| hop::direct(header, link, count)), count);
        }
    }
    tags.make(headers);
}

/// By what frames leave.
struct By<'a> {
    link: &'a LinkEntry,
    port: u32,
    stations: Stations<'a>,
    /// Of GDP frames, in host order.
    ethertype: u16,
    /// Bytes in front of a frame.
    front: usize,
}

impl<'a> By<'a> {
    fn find<V: View>(link: u32, tables: &'a BatchTables<'_, V>, ethertype: u16) -> Option<Self> {
        let link = tables.link(link)?;
        let (port, stations) = tables.next_hop_of(link)?;
        Some(Self { link, port, stations, ethertype, front: carrier::len(&link.carrier) })
    }

    /// Phase 5, of one frame; `None` if it cannot leave.
    #[inline(always)]
    fn leave(
        &self,
        (way, tag): (&Way, u64),
        headers: &[Header],
        frames: &mut [Frame],
        pool: &Pool,
        sink: &mut impl Sink,
    ) -> Option<()> {
        let (header, frame) = ((&headers[way.header as usize], tag), &mut frames[way.frame as usize]);
        let at = frame.carried.at;
        let mbuf = if way.is_copy() {
            self.copied(pool, frame.mbuf.as_ref()?, at, sink.gathers(self.port), header)
        } else {
            self.changed(frame.mbuf.take()?, at, header)
        };
        sink.send(self.port, mbuf?);
        Some(())
    }

    /// A packet whose frame lay `at`, as it leaves.
    #[inline]
    fn changed(&self, mut mbuf: Mbuf, at: usize, header: (&Header, u64)) -> Option<Mbuf> {
        if !mbuf.reshape(self.front as isize - at as isize, self.front + header.0.frame_len()) {
            return None;
        }
        self.encapsulate(mbuf.bytes_mut()?, header);
        Some(mbuf)
    }

    /// A packet of its own with the frame that lies `at` in another.
    fn copied(&self, pool: &Pool, of: &Mbuf, at: usize, gathers: bool, header: (&Header, u64)) -> Option<Mbuf> {
        let (front, length) = (self.front, header.0.frame_len());
        let payload = of.bytes().get(at + Header::LEN..at + length)?;
        let mut mbuf = pool.alloc()?;
        if gathers && payload.len() >= REFERRED && !carrier::has_checksum(&self.link.carrier) {
            mbuf.reshape(0, front + Header::LEN).then_some(())?;
            self.encapsulate(mbuf.bytes_mut()?, header);
            let mut rest = pool.refer(of)?;
            rest.reshape(-((at + Header::LEN) as isize), payload.len()).then_some(())?;
            return mbuf.chain(rest).then_some(mbuf);
        }
        mbuf.reshape(0, front + length).then_some(())?;
        let bytes = mbuf.bytes_mut()?;
        bytes.get_mut(front + Header::LEN..)?.copy_from_slice(payload);
        self.encapsulate(bytes, header);
        Some(mbuf)
    }

    /// Writes what is in front of the payload: headers, and the frame's own with its tag. That is
    /// not in it yet: a header that was just written to is slow to copy.
    #[inline]
    fn encapsulate(&self, packet: &mut [u8], (header, tag): (&Header, u64)) {
        let Some((before, frame)) = packet.split_at_mut_checked(self.front) else { return };
        if let Some(place) = frame.get_mut(..Header::LEN) {
            place.copy_from_slice(header.as_bytes());
            place[Header::TAG].copy_from_slice(&tag.to_be_bytes());
        }
        let traffic = Header::ip_traffic(header.flags);
        let frame = Payload { length: header.frame_len(), bytes: frame };
        carrier::encapsulate(before, frame, &self.link.carrier, self.stations, traffic, self.ethertype);
    }
}

/// What became of frames that arrived by one link one after the other, to be told of together.
#[derive(Default)]
struct Arrivals {
    link: u32,
    counter: Option<Counter>,
    frames: u64,
}

impl Arrivals {
    fn count<V: View>(&mut self, view: &V, link: u32, counter: Counter) {
        if (self.link, self.counter) != (link, Some(counter)) {
            self.tell(view);
            (self.link, self.counter, self.frames) = (link, Some(counter), 0);
        }
        self.frames += 1;
    }

    fn tell<V: View>(&self, view: &V) {
        if let Some(counter) = self.counter {
            view.count_arrivals(self.link, counter, self.frames);
        }
    }
}

/// What a packet is, before anything is decided about it.
enum Located {
    /// It has a header, if it is long enough.
    Frame(FrameLocation),
    /// This host's.
    Host(Counter),
    Drop(Counter),
}

#[inline(always)]
fn locate(mbuf: &Mbuf, at: &At<'_>) -> Located {
    let packet = mbuf.bytes();
    if packet.len() < ETHERNET_HEADER {
        return Located::Drop(Counter::Truncated);
    }
    let Some(carried) = carrier::find(packet, at) else { return Located::Host(Counter::Foreign) };
    let frame = packet.get(carried.at..).unwrap_or_default();
    // Behind an empty datagram there may be padding.
    let Some(first) = frame.first().filter(|_| carried.available > 0) else {
        return Located::Drop(Counter::Truncated);
    };
    if carried.over_udp && *first >= FIRST_QUIC_BYTE {
        return Located::Host(Counter::Control);
    }
    match forward::classify(*first) {
        Kind::Headed => Located::Frame(carried),
        Kind::Control => Located::Host(Counter::Control),
        Kind::Unknown => Located::Drop(Counter::Unknown),
    }
}

fn counted(counts: &mut Counts, counter: Counter) -> Counter {
    counts[counter as usize] += 1;
    counter
}
