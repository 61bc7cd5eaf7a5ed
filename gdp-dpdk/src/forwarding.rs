//! What becomes of the packets that arrive together: in phases over all of them, so that what one waits for is fetched while others
//! are worked on. No device is touched here, so tests see the very code that loops run.
//!
//! 1. Each packet's frame is found and its header copied out; its route is prefetched.
//! 2. What the hop tags must be is computed for all of them at once.
//! 3. Each frame is decided about. What leaves is noted with the header it leaves with, or the headers if there are copies.
//! 4. The tags of what leaves are made, again for all at once, and each frame is dressed for its link and handed over.

use gdp_wire::counter::is_sampled;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::header::FIRST_QUIC_BYTE;
use gdp_wire::table::Tables as _;

use gdp_wire::{Carrier, Counter, Header, LinkEntry};
use zerocopy::IntoBytes;

use crate::batch::{BatchTables, Due, Expected, Tags};
use crate::carrier::{self, Carried, Payload};
use crate::local::{At, Local, NextHop};
use crate::mbuf::{Burst, Mbuf, Pool};
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

/// Payloads of copies from this size on are not copied but referred to, where the port takes that. Two mbufs more cost about as much.
const REFERRED: usize = 512;

const ETHERNET_HEADER: usize = 14;

/// Working memory of a loop; nothing is kept in it between batches.
pub struct Forwarding {
    /// Where copies are made.
    pool: Pool,
    frames: Vec<Frame>,
    /// Those of the frames, and behind them those of copies. They stay where they are until they leave: what has just been written byte by
    /// byte is slow to read as a whole.
    headers: Vec<Header>,
    expected: Vec<Expected>,
    tags: Tags,
    leaving: Vec<Way>,
}

/// A packet with a frame that has a header.
struct Frame {
    /// Until it is handed over.
    mbuf: Option<Mbuf>,
    carried: Carried,
}

/// Which frame leaves, and how.
struct Way {
    frame: usize,
    /// The place of its header: the frame's, unless it is a copy.
    header: usize,
    due: Due,
    hop: NextHop,
    carrier: Carrier,
    counter: Counter,
}

impl Way {
    /// Of a frame that was decided to leave by a link; by which it can, and with a tag, or nothing would have been decided so.
    fn by<V: View>(
        link: &LinkEntry,
        (frame, header): (usize, usize),
        counter: Counter,
        tables: &BatchTables<'_, V>,
    ) -> Option<Self> {
        let (hop, due) = (tables.next_hop_of(link)?, tables.take_due()?);
        Some(Self { frame, header, due, hop, carrier: link.carrier, counter })
    }

    fn is_copy(&self) -> bool {
        self.frame != self.header
    }
}

impl Forwarding {
    pub fn new(pool: Pool) -> Self {
        Self {
            pool,
            frames: Vec::with_capacity(Burst::SIZE),
            headers: Vec::with_capacity(Burst::SIZE),
            expected: Vec::with_capacity(Burst::SIZE),
            tags: Tags::default(),
            leaving: Vec::with_capacity(Burst::SIZE),
        }
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
        self.find(&At { local, port }, burst, view, sink, counts);
        self.tags.expect(&self.headers, view.tables(), &mut self.expected);
        self.decide(&BatchTables::new(view, local, ports), view, sink, counts);
        self.tags.write(&mut self.headers, self.leaving.iter().map(|way| (way.header, way.due)));
        self.leave(local.ethertype, sink, counts);
    }

    /// Phase 1.
    fn find<V: View>(&mut self, at: &At<'_>, burst: &mut Burst, view: &V, sink: &mut impl Sink, counts: &mut Counts) {
        for mbuf in burst.drain() {
            match locate(&mbuf, at) {
                Located::Frame(carried) => {
                    match mbuf.bytes().get(carried.at..).and_then(|frame| frame.get(..Header::LEN)) {
                        Some(bytes) => {
                            // A copy, because a frame may lie anywhere.
                            self.headers.push(Header::default());
                            let header = &mut self.headers[self.frames.len()];
                            header.as_mut_bytes().copy_from_slice(bytes);
                            view.prefetch(&header.destination);
                            self.frames.push(Frame { mbuf: Some(mbuf), carried });
                        }
                        None => counts[Counter::Truncated as usize] += 1,
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

    /// Phase 3.
    fn decide<V: View>(&mut self, tables: &BatchTables<'_, V>, view: &V, sink: &mut impl Sink, counts: &mut Counts) {
        let mut arrivals = Arrivals::default();
        for i in 0..self.frames.len() {
            let (header, frame) = (&mut self.headers[i], &mut self.frames[i]);
            let (ingress, tag) = (header.link_id(), header.tag());
            tables.expect(self.expected[i]);
            // What is sent is counted when it leaves.
            let counter = match forward::decide(header, frame.carried.available, frame.carried.traffic, tables) {
                Verdict::Send(link, counter) => {
                    if is_sampled(tag) {
                        view.sample(&header.destination);
                    }
                    self.leaving.extend(Way::by(link, (i, i), counter, tables));
                    counter
                }
                Verdict::Answer(link, counter) => {
                    self.leaving.extend(Way::by(link, (i, i), counter, tables));
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
        }
        arrivals.tell(view);
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
                    self.leaving.extend(Way::by(link, (frame, self.headers.len()), counter, tables));
                    self.headers.push(header);
                }
                Copy::Drop(counter) => counts[counter as usize] += 1,
                Copy::None => {}
            }
        }
    }

    /// Phase 4.
    fn leave(&mut self, ethertype: u16, sink: &mut impl Sink, counts: &mut Counts) {
        let Self { pool, frames, headers, leaving, .. } = self;
        for way in &*leaving {
            let (header, frame) = (&headers[way.header], &mut frames[way.frame]);
            let ready = if way.is_copy() {
                let gathers = sink.gathers(way.hop.port);
                frame
                    .mbuf
                    .as_ref()
                    .and_then(|mbuf| copied(pool, mbuf, frame.carried.at, header, gathers, way, ethertype))
            } else {
                frame.mbuf.take().and_then(|mbuf| changed(mbuf, frame.carried.at, header, way, ethertype))
            };
            match ready {
                Some(mbuf) => {
                    counts[way.counter as usize] += 1;
                    sink.send(way.hop.port, mbuf);
                }
                None => counts[Counter::RedirectFailed as usize] += 1,
            }
        }
        frames.clear();
        headers.clear();
        leaving.clear();
        self.expected.clear();
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
    Frame(Carried),
    /// This host's.
    Host(Counter),
    Drop(Counter),
}

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

/// A packet whose frame lay `at`, as it leaves.
fn changed(mut mbuf: Mbuf, at: usize, header: &Header, way: &Way, ethertype: u16) -> Option<Mbuf> {
    let front = carrier::len(&way.carrier);
    let length = front + header.frame_len();
    if !mbuf.reshape(front as isize - at as isize, length) {
        return None;
    }
    dress(mbuf.bytes_mut()?, front, header, way, ethertype);
    Some(mbuf)
}

/// A packet of its own with the frame that lies `at` in another.
fn copied(
    pool: &Pool,
    of: &Mbuf,
    at: usize,
    header: &Header,
    gathers: bool,
    way: &Way,
    ethertype: u16,
) -> Option<Mbuf> {
    let front = carrier::len(&way.carrier);
    let payload = of.bytes().get(at + Header::LEN..at + header.frame_len())?;
    let mut mbuf = pool.alloc()?;
    if gathers && payload.len() >= REFERRED && !carrier::has_checksum(&way.carrier) {
        mbuf.reshape(0, front + Header::LEN).then_some(())?;
        dress(mbuf.bytes_mut()?, front, header, way, ethertype);
        let mut rest = pool.refer(of)?;
        rest.reshape(-((at + Header::LEN) as isize), payload.len()).then_some(())?;
        return mbuf.chain(rest).then_some(mbuf);
    }
    mbuf.reshape(0, front + header.frame_len()).then_some(())?;
    let bytes = mbuf.bytes_mut()?;
    bytes.get_mut(front + Header::LEN..)?.copy_from_slice(payload);
    dress(bytes, front, header, way, ethertype);
    Some(mbuf)
}

/// Writes what is in front of the payload: `front` bytes of headers, and the frame's own.
fn dress(packet: &mut [u8], front: usize, header: &Header, way: &Way, ethertype: u16) {
    let Some((before, frame)) = packet.split_at_mut_checked(front) else { return };
    if let Some(place) = frame.get_mut(..Header::LEN) {
        place.copy_from_slice(header.as_bytes());
    }
    let traffic = Header::ip_traffic(header.flags);
    let frame = Payload { length: header.frame_len(), bytes: frame };
    carrier::dress(before, frame, &way.carrier, way.hop.stations, traffic, ethertype);
}

fn counted(counts: &mut Counts, counter: Counter) -> Counter {
    counts[counter as usize] += 1;
    counter
}
