//! Writers, switches and readers in simulated time, joined by links with faults. Every step checks
//! the invariants: no duplicate message, no message out of order, bounded memory.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::rc::Rc;

use gdp_faults::{Cable, Delivery, Faults, Network};
use gdp_wire::Name;

use super::outbox::Chosen;
use super::sealed::Frame;
use super::*;
use crate::feedback_wire::Feedback;

pub const SECOND: u64 = 1_000_000_000;
pub const MBIT: u64 = 1_000_000;
pub const PAYLOAD: usize = 1400;
/// Overhead of a message besides its body: segment headers, message header, proof.
const OVERHEAD: usize = 180;

pub struct Simulation {
    net: Network<Packet>,
    nodes: usize,
    /// Neighbours of each node, with the cable to each.
    cables: BTreeMap<usize, Vec<(usize, Cable)>>,
    uplinks: BTreeMap<(usize, usize), Uplink>,
    pub topics: Vec<TopicSim>,
    pub max_payload: usize,
    /// Nodes that lack a processor at times.
    away: BTreeMap<usize, Away>,
    /// What has arrived at nodes that were away.
    held: BTreeMap<usize, VecDeque<(usize, Delivery<Packet>)>>,
    /// A node reads what it held, before it looks at its timers.
    is_draining: bool,
    /// Number of steps so far, which is limited.
    events: u64,
}

/// A node whose processor belongs to others for `away` of every `period`, the first of which began
/// `since` before the start.
#[derive(Clone, Copy, Debug, Default)]
pub struct Away {
    pub period: u64,
    pub away: u64,
    pub since: u64,
}

impl Away {
    /// Returns when a node that wants to run at `at` does.
    fn runs_at(self, at: u64) -> u64 {
        let phase = (at + self.since) % self.period;
        if phase < self.away { at + self.away - phase } else { at }
    }
}

/// A topic, its publisher and its readers.
pub struct TopicSim {
    writer: usize,
    name: Name,
    pub id: TopicId,
    options: TopicOptions,
    app: App,
    next_at: u64,
    next_sequence: u64,
    /// A message that waits for room.
    waiting: Option<Sealed>,
    pub pushed: Vec<u64>,
    frames: HashMap<(u64, u16), Vec<Rc<[Segment]>>>,
    pub readers: BTreeMap<usize, Reading>,
    left: Vec<Reading>,
    /// Payload bytes that the writer has sent.
    pub sent_bytes: u64,
    pub repeated_bytes: u64,
    pub heartbeats: u64,
}

/// The behaviour of a publisher.
#[derive(Clone, Copy, Debug)]
pub struct App {
    pub size: usize,
    pub period: u64,
    /// Start time; `until` is the end time.
    pub from: u64,
    pub until: u64,
}

impl App {
    pub fn new(size: usize, hertz: u64, until: u64) -> Self {
        Self { size, period: SECOND / hertz, from: 0, until }
    }
}

/// A reader of a topic.
pub struct Reading {
    inbound: Inbound<u64>,
    options: InboundOptions,
    open: HashMap<(u64, u16), Vec<bool>>,
    pub from: u64,
    /// Sequence and time of each delivery.
    pub delivered: Vec<(u64, u64)>,
    pub reports: u64,
    pub nacks: u64,
    pub feedback_bytes: u64,
    pub most_memory: usize,
}

impl Reading {
    pub fn counters(&self) -> InboundCounters {
        *self.inbound.counters()
    }

    pub fn next(&self) -> u64 {
        self.inbound.next_sequence()
    }
}

#[derive(Clone, Debug)]
struct Packet {
    topic: usize,
    content: Content,
    marked: bool,
}

#[derive(Clone, Debug)]
enum Content {
    /// The uplink that sent the frame, and its segments.
    Data(usize, Vec<Rc<[Segment]>>),
    Heartbeat(u64, u64),
    /// Feedback to this reader.
    ToReader(usize, Feedback),
    FromReader(usize, Feedback),
}

impl Simulation {
    pub fn new(seed: u64) -> Self {
        Self {
            net: Network::new(seed),
            nodes: 0,
            cables: BTreeMap::new(),
            uplinks: BTreeMap::new(),
            topics: Vec::new(),
            max_payload: PAYLOAD,
            away: BTreeMap::new(),
            held: BTreeMap::new(),
            is_draining: false,
            events: 0,
        }
    }

    pub fn node(&mut self) -> usize {
        self.nodes += 1;
        self.nodes - 1
    }

    pub fn join(&mut self, a: usize, b: usize, there: Faults, back: Faults) -> Cable {
        let cable = self.net.join([a, b], there, back);
        self.cables.entry(a).or_default().push((b, cable));
        self.cables.entry(b).or_default().push((a, cable));
        cable
    }

    /// Returns a writer, a switch and readers. The faults apply to the path from the writer to the
    /// switch, the delay to both directions.
    pub fn star(seed: u64, there: Faults, readers: usize) -> (Self, usize, Vec<usize>) {
        let mut sim = Self::new(seed);
        let (writer, switch) = (sim.node(), sim.node());
        let back = Faults::delay(there.delay);
        sim.join(writer, switch, there, back);
        let readers = (0..readers)
            .map(|_| {
                let reader = sim.node();
                sim.join(switch, reader, Faults::default(), Faults::default());
                reader
            })
            .collect();
        (sim, writer, readers)
    }

    pub fn publish(&mut self, writer: usize, options: TopicOptions, app: App) -> usize {
        let index = self.topics.len();
        let name = Name::from_bytes([index as u8 + 1; 32]);
        let now = self.net.now();
        let id = self.uplink(writer, None).open(now, name, session(index), options);
        self.topics.push(TopicSim {
            writer,
            name,
            id,
            options,
            app,
            next_at: app.from.max(now),
            next_sequence: 1,
            waiting: None,
            pushed: vec![0],
            frames: HashMap::new(),
            readers: BTreeMap::new(),
            left: Vec::new(),
            sent_bytes: 0,
            repeated_bytes: 0,
            heartbeats: 0,
        });
        index
    }

    /// Takes the processor from a node for a part of the time.
    pub fn take_away(&mut self, node: usize, away: Away) {
        self.away.insert(node, away);
    }

    fn runs_at(&self, node: usize, at: u64) -> u64 {
        self.away.get(&node).map_or(at, |away| away.runs_at(at))
    }

    /// Lets the nodes that are back read what has arrived meanwhile.
    fn drain(&mut self) {
        let now = self.net.now();
        let back = self.held.keys().copied().filter(|node| self.runs_at(*node, now) == now);
        for node in back.collect::<Vec<_>>() {
            self.is_draining = true;
            for (from, delivery) in self.held.remove(&node).into_iter().flatten() {
                self.arrived(node, from, delivery);
            }
            self.is_draining = false;
            let topics = (0..self.topics.len()).filter(|topic| self.topics[*topic].readers.contains_key(&node));
            topics.collect::<Vec<_>>().into_iter().for_each(|topic| self.poll_reader(node, topic));
            if self.uplinks.keys().any(|(writer, _)| *writer == node) {
                self.poll_writer(node);
            }
        }
    }

    /// Returns the first uplink of a writer, creating it with this budget if necessary.
    pub fn uplink(&mut self, writer: usize, budget: Option<u64>) -> &mut Uplink {
        let options = UplinkOptions { max_payload: self.max_payload, budget };
        let now = self.net.now();
        self.uplinks.entry((writer, 0)).or_insert_with(|| Uplink::new(now, options))
    }

    /// Returns a second uplink for doubled topics.
    pub fn second_uplink(&mut self, writer: usize, budget: u64) -> &mut Uplink {
        let options = UplinkOptions { max_payload: self.max_payload, budget: Some(budget) };
        let now = self.net.now();
        self.uplinks.entry((writer, 1)).or_insert_with(|| Uplink::new(now, options))
    }

    pub fn subscribe(&mut self, reader: usize, topic: usize, rtt: u64, options: InboundOptions) {
        let now = self.net.now();
        let (writer, id) = (self.topics[topic].writer, self.topics[topic].id);
        let from = self.uplink(writer, None).join(now, id, name_of(reader)).unwrap();
        let topic_sim = &mut self.topics[topic];
        let reading = Reading {
            inbound: Inbound::new(topic_sim.name, session(topic), from, rtt, options),
            options,
            open: HashMap::new(),
            from,
            delivered: Vec::new(),
            reports: 0,
            nacks: 0,
            feedback_bytes: 0,
            most_memory: 0,
        };
        let before = topic_sim.readers.insert(reader, reading);
        topic_sim.left.extend(before);
    }

    /// Tells the writer that the reader has restarted, since it subscribed last.
    pub fn restart_reader(&mut self, reader: usize, topic: usize) {
        let (now, TopicSim { writer, id, readers, .. }) = (self.net.now(), &self.topics[topic]);
        let (writer, id, from) = (*writer, *id, readers[&reader].from);
        self.uplink(writer, None).restart(now, id, &name_of(reader), from);
    }

    pub fn unsubscribe(&mut self, reader: usize, topic: usize) {
        let now = self.net.now();
        let (writer, id) = (self.topics[topic].writer, self.topics[topic].id);
        self.uplink(writer, None).leave(now, id, &name_of(reader));
        let left = self.topics[topic].readers.remove(&reader);
        self.topics[topic].left.extend(left);
        self.poll_writer(writer);
    }

    pub fn now(&self) -> u64 {
        self.net.now()
    }

    pub fn topic_counters(&self, topic: usize) -> TopicCounters {
        let topic = &self.topics[topic];
        self.uplinks[&(topic.writer, 0)].counters(topic.id).unwrap()
    }

    /// Returns the times from push to delivery, ascending.
    pub fn latencies(&self, topic: usize, reader: usize) -> Vec<u64> {
        let topic = &self.topics[topic];
        let mut all: Vec<u64> = topic.readers[&reader]
            .delivered
            .iter()
            .map(|(sequence, at)| at - topic.pushed[*sequence as usize])
            .collect();
        all.sort_unstable();
        all
    }

    pub fn set_max_payload(&mut self, max_payload: usize) {
        self.max_payload = max_payload;
        let now = self.net.now();
        self.uplinks.values_mut().for_each(|uplink| uplink.set_max_payload(now, max_payload));
        let writers: Vec<usize> = self.uplinks.keys().map(|(writer, _)| *writer).collect();
        writers.into_iter().for_each(|writer| self.poll_writer(writer));
    }

    pub fn run(&mut self, until: u64) {
        loop {
            self.events += 1;
            assert!(self.events < 50_000_000, "a livelock at {}", self.net.now());
            let wake = self.next_wake().min(until);
            match self.net.arrival(wake) {
                Some(arrival) if self.runs_at(arrival.to, self.net.now()) > self.net.now() => {
                    self.held.entry(arrival.to).or_default().push_back((arrival.from, arrival.delivery));
                }
                Some(arrival) => self.arrived(arrival.to, arrival.from, arrival.delivery),
                None => {
                    let now = self.net.now();
                    self.drain();
                    self.applications(now);
                    let due = |uplink: &Uplink| uplink.next_wake().is_some_and(|at| at <= now);
                    let is_there = |node: usize| self.runs_at(node, now) == now;
                    let writers = self.uplinks.iter().filter(|((writer, _), uplink)| due(uplink) && is_there(*writer));
                    let writers: Vec<usize> = writers.map(|((writer, _), _)| *writer).collect();
                    writers.into_iter().for_each(|writer| self.poll_writer(writer));
                    for topic in 0..self.topics.len() {
                        let due = |reading: &Reading| reading.inbound.next_wake().is_some_and(|at| at <= now);
                        let is_there = |node: usize| self.runs_at(node, now) == now;
                        let readers = self.topics[topic].readers.iter();
                        let readers = readers.filter(|(reader, reading)| due(reading) && is_there(**reader));
                        let readers: Vec<usize> = readers.map(|(reader, _)| *reader).collect();
                        readers.into_iter().for_each(|reader| self.poll_reader(reader, topic));
                    }
                    if now >= until && self.next_wake() > now {
                        return;
                    }
                }
            }
        }
    }

    /// Returns whether only occasional heartbeats remain.
    pub fn is_quiet(&self) -> bool {
        self.next_wake() > self.net.now() + 10 * MS
    }

    fn next_wake(&self) -> u64 {
        let apps = self.topics.iter().filter(|topic| topic.waiting.is_none() && topic.next_at < topic.app.until);
        let apps = apps.map(|topic| topic.next_at);
        let uplinks = self.uplinks.iter();
        let uplinks = uplinks.filter_map(|((writer, _), uplink)| Some(self.wake_at(*writer, uplink.next_wake()?)));
        let readings = self.topics.iter().flat_map(|topic| &topic.readers);
        let readings =
            readings.filter_map(|(reader, reading)| Some(self.wake_at(*reader, reading.inbound.next_wake()?)));
        let held = self.held.keys().map(|node| self.runs_at(*node, self.net.now()));
        apps.chain(uplinks).chain(readings).chain(held).min().unwrap_or(u64::MAX)
    }

    /// Returns when a node reaches a timer for `at`, which may have passed.
    fn wake_at(&self, node: usize, at: u64) -> u64 {
        self.runs_at(node, at.max(self.net.now()))
    }

    fn applications(&mut self, now: u64) {
        for index in 0..self.topics.len() {
            while self.topics[index].waiting.is_none()
                && self.topics[index].next_at <= now
                && self.topics[index].next_at < self.topics[index].app.until
            {
                let max_payload = self.max_payload;
                let topic = &mut self.topics[index];
                topic.next_at += topic.app.period;
                let sequence = topic.next_sequence;
                topic.next_sequence += 1;
                topic.pushed.push(now);
                let message = topic.seal(sequence, 0, max_payload);
                self.push(index, message);
            }
        }
    }

    fn push(&mut self, topic: usize, message: Sealed) {
        let now = self.net.now();
        let (writer, id) = (self.topics[topic].writer, self.topics[topic].id);
        match self.uplink(writer, None).push(now, id, message) {
            Ok(()) => {}
            Err(Full::Wait(message)) => self.topics[topic].waiting = Some(message),
            Err(Full::Refused(message)) => panic!("{} was refused", message.first()),
        }
        self.poll_writer(writer);
    }

    fn poll_writer(&mut self, writer: usize) {
        let now = self.net.now();
        for which in 0..2 {
            while let Some(output) = self.uplinks.get_mut(&(writer, which)).and_then(|uplink| uplink.poll(now)) {
                self.events += 1;
                assert!(self.events < 50_000_000, "a livelock at {now}: {output:?}");
                self.do_output(writer, which, output);
            }
        }
    }

    fn do_output(&mut self, writer: usize, which: usize, output: Output) {
        let now = self.net.now();
        match output {
            Output::Send(transmit) => {
                let index = self.topics.iter().position(|topic| topic.name == transmit.name).unwrap();
                let topic = &mut self.topics[index];
                let segments: Vec<_> = transmit.parts().map(|part| topic.segments(part)).collect();
                let bytes: usize = segments.iter().flat_map(|part| part.iter()).map(|segment| segment.bytes).sum();
                assert_eq!(bytes, transmit.payload_len());
                assert!(bytes <= self.max_payload.max(PAYLOAD));
                if which == 0 {
                    topic.sent_bytes += bytes as u64;
                    topic.repeated_bytes += transmit
                        .parts()
                        .filter(|part| part.repair)
                        .map(|part| part.message.len(part.frame) as u64)
                        .sum::<u64>();
                }
                let packet = Packet { topic: index, content: Content::Data(which, segments), marked: false };
                self.forward(writer, None, packet, bytes);
                if which == 0 && transmit.doubled {
                    let options = UplinkOptions { max_payload: self.max_payload, budget: None };
                    self.uplinks.entry((writer, 1)).or_insert_with(|| Uplink::new(now, options)).copy(transmit);
                }
            }
            Output::Reseal { topic, message } => {
                let index = self.topics.iter().position(|sim| sim.writer == writer && sim.id == topic).unwrap();
                let max_payload = self.uplink(writer, None).max_payload_of(now, topic);
                let smaller = self.topics[index].seal(message.first(), message.cut() + 1, max_payload);
                self.uplink(writer, None).resealed(now, topic, smaller);
            }
            Output::Heartbeat { topic, next, oldest } => {
                let index = self.topics.iter().position(|sim| sim.writer == writer && sim.id == topic).unwrap();
                self.topics[index].heartbeats += 1;
                let packet = Packet { topic: index, content: Content::Heartbeat(next, oldest), marked: false };
                self.forward(writer, None, packet, 160);
            }
            Output::Unavailable { topic, reader, oldest } => {
                let index = self.topics.iter().position(|sim| sim.writer == writer && sim.id == topic).unwrap();
                let (name, session) = (self.topics[index].name, session(index));
                let to = self.topics[index].readers.keys().copied().find(|node| name_of(*node) == reader);
                let Some(to) = to else { return };
                let content = Content::ToReader(to, Feedback::Unavailable { name, session, oldest });
                self.forward(writer, None, Packet { topic: index, content, marked: false }, 120);
            }
            Output::Room { topic } => {
                let index = self.topics.iter().position(|sim| sim.writer == writer && sim.id == topic).unwrap();
                if let Some(message) = self.topics[index].waiting.take() {
                    let uplink = self.uplinks.get_mut(&(writer, 0)).unwrap();
                    match uplink.push(now, topic, message) {
                        Ok(()) => self.topics[index].next_at = self.topics[index].next_at.max(now),
                        Err(Full::Wait(message)) => self.topics[index].waiting = Some(message),
                        Err(Full::Refused(_)) => panic!("refused"),
                    }
                }
            }
        }
    }

    fn arrived(&mut self, node: usize, from: usize, delivery: Delivery<Packet>) {
        let now = self.net.now();
        // The hop tag or the cipher detects the corruption.
        if delivery.corrupted.is_some() {
            return;
        }
        let mut packet = delivery.frame;
        packet.marked |= delivery.marked;
        let topic = packet.topic;
        match &packet.content {
            Content::Data(_, parts) if self.topics[topic].readers.contains_key(&node) => {
                let reading = self.topics[topic].readers.get_mut(&node).unwrap();
                if packet.marked {
                    reading.inbound.congested();
                }
                parts.iter().flat_map(|part| part.iter()).for_each(|segment| reading.take(now, segment));
                self.poll_reader(node, topic);
            }
            Content::Heartbeat(next, oldest) if self.topics[topic].readers.contains_key(&node) => {
                let reading = self.topics[topic].readers.get_mut(&node).unwrap();
                reading.inbound.heartbeat(now, *next, *oldest);
                self.poll_reader(node, topic);
            }
            Content::ToReader(to, feedback) if *to == node => {
                if let Some(reading) = self.topics[topic].readers.get_mut(&node) {
                    reading.inbound.feedback(now, feedback);
                    self.poll_reader(node, topic);
                }
            }
            Content::FromReader(reader, feedback) if self.topics[topic].writer == node => {
                let id = self.topics[topic].id;
                let name = name_of(*reader);
                self.uplink(node, None).feedback(now, id, name, feedback);
                if !self.is_draining {
                    self.poll_writer(node);
                }
            }
            content => {
                let bytes = match content {
                    Content::Data(_, parts) => {
                        parts.iter().flat_map(|part| part.iter()).map(|segment| segment.bytes).sum()
                    }
                    Content::Heartbeat(..) => 160,
                    Content::ToReader(_, feedback) | Content::FromReader(_, feedback) => size_of_feedback(feedback),
                };
                self.forward(node, Some(from), packet, bytes);
            }
        }
    }

    fn poll_reader(&mut self, node: usize, topic: usize) {
        if self.is_draining {
            return;
        }
        let now = self.net.now();
        let mut out = Vec::new();
        let reading = self.topics[topic].readers.get_mut(&node).unwrap();
        while let Some(arrival) = reading.inbound.poll(now) {
            match arrival {
                Arrival::Message(sequence) => {
                    assert!(
                        reading.delivered.last().is_none_or(|(last, _)| *last < sequence),
                        "{sequence} twice or late"
                    );
                    assert!(sequence >= reading.from);
                    reading.delivered.push((sequence, now));
                }
                Arrival::Feedback(feedback) => out.push(feedback),
            }
        }
        let next = reading.inbound.next_sequence();
        reading.open.retain(|(sequence, _), _| *sequence >= next);
        reading.most_memory = reading.most_memory.max(reading.inbound.memory());
        let counters = reading.counters();
        let dealt = counters.delivered + counters.overtaken + counters.expired + counters.abandoned;
        assert_eq!(dealt, next - reading.from, "counted exactly: {counters:?}");
        assert_eq!(counters.delivered, reading.delivered.len() as u64);
        for feedback in out {
            let mut bytes = Vec::new();
            feedback.encode(&mut bytes).unwrap();
            assert_eq!(Feedback::decode_all(&bytes).as_deref(), Ok(std::slice::from_ref(&feedback)));
            let size = size_of_feedback(&feedback);
            let reading = self.topics[topic].readers.get_mut(&node).unwrap();
            reading.feedback_bytes += size as u64;
            match feedback {
                Feedback::Report { .. } => reading.reports += 1,
                _ => reading.nacks += 1,
            }
            let packet = Packet { topic, content: Content::FromReader(node, feedback), marked: false };
            self.forward(node, None, packet, size);
        }
    }

    /// Forwards a packet towards all its receivers, but not back.
    fn forward(&mut self, node: usize, from: Option<usize>, packet: Packet, bytes: usize) {
        let topic = &self.topics[packet.topic];
        let (to, which): (Vec<usize>, usize) = match &packet.content {
            Content::Data(which, _) => (topic.readers.keys().copied().collect(), *which),
            Content::Heartbeat(..) => (topic.readers.keys().copied().collect(), 0),
            Content::ToReader(reader, _) => (vec![*reader], 0),
            Content::FromReader(..) => (vec![topic.writer], 0),
        };
        // A reader with two return paths uses both.
        if matches!(packet.content, Content::FromReader(..)) && from.is_none() && topic.options.doubled {
            for (_, cable) in self.cables[&node].clone() {
                self.net.send(node, cable, packet.clone(), bytes + FRAME_HEADER as usize);
            }
            return;
        }
        let mut hops: Vec<(usize, Cable)> = to.iter().filter_map(|to| self.hop(node, *to, which)).collect();
        hops.sort_unstable();
        hops.dedup();
        for (_, cable) in hops.into_iter().filter(|(next, _)| Some(*next) != from) {
            self.net.send(node, cable, packet.clone(), bytes + FRAME_HEADER as usize);
        }
    }

    /// Returns the next node on the shortest path. A writer with two uplinks has two paths.
    fn hop(&self, from: usize, to: usize, which: usize) -> Option<(usize, Cable)> {
        let neighbours = &self.cables[&from];
        let is_doubled_writer = self.topics.iter().any(|topic| topic.writer == from && topic.options.doubled);
        if is_doubled_writer {
            return neighbours.get(which).copied();
        }
        if let Some(direct) = neighbours.iter().find(|(next, _)| *next == to) {
            return Some(*direct);
        }
        neighbours.iter().copied().min_by_key(|(next, _)| self.distance(*next, to, from))
    }

    fn distance(&self, from: usize, to: usize, not: usize) -> usize {
        let mut seen = vec![from, not];
        let mut queue = VecDeque::from([(from, 0)]);
        while let Some((node, distance)) = queue.pop_front() {
            if node == to {
                return distance;
            }
            for (next, _) in &self.cables[&node] {
                if !seen.contains(next) {
                    seen.push(*next);
                    queue.push_back((*next, distance + 1));
                }
            }
        }
        usize::MAX
    }
}

impl TopicSim {
    /// Seals a message of the publisher's size. Each frame carries one segment.
    fn seal(&mut self, sequence: u64, cut: u16, max_payload: usize) -> Sealed {
        let all = self.app.size + OVERHEAD;
        let count = all.div_ceil(max_payload).max(1);
        let mut frames = Vec::new();
        let mut described: Vec<Rc<[Segment]>> = Vec::new();
        for index in 0..count {
            let bytes = (all - index * max_payload).min(max_payload);
            let end = (index * max_payload) + bytes;
            let index = index as u32;
            frames.push(Frame { first: Position { sequence, index }, end });
            let (position, total) = (Position { sequence, index }, count as u32);
            described.push(Rc::new([Segment { position, cut, total, bytes }]));
        }
        self.frames.insert((sequence, cut), described);
        Sealed::without_bytes(frames, sequence, cut)
    }

    fn segments(&self, part: &Chosen) -> Rc<[Segment]> {
        self.frames[&(part.message.first(), part.message.cut())][part.frame].clone()
    }
}

impl Reading {
    /// Acts as the reader of sealed segments: assembles messages, from the cut that is complete
    /// first.
    fn take(&mut self, now: u64, segment: &Segment) {
        if !self.inbound.segment(now, segment) {
            return;
        }
        let sequence = segment.position.sequence;
        let open = self.open.entry((sequence, segment.cut)).or_insert_with(|| vec![false; segment.total as usize]);
        assert!(!std::mem::replace(&mut open[segment.position.index as usize], true), "new only once");
        if open.iter().all(|came| *came) {
            self.open.remove(&(sequence, segment.cut));
            self.inbound.complete(now, sequence, open_bytes(segment), sequence);
        }
        assert!(self.inbound.memory() <= self.options.bytes + (1 << 20));
    }
}

fn open_bytes(segment: &Segment) -> usize {
    (segment.total as usize - 1) * PAYLOAD
}

fn session(topic: usize) -> [u8; 16] {
    [topic as u8; 16]
}

pub fn name_of(node: usize) -> Name {
    let mut bytes = [0xee; 32];
    bytes[..8].copy_from_slice(&(node as u64).to_be_bytes());
    Name::from_bytes(bytes)
}

fn size_of_feedback(feedback: &Feedback) -> usize {
    let mut bytes = Vec::new();
    feedback.encode(&mut bytes).unwrap();
    bytes.len() + 60
}

/// Returns the percentile of ascending values: the smallest one that at least `percent` percent do
/// not exceed.
pub fn percentile(values: &[u64], percent: usize) -> u64 {
    values[(values.len() * percent).div_ceil(100).max(1) - 1]
}
