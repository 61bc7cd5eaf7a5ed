//! The links that a socket of the receiving thread has: the current one, and stale ones on which
//! frames are still in flight.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Instant;

use gdp_wire::replay::{self, Window};
use gdp_wire::{Counter, ErrorCode, FrameType, Header};

use super::attachment::Attachment;
use super::counters::Counters;
use super::feedback::Feedbacks;
use super::shared_entry::SharedEntry;
use gdp_link::link::KeyedEntry;

/// The links on which frames may arrive.
pub struct Ingresses {
    pub current: Ingress,
    /// Stale links, and the time until which each is retained. There are few: one is added each
    /// time the switch returns.
    pub stale: Vec<(Ingress, Instant)>,
}

impl Ingresses {
    pub fn new(current: Ingress) -> Self {
        Self { current, stale: Vec::new() }
    }

    /// Creates the state for a new link. `stale` is the stale link, which continues with its state
    /// from `earlier`. The current link in `earlier` may be another one that was never in service.
    pub fn after(earlier: Option<Self>, new: Ingress, stale: Option<(Ingress, Instant)>) -> Self {
        let mut links = Self::new(new);
        let Some((silent, until)) = stale else { return links };
        let mut before = Vec::new();
        if let Some(earlier) = earlier {
            before = earlier.stale;
            if earlier.current.entry.id == silent.entry.id {
                before.push((earlier.current, until));
            }
        }
        if before.iter().all(|(link, _)| link.entry.id != silent.entry.id) {
            before.push((silent, until));
        }
        links.stale = before;
        links
    }

    /// Loads the latest keys of all links. Call it after frames were received.
    pub fn refresh(&mut self) {
        let stale = self.stale.iter_mut().map(|(link, _)| link);
        stale.chain([&mut self.current]).for_each(|link| link.entry = link.shared.get());
    }

    /// Removes the stale links whose time is over.
    pub fn expire(&mut self, now: Instant) {
        self.stale.retain(|(_, until)| now < *until);
    }

    /// Returns the time when the next stale link is removed.
    pub fn next_expiry(&self) -> Option<Instant> {
        self.stale.iter().map(|(_, until)| *until).min()
    }

    /// Returns the link that a frame's id names. Other frames are assigned to the current link,
    /// which refuses them.
    pub fn of(&self, header: &Header) -> &Ingress {
        let stale = self.stale.iter().map(|(link, _)| link).find(|link| link.entry.id == header.link_id());
        stale.unwrap_or(&self.current)
    }
}

/// A link that frames arrive on, with its replay window.
pub struct Ingress {
    shared: SharedEntry,
    /// A copy of the shared entry for the current batch.
    pub entry: KeyedEntry,
    pub window: Box<Window>,
    /// Number of data frames received, for the attachment.
    pub data_received: Arc<AtomicU64>,
    /// The attachment for answers, as long as the node sends on the link.
    attachment: Weak<Attachment>,
}

impl Ingress {
    pub fn new(shared: SharedEntry, attachment: Weak<Attachment>, data_received: Arc<AtomicU64>) -> Self {
        Self { entry: shared.get(), shared, window: Box::new(replay::empty()), data_received, attachment }
    }

    pub fn of(attachment: &Arc<Attachment>) -> Self {
        Self::new(attachment.entry.clone(), Arc::downgrade(attachment), attachment.data_received.clone())
    }

    /// Counts a data frame. Only the receiving thread calls it.
    pub fn count_data(&self) {
        self.data_received.store(self.data_received.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }

    /// Processes a frame from the switch to this node itself.
    pub fn notice(
        &self,
        frame_type: FrameType,
        header: &Header,
        counters: &Counters,
        feedback: &Feedbacks,
    ) -> Result<(), Counter> {
        match (frame_type, header.egress_set) {
            (FrameType::Error, code) => {
                let code = ErrorCode::from_number(code).ok_or(Counter::Unknown)?;
                counters.errors[code.index()].add(1);
                feedback.add(code, header);
                if let Some(attachment) = self.attachment.upgrade() {
                    attachment.frame_size.learn(code, header);
                }
            }
            (FrameType::Echo, Header::ASKS) => {
                if let Some(attachment) = self.attachment.upgrade() {
                    let mut answer = *header;
                    answer.become_answer();
                    attachment.send(answer);
                    counters.echoes_answered.add(1);
                }
            }
            (FrameType::Echo, Header::ANSWERS) => {
                if let Some(attachment) = self.attachment.upgrade() {
                    attachment.answered(header.egress_bits());
                }
            }
            _ => return Err(Counter::Unknown),
        }
        Ok(())
    }
}
