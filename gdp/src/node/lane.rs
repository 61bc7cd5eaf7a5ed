//! One of the node's links, for as long as the node lives: where it leads, how it is, what copies
//! wait for it and what went by it. [`SendPath`](super::send_path) sends by it, its
//! [supervisor](super::supervisor) makes it again when it is lost.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_wire::{Header, Name};
use parking_lot::Mutex;
use serde::Serialize;
use tokio::sync::Notify;

use super::choice::Fitness;
use super::counters::Count;
use super::{LinkConfig, LinkTarget};
use crate::node::attachment::Attachment;
use gdp_e2e::transport::{Output, Transmit, Uplink, UplinkOptions};
use gdp_wire::SMALLEST_PATH;

/// How a link is, or all of them are.
#[derive(Clone)]
pub enum Status {
    Down(String),
    /// The switch fell silent, for this reason. Its kernel may forward on, so frames still go out
    /// on the link; nothing can be asked over it.
    Held(Arc<Attachment>, String),
    Up(Arc<Attachment>),
    Closed,
}

impl Status {
    /// What frames can be sent on.
    pub fn attachment(&self) -> Option<&Arc<Attachment>> {
        match self {
            Self::Up(attachment) | Self::Held(attachment, _) => Some(attachment),
            Self::Down(_) | Self::Closed => None,
        }
    }
}

pub struct LinkSlot {
    pub budget: Option<u64>,
    /// There may be something to state over it.
    pub unstated: Notify,
    pub frames_sent: Count,
    pub frames_unsent: Count,
    target: LinkTarget,
    status: Mutex<Status>,
    /// Echoes are not answered at the moment, though the link is up.
    silent: AtomicBool,
    /// This machine is in another network since the switch last answered.
    moved: AtomicBool,
    /// What goes by this link besides the main one.
    copies: Mutex<Uplink>,
    copies_sent: Count,
}

/// How a link is, and what went by it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LinkStatus {
    pub target: String,
    pub state: LinkState,
    /// Why it is not up.
    pub reason: Option<String>,
    /// Whether everything goes by it at the moment.
    pub main: bool,
    /// Who is, or was last heard to be, at its other end; `None` if it is down.
    pub switch: Option<Name>,
    pub frames_sent: u64,
    pub frames_unsent: u64,
    /// Of the frames sent, those that went by the main link as well; and those that its budget, or
    /// its MTU, had no room for, or that still waited when it was lost.
    pub copies_sent: u64,
    pub copies_dropped: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    Up,
    /// It is up, but the switch has not answered for a moment.
    Silent,
    /// The switch fell silent; its data plane may forward on.
    Held,
    Down,
}

impl LinkSlot {
    pub fn new(config: &LinkConfig) -> Self {
        let max_payload = usize::from(SMALLEST_PATH) - Header::LEN;
        Self {
            budget: config.budget,
            unstated: Notify::new(),
            frames_sent: Count::default(),
            frames_unsent: Count::default(),
            target: config.target.clone(),
            status: Mutex::new(Status::Down("connecting".into())),
            silent: AtomicBool::new(false),
            moved: AtomicBool::new(false),
            copies: Mutex::new(Uplink::new(0, UplinkOptions { max_payload, budget: config.budget })),
            copies_sent: Count::default(),
        }
    }

    pub fn status(&self) -> Status {
        self.status.lock().clone()
    }

    /// Unless it is closed: that is for good.
    pub fn change(&self, change: impl FnOnce(&mut Status)) {
        let status = &mut *self.status.lock();
        if !matches!(status, Status::Closed) {
            change(status);
        }
    }

    /// Whether the switch answers; of a link that is up.
    pub fn set_silent(&self, silent: bool) {
        self.silent.store(silent, Ordering::Relaxed);
    }

    /// Whether this machine has changed networks and the switch has not answered since; of a link
    /// that is up.
    pub fn set_moved(&self, moved: bool) {
        self.moved.store(moved, Ordering::Relaxed);
    }

    pub fn is_silent(&self) -> bool {
        self.silent.load(Ordering::Relaxed) || self.moved.load(Ordering::Relaxed)
    }

    pub fn fitness(&self) -> Fitness {
        match self.state() {
            LinkState::Up => Fitness::Up,
            LinkState::Silent | LinkState::Held => Fitness::Doubtful,
            LinkState::Down => Fitness::Down,
        }
    }

    /// `main`: whether it is the main one.
    pub fn snapshot(&self, main: bool) -> LinkStatus {
        let status = self.status();
        let reason = match &status {
            Status::Down(reason) | Status::Held(_, reason) => Some(reason.clone()),
            Status::Up(_) | Status::Closed => None,
        };
        LinkStatus {
            target: self.target.to_string(),
            state: self.state(),
            reason,
            main,
            switch: status.attachment().map(|attachment| attachment.link.peer().name),
            frames_sent: self.frames_sent.get(),
            frames_unsent: self.frames_unsent.get(),
            copies_sent: self.copies_sent.get(),
            copies_dropped: self.copies.lock().copies_dropped(),
        }
    }

    fn state(&self) -> LinkState {
        match &*self.status.lock() {
            Status::Up(_) if self.is_silent() => LinkState::Silent,
            Status::Up(_) => LinkState::Up,
            Status::Held(..) => LinkState::Held,
            Status::Down(_) | Status::Closed => LinkState::Down,
        }
    }

    /// Copies that wait go nowhere: nothing goes by this link at the moment.
    pub fn drop_copies(&self) {
        self.copies.lock().drop_copies();
    }

    /// Takes copies of those frames that are to go by two links.
    pub fn copy(&self, now: u64, transmits: &[Transmit], max_payload: usize) {
        if transmits.iter().all(|transmit| !transmit.doubled) {
            return;
        }
        let copies = &mut *self.copies.lock();
        if copies.max_payload() != max_payload {
            copies.set_max_payload(now, max_payload);
        }
        transmits.iter().filter(|transmit| transmit.doubled).for_each(|transmit| copies.copy(transmit.clone()));
    }

    /// Puts copies that may go now into `batch`, up to `most`. Returns when there is more.
    pub fn take_copies(&self, now: u64, batch: &mut Vec<Transmit>, most: usize) -> Option<u64> {
        let copies = &mut *self.copies.lock();
        while batch.len() < most {
            // It has no topics.
            let Some(Output::Send(copy)) = copies.poll(now) else { break };
            batch.push(copy);
        }
        self.copies_sent.add(batch.len() as u64);
        copies.next_wake()
    }
}
