//! The links of a node, for the lifetime of the node: their targets, states and counters.
//!
//! [`Links`] selects the main link and a second one for copies. [`super::sender`] sends on them. A
//! [supervisor](super::supervisor) reconnects each link after a loss.

use std::sync::Arc;
use std::time::Duration;

use gdp_wire::{Header, Name, hop};
use tokio::sync::{Notify, watch};
use zerocopy::IntoBytes;

use super::attachment::Attachment;
use super::choice::{Choice, Fitness};
use super::config::LinkConfig;
use super::counters::{Count, Counters, NodeCounters};
use super::error::NodeError;
use super::link_status::{LinkState, LinkStatus};
use gdp_core::link_target::LinkTarget;
use gdp_core::peer::MAX_LANES;
use gdp_link::port::{OutFrame, Sent};

/// Maximum time for which a request on another link may delay the main link. Four round trips are
/// added.
const OTHERS_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum time for which a request waits for a lost link.
const LINK_TIMEOUT: Duration = Duration::from_secs(10);

/// Time without a preferred link after which a link over TLS is dialled.
const UNANSWERED: Duration = Duration::from_secs(2);

/// Time for which a link over TLS stays after a preferred one has become the main link. What is on
/// the path still arrives.
const LEAVING: Duration = Duration::from_secs(2);

/// The state of a link's connection.
#[derive(Clone)]
pub enum Connection {
    Down(String),
    /// The switch became silent, for this reason. Its kernel may continue to forward, so frames
    /// still leave on the link. Requests cannot use it.
    Stale(Arc<Attachment>, String),
    Up(Arc<Attachment>),
    Closed,
}

impl Connection {
    /// Returns the attachment that frames can be sent on.
    pub fn attachment(&self) -> Option<&Arc<Attachment>> {
        match self {
            Self::Up(attachment) | Self::Stale(attachment, _) => Some(attachment),
            Self::Down(_) | Self::Closed => None,
        }
    }

    /// Returns the link if it is up.
    fn up(&self) -> Result<Arc<Attachment>, NodeError> {
        match self {
            Self::Up(attachment) => Ok(attachment.clone()),
            Self::Down(reason) | Self::Stale(_, reason) => Err(NodeError::Detached(reason.clone())),
            Self::Closed => Err(NodeError::Closed),
        }
    }
}

/// The part of a link's state that needs no lock.
pub struct LinkSlot {
    pub budget: Option<u64>,
    /// Notified when statements may be due on this link.
    pub unstated: Notify,
    pub copies_sent: Count,
    pub copies_dropped: Count,
    frames_sent: Count,
    frames_unsent: Count,
    target: LinkTarget,
}

/// The part of a link's state that changes with its connection.
struct Lane {
    connection: Connection,
    /// Echoes are currently unanswered, although the link is up.
    silent: bool,
    /// This machine has changed networks since the switch last answered.
    moved: bool,
    /// Increases whenever the link enters or leaves use. Copies queued before are then dropped.
    epoch: u64,
}

impl Lane {
    fn is_silent(&self) -> bool {
        self.silent || self.moved
    }

    fn state(&self) -> LinkState {
        match &self.connection {
            Connection::Up(_) if self.is_silent() => LinkState::Silent,
            Connection::Up(_) => LinkState::Up,
            Connection::Stale(..) => LinkState::Stale,
            Connection::Down(_) | Connection::Closed => LinkState::Down,
        }
    }

    fn fitness(&self) -> Fitness {
        match self.state() {
            LinkState::Up => Fitness::Up,
            LinkState::Silent | LinkState::Stale => Fitness::Doubtful,
            LinkState::Down => Fitness::Down,
        }
    }
}

/// All links and the selected ones.
struct LinkTable {
    /// In order of preference; at least one.
    lanes: Vec<Lane>,
    choice: Choice,
    /// Increases each time another link becomes the main one.
    turn: u64,
}

impl LinkTable {
    /// Returns the connection of the main link.
    fn connection(&self) -> &Connection {
        &self.lanes[self.choice.main()].connection
    }

    fn sending_on(&self) -> Result<Arc<Attachment>, NodeError> {
        match self.connection() {
            Connection::Stale(attachment, _) => Ok(attachment.clone()),
            connection => connection.up(),
        }
    }

    fn main(&self) -> Option<(usize, &Arc<Attachment>)> {
        Some((self.choice.main(), self.connection().attachment()?))
    }

    /// Returns the link for copies.
    fn second(&self) -> Option<(usize, &Arc<Attachment>)> {
        let second = self.choice.second()?;
        Some((second, self.lanes[second].connection.attachment()?))
    }

    /// Returns whether a link that is preferred to this one is up.
    fn has_preferred(&self, lane: usize) -> bool {
        self.lanes[..lane].iter().any(|lane| lane.fitness() == Fitness::Up)
    }

    /// Returns whether a link that is preferred to this one is the main link, and up.
    fn is_unneeded(&self, lane: usize) -> bool {
        let main = self.choice.main();
        main < lane && self.lanes[main].fitness() == Fitness::Up
    }

    /// Returns which links carry frames.
    fn in_use(&self) -> [bool; MAX_LANES] {
        let mut used = [false; MAX_LANES];
        self.main().into_iter().chain(self.second()).for_each(|(number, _)| used[number] = true);
        used
    }
}

/// A snapshot of the links to send on, with their numbers.
pub struct ActiveLinks {
    pub main: Option<(usize, Arc<Attachment>)>,
    pub second: Option<(usize, Arc<Attachment>)>,
    /// Epochs by link number; see [`Links::active`].
    pub epochs: [u64; MAX_LANES],
}

/// The effect of a link change.
pub struct Rerouted {
    /// The previous and the new main link, if the main link changed.
    pub main: Option<(usize, usize)>,
    /// Whether the main link can carry frames.
    pub is_attached: bool,
}

/// The state of all links of a node.
pub struct Links {
    /// The name of this node.
    name: Name,
    counters: Arc<Counters>,
    slots: Vec<LinkSlot>,
    table: watch::Sender<LinkTable>,
}

impl Links {
    pub fn new(name: Name, counters: Arc<Counters>, configs: &[LinkConfig]) -> Self {
        let slot = |config: &LinkConfig| LinkSlot {
            budget: config.budget,
            unstated: Notify::new(),
            copies_sent: Count::default(),
            copies_dropped: Count::default(),
            frames_sent: Count::default(),
            frames_unsent: Count::default(),
            target: config.target.clone(),
        };
        let lane =
            |_| Lane { connection: Connection::Down("connecting".into()), silent: false, moved: false, epoch: 0 };
        let lanes = configs.iter().map(lane).collect();
        let table = watch::Sender::new(LinkTable { lanes, choice: Choice::default(), turn: 0 });
        Self { name, counters, slots: configs.iter().map(slot).collect(), table }
    }

    /// Returns the name of this node.
    pub fn name(&self) -> Name {
        self.name
    }

    pub fn slots(&self) -> &[LinkSlot] {
        &self.slots
    }

    pub fn slot(&self, attachment: &Attachment) -> &LinkSlot {
        &self.slots[usize::from(attachment.lane)]
    }

    pub fn main(&self) -> usize {
        self.table.borrow().choice.main()
    }

    pub fn is_main(&self, attachment: &Attachment) -> bool {
        self.main() == usize::from(attachment.lane)
    }

    /// Returns the turn of the main link if this is the main link. The turn differs each time a
    /// link becomes the main one.
    pub fn main_turn(&self, attachment: &Attachment) -> Option<u64> {
        let table = self.table.borrow();
        (table.choice.main() == usize::from(attachment.lane)).then_some(table.turn)
    }

    /// Returns the budget of the main link, in bytes per second.
    pub fn main_budget(&self) -> Option<u64> {
        self.slots[self.main()].budget
    }

    pub fn connection(&self, lane: usize) -> Connection {
        self.table.borrow().lanes[lane].connection.clone()
    }

    /// Returns the main link if it is up.
    pub fn attached_now(&self) -> Result<Arc<Attachment>, NodeError> {
        self.table.borrow().connection().up()
    }

    /// Returns the main link, after waiting for it at most `LINK_TIMEOUT`.
    pub async fn attached(&self) -> Result<Arc<Attachment>, NodeError> {
        let mut changes = self.table.subscribe();
        let is_settled = |table: &LinkTable| matches!(table.connection(), Connection::Up(_) | Connection::Closed);
        let _ = tokio::time::timeout(LINK_TIMEOUT, changes.wait_for(is_settled)).await;
        self.attached_now()
    }

    /// Returns the main link for sending: up, or stale for a limited time.
    pub fn sending_on(&self) -> Result<Arc<Attachment>, NodeError> {
        self.table.borrow().sending_on()
    }

    /// Returns when the main link should no longer wait for an answer on this link. If this link is
    /// silent, it returns at once.
    pub async fn until_unwanted(&self, attachment: &Attachment) {
        let (lane, mut changes) = (usize::from(attachment.lane), self.table.subscribe());
        let is_replaced =
            |table: &LinkTable| table.choice.main() != lane && matches!(table.connection(), Connection::Up(_));
        // `self` contains the sender of the channel.
        let _ = changes.wait_for(is_replaced).await;
        let timeout = OTHERS_TIMEOUT + 4 * attachment.link.rtt();
        let _ = tokio::time::timeout(timeout, changes.wait_for(|table| table.lanes[lane].is_silent())).await;
    }

    /// Waits until no link that is preferred to this one has been up for [`UNANSWERED`]. Each link
    /// over TLS gets that time before the next one. Returns at once if this one was the main link
    /// until now.
    pub async fn until_needed(&self, lane: usize) {
        let is_tls = |slot: &&LinkSlot| matches!(slot.target, LinkTarget::Tls { .. });
        let timeout = UNANSWERED * self.slots[..=lane].iter().filter(is_tls).count() as u32;
        let mut changes = self.table.subscribe();
        loop {
            // `self` contains the sender of the channel.
            let alone = changes.wait_for(|table| !table.has_preferred(lane)).await;
            if alone.is_ok_and(|table| table.choice.main() == lane) {
                return;
            }
            let preferred = changes.wait_for(|table| table.has_preferred(lane));
            if tokio::time::timeout(timeout, preferred).await.is_err() {
                return;
            }
        }
    }

    /// Waits until a link that is preferred to this one has been the main link for [`LEAVING`].
    pub async fn until_unneeded(&self, lane: usize) {
        let mut changes = self.table.subscribe();
        loop {
            let _ = changes.wait_for(|table| table.is_unneeded(lane)).await;
            let needed = changes.wait_for(|table| !table.is_unneeded(lane));
            if tokio::time::timeout(LEAVING, needed).await.is_err() {
                return;
            }
        }
    }

    /// Returns whether a link that is preferred to this one is the main link, and up.
    pub fn is_unneeded(&self, lane: usize) -> bool {
        self.table.borrow().is_unneeded(lane)
    }

    /// Returns the links to send on now. Copies queued for a link under another epoch must be
    /// dropped.
    pub fn active(&self) -> ActiveLinks {
        let table = self.table.borrow();
        let owned = |(number, attachment): (usize, &Arc<Attachment>)| (number, attachment.clone());
        let mut epochs = [0; MAX_LANES];
        epochs.iter_mut().zip(&table.lanes).for_each(|(epoch, lane)| *epoch = lane.epoch);
        ActiveLinks { main: table.main().map(owned), second: table.second().map(owned), epochs }
    }

    /// Returns the maximum payload of the main link, in bytes. With `doubled` it also fits the
    /// second link.
    pub fn max_payload(&self, doubled: bool) -> Option<usize> {
        let table = self.table.borrow();
        max_payload(table.main(), table.second().filter(|_| doubled))
    }

    /// Sets the connection of a link.
    pub fn set_connection(&self, now: u64, lane: usize, connection: Connection) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            (lane.connection, lane.silent, lane.moved) = (connection, false, false);
            true
        })
    }

    /// Updates the reason why a link is still down.
    pub fn still_lost(&self, now: u64, lane: usize, why: String) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            if let Connection::Down(reason) | Connection::Stale(_, reason) = &mut lane.connection {
                *reason = why;
            }
            true
        })
    }

    /// Ends the use of a stale link.
    pub fn end_stale(&self, now: u64, lane: usize) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            if let Connection::Stale(_, reason) = &mut lane.connection {
                lane.connection = Connection::Down(std::mem::take(reason));
            }
            true
        })
    }

    /// Resumes the use of a stale link that has been ended.
    pub fn resume_stale(&self, now: u64, attachment: &Arc<Attachment>) -> Option<Rerouted> {
        self.change(now, attachment.lane.into(), |lane| {
            if let Connection::Down(reason) = &mut lane.connection {
                lane.connection = Connection::Stale(attachment.clone(), std::mem::take(reason));
            }
            true
        })
    }

    /// Sets whether the switch is silent on a link that is up.
    pub fn set_silent(&self, now: u64, lane: usize, silent: bool) -> Option<Rerouted> {
        self.change(now, lane, |lane| std::mem::replace(&mut lane.silent, silent) != silent)
    }

    /// Sets whether this machine has changed networks without an answer from the switch since.
    /// Applies to a link that is up.
    pub fn set_moved(&self, now: u64, lane: usize, moved: bool) -> Option<Rerouted> {
        self.change(now, lane, |lane| std::mem::replace(&mut lane.moved, moved) != moved)
    }

    /// Closes all links for sending.
    pub fn shut(&self) {
        self.table.send_modify(|table| {
            for lane in &mut table.lanes {
                lane.connection = Connection::Closed;
                lane.epoch += 1;
            }
        });
    }

    /// Changes a link that is not closed, and selects links again. `change` returns whether to
    /// notify observers even if the selection stays the same.
    fn change(&self, now: u64, lane: usize, change: impl FnOnce(&mut Lane) -> bool) -> Option<Rerouted> {
        let mut rerouted = None;
        self.table.send_if_modified(|table| {
            if matches!(table.lanes[lane].connection, Connection::Closed) {
                return false;
            }
            let (used_before, main_before) = (table.in_use(), table.choice.main());
            let has_changed = change(&mut table.lanes[lane]);
            let fitness: Vec<_> = table.lanes.iter().map(Lane::fitness).collect();
            if !table.choice.look(now, &fitness) && !has_changed {
                return false;
            }
            let (used, main) = (table.in_use(), table.choice.main());
            for (number, lane) in table.lanes.iter_mut().enumerate() {
                lane.epoch += u64::from(!(used_before[number] && used[number]));
            }
            table.turn += u64::from(main != main_before);
            let is_attached = table.connection().attachment().is_some();
            rerouted = Some(Rerouted { main: (main != main_before).then_some((main_before, main)), is_attached });
            true
        });
        rerouted
    }

    /// Sends a frame on the main link, or on two links if `doubled`. Returns whether there is a
    /// main link.
    pub fn send_one(&self, to: Name, payload: &[u8], doubled: bool) -> bool {
        let ActiveLinks { main, second, .. } = self.active();
        let is_sent = main.is_some();
        for (_, attachment) in main.into_iter().chain(second.filter(|_| doubled)) {
            self.send_one_on(&attachment, to, payload);
        }
        is_sent
    }

    pub fn send_one_on(&self, attachment: &Attachment, to: Name, payload: &[u8]) {
        let mut header = Header::data(to, self.name, payload.len() as u16);
        hop::stamp(&mut header, &attachment.entry.get(), attachment.next_count());
        let frame = OutFrame { to: attachment.link.addr(), head: header.as_bytes(), body: payload };
        self.count(attachment, attachment.data.send_batch([frame]));
    }

    pub fn count(&self, attachment: &Attachment, sent: Sent) {
        let slot = self.slot(attachment);
        for (count, more) in [
            (&self.counters.frames_sent, sent.sent),
            (&slot.frames_sent, sent.sent),
            (&self.counters.frames_unsent, sent.lost),
            (&slot.frames_unsent, sent.lost),
        ] {
            count.add(more as u64);
        }
    }

    pub fn node_counters(&self) -> NodeCounters {
        let table = self.table.borrow();
        let attached = table.lanes.iter().filter_map(|lane| lane.connection.attachment());
        self.counters.snapshot(attached.map(|attachment| attachment.data.receive_drops()).sum())
    }

    /// Returns the status of each link.
    pub fn status(&self) -> Vec<LinkStatus> {
        let table = self.table.borrow();
        let status = |(number, (slot, lane)): (usize, (&LinkSlot, &Lane))| LinkStatus {
            target: slot.target.to_string(),
            state: lane.state(),
            reason: match &lane.connection {
                Connection::Down(reason) | Connection::Stale(_, reason) => Some(reason.clone()),
                Connection::Up(_) | Connection::Closed => None,
            },
            main: number == table.choice.main(),
            switch: lane.connection.attachment().map(|attachment| attachment.link.peer().name),
            frames_sent: slot.frames_sent.get(),
            frames_unsent: slot.frames_unsent.get(),
            copies_sent: slot.copies_sent.get(),
            copies_dropped: slot.copies_dropped.get(),
        };
        self.slots.iter().zip(&table.lanes).enumerate().map(status).collect()
    }
}

impl ActiveLinks {
    /// Returns the maximum payload, as [`Links::max_payload`] does.
    pub fn max_payload(&self, doubled: bool) -> Option<usize> {
        let [main, second] = [&self.main, &self.second].map(|way| way.as_ref().map(|(number, link)| (*number, link)));
        max_payload(main, second.filter(|_| doubled))
    }
}

fn max_payload(main: Option<(usize, &Arc<Attachment>)>, second: Option<(usize, &Arc<Attachment>)>) -> Option<usize> {
    let main = main?.1.max_payload();
    Some(second.map_or(main, |(_, second)| main.min(second.max_payload())))
}
