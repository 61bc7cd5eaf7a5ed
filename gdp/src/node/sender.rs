//! The last stage of the send path: stamps frames and passes them to the sockets of the node's
//! links.
//!
//! Frames are stamped when they leave, never earlier. A frame for two links is copied when the main
//! link sends it. If the link of queued copies becomes the main link, it still sends them.

use std::sync::Arc;

use gdp_wire::{Header, SMALLEST_PATH, hop};
use zerocopy::IntoBytes;

use super::attachment::Attachment;
use super::links::{ActiveLinks, Links};
use gdp_core::peer::MAX_LANES;
use gdp_e2e::transport::{Output, Transmit, Uplink, UplinkOptions};
use gdp_link::port::{BATCH, OutFrame};

/// Bits of [`Header::flags`]: the first bit of the traffic class, and the ECN code point in the two
/// lowest bits (ECT(0), RFC 3168).
const CLASS_SHIFT: u8 = 2;
const UNDERSTANDS_MARKS: u8 = 0b10;

/// The sender. The owner of its lock sends, which preserves the scheduled order of frames.
pub struct Sender {
    links: Arc<Links>,
    /// The frames of one batch; empty between calls.
    pub transmits: Vec<Transmit>,
    headers: Box<[Header; BATCH]>,
    /// Payloads that are concatenated from several parts.
    joined: Vec<u8>,
    /// The queue of copies for each link.
    copies: Vec<Uplink>,
    /// The epochs of the links when their copies were queued.
    epochs: [u64; MAX_LANES],
}

impl Sender {
    pub fn new(links: Arc<Links>) -> Self {
        let max_payload = usize::from(SMALLEST_PATH) - Header::LEN;
        let copies = links.slots().iter();
        Self {
            transmits: Vec::with_capacity(BATCH),
            headers: Box::new([Header::default(); BATCH]),
            joined: Vec::new(),
            copies: copies.map(|slot| Uplink::new(0, UplinkOptions { max_payload, budget: slot.budget })).collect(),
            epochs: [0; MAX_LANES],
            links,
        }
    }

    /// Returns the links to send on now. Drops copies of links whose epoch has changed.
    pub fn active(&mut self) -> ActiveLinks {
        let active = self.links.active();
        for (number, copies) in self.copies.iter_mut().enumerate() {
            if self.epochs[number] != active.epochs[number] {
                copies.drop_copies();
                self.links.slots()[number].copies_dropped.set(copies.copies_dropped());
            }
        }
        self.epochs = active.epochs;
        active
    }

    /// Sends the current batch on the main link, and copies whose time has come. Returns the time
    /// of the next copies, if any wait.
    pub fn send(&mut self, now: u64, active: &ActiveLinks) -> Option<u64> {
        if let Some((second, attachment)) = &active.second {
            self.copy(now, *second, attachment.max_payload());
        }
        if let Some((_, attachment)) = &active.main {
            self.send_frames(attachment);
        }
        let mut next = None;
        for (number, attachment) in active.main.iter().chain(&active.second) {
            let copies = self.take_copies(now, *number);
            self.send_frames(attachment);
            next = next.into_iter().chain(copies).min();
        }
        next
    }

    /// Queues copies of the frames that are sent on two links.
    fn copy(&mut self, now: u64, number: usize, max_payload: usize) {
        if self.transmits.iter().all(|transmit| !transmit.doubled) {
            return;
        }
        let copies = &mut self.copies[number];
        if copies.max_payload() != max_payload {
            copies.set_max_payload(now, max_payload);
        }
        self.transmits.iter().filter(|transmit| transmit.doubled).for_each(|transmit| copies.copy(transmit.clone()));
        self.links.slots()[number].copies_dropped.set(copies.copies_dropped());
    }

    /// Adds copies that may be sent now to the batch. Returns the time of the next ones.
    fn take_copies(&mut self, now: u64, number: usize) -> Option<u64> {
        let copies = &mut self.copies[number];
        while self.transmits.len() < BATCH {
            // A copy queue has no topics and returns no other output.
            let Some(Output::Send(copy)) = copies.poll(now) else { break };
            self.transmits.push(copy);
        }
        self.links.slots()[number].copies_sent.add(self.transmits.len() as u64);
        copies.next_wake()
    }

    fn send_frames(&mut self, attachment: &Attachment) {
        let Self { links, transmits, headers, joined, .. } = self;
        if transmits.is_empty() {
            return;
        }
        let entry = attachment.entry.get();
        joined.clear();
        for (header, transmit) in headers.iter_mut().zip(&*transmits) {
            // Payloads fit the link's MTU, which 16 bits can express.
            *header = Header::data(transmit.name, links.name(), transmit.payload_len() as u16);
            header.flags |= transmit.class << CLASS_SHIFT | UNDERSTANDS_MARKS;
            hop::stamp(header, &entry, attachment.next_count());
            if transmit.payloads().nth(1).is_some() {
                transmit.payloads().for_each(|payload| joined.extend_from_slice(payload));
            }
        }
        let (to, mut rest) = (attachment.link.addr(), &joined[..]);
        let frames = headers.iter().zip(&*transmits).map(|(header, transmit)| {
            let mut payloads = transmit.payloads();
            let body = match (payloads.next(), payloads.next()) {
                (Some(only), None) => only,
                _ => {
                    let (body, behind) = rest.split_at(transmit.payload_len());
                    rest = behind;
                    body
                }
            };
            OutFrame { to, head: header.as_bytes(), body }
        });
        links.count(attachment, attachment.data.send_batch(frames));
        transmits.clear();
    }
}
