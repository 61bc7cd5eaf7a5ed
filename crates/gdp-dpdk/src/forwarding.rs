//! Processing of packets that arrive together. Each phase handles all packets, so that memory for
//! one packet is fetched while others are processed. The module accesses no devices, so tests run
//! the same code as the loops.
//!
//! 1. Find each packet's frame, copy its header out, and prefetch its route.
//! 2. Compute the expected hop tags of all frames at once.
//! 3. Decide on each frame. Record outgoing frames with their new header, or one header for each
//!    copy. If there are many, send them before the next decision.
//! 4. Stamp outgoing frames. The frames of one link get their sequence numbers together, and all
//!    tags are computed together.
//! 5. Encapsulate each frame for its link and send it.

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

/// Egress of packets.
pub trait Sink {
    /// Sends a packet by a port of this plane.
    fn send(&mut self, port: u32, mbuf: Mbuf);

    /// Passes a packet to this host, unchanged.
    fn pass(&mut self, mbuf: Mbuf);

    /// Returns whether the port accepts chained mbufs.
    fn gathers(&self, port: u32) -> bool;
}

/// Increments of each counter.
pub type Counts = [u64; Counter::COUNT];

/// Minimum size of payloads that copies share instead of copying, if the port supports it. Two more
/// mbufs cost about as much as copying this size.
const REFERRED: usize = 512;

/// Number of frames and copies after which a batch leaves: one burst, if there are no copies.
const ENOUGH: usize = Burst::SIZE;

const ETHERNET_HEADER: usize = 14;

/// Working memory of a loop. It contains no state between batches.
pub struct Forwarding {
    /// Pool for copies.
    pool: Pool,
    batch: Batch,
    /// Expected tags of arriving frames, and tags of outgoing frames.
    arriving: Tags,
    departing: Tags,
}

/// State of the packets that arrived together.
struct Batch {
    frames: Vec<Frame>,
    /// Headers of the frames, followed by those of copies. They are not moved until they leave:
    /// reading a whole header is slow just after its bytes were written separately.
    headers: Vec<Header>,
    leaving: Vec<Way>,
}

/// A packet whose frame has a header.
struct Frame {
    /// `None` after the packet has been passed on.
    mbuf: Option<Mbuf>,
    carried: FrameLocation,
}

/// An outgoing frame and its link.
struct Way {
    frame: u32,
    /// Index of its header, which differs from the frame's index for a copy.
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

    /// Forwards packets that arrived at `port`. `ports`: all ports that this plane drives.
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
    /// Runs phase 1.
    #[inline(always)]
    fn find<V: View>(&mut self, at: &At<'_>, burst: &mut Burst, view: &V, sink: &mut impl Sink, counts: &mut Counts) {
        // The packets may be in another CPU's caches.
        burst.iter().for_each(Mbuf::fetch);
        for mbuf in burst.drain() {
            match locate(&mbuf, at) {
                Located::Frame(carried) => {
                    let frame = mbuf.bytes().get(carried.at..).unwrap_or_default();
                    // Copy the header, because a frame may be unaligned.
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

    /// Runs phase 3 from a frame on, until enough frames must leave. Returns the index at which it
    /// stopped.
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
            // Sent frames are counted when they leave.
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
                // These frames are for another plane, behind the host's interface.
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

    /// Records the outgoing copies of a frame.
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

/// Runs phase 4 for at most [`Tags::SIZE`] frames.
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

/// Egress of frames.
struct By<'a> {
    link: &'a LinkEntry,
    port: u32,
    stations: Stations<'a>,
    /// Ethertype of GDP frames, in host order.
    ethertype: u16,
    /// Length in bytes of the headers in front of a frame.
    front: usize,
}

impl<'a> By<'a> {
    fn find<V: View>(link: u32, tables: &'a BatchTables<'_, V>, ethertype: u16) -> Option<Self> {
        let link = tables.link(link)?;
        let (port, stations) = tables.next_hop_of(link)?;
        Some(Self { link, port, stations, ethertype, front: carrier::len(&link.carrier) })
    }

    /// Runs phase 5 for one frame; `None` if it cannot leave.
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

    /// Returns the outgoing packet for a frame that is at offset `at`.
    #[inline]
    fn changed(&self, mut mbuf: Mbuf, at: usize, header: (&Header, u64)) -> Option<Mbuf> {
        if !mbuf.reshape(self.front as isize - at as isize, self.front + header.0.frame_len()) {
            return None;
        }
        self.encapsulate(mbuf.bytes_mut()?, header);
        Some(mbuf)
    }

    /// Returns a new packet with a copy of the frame at offset `at` of another.
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

    /// Writes the outer headers, and the frame's header with its tag. The tag is added here,
    /// because copying a header just after writing to it is slow.
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

/// Consecutive frames of one link with the same outcome, which are reported together.
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

/// Classification of a packet before the decision.
enum Located {
    /// A frame with a header, if it is long enough.
    Frame(FrameLocation),
    /// A packet for this host.
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
    // Padding may follow an empty datagram.
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
