//! The links of a node for as long as it lives: where each leads, how it is, and what went by it.
//! [`Links`] chooses the main link, and a second one for copies.
//!
//! [`super::sender`] sends by them. A [supervisor](super::supervisor) makes each again when it is
//! lost.

use std::sync::Arc;
use std::time::Duration;

use gdp_wire::{Header, Name, hop};
use serde::Serialize;
use tokio::sync::{Notify, watch};
use zerocopy::IntoBytes;

use super::attachment::Attachment;
use super::choice::{Choice, Fitness};
use super::config::LinkConfig;
use super::counters::{Count, Counters, NodeCounters};
use super::error::NodeError;
use gdp_core::link_target::LinkTarget;
use gdp_core::peer::MAX_LANES;
use gdp_link::port::{OutFrame, Sent};

/// How long a request over another link than the main one may keep that waiting, and four round
/// trips.
const OTHERS_TIMEOUT: Duration = Duration::from_secs(1);

/// How long a request waits for a link that is lost.
const LINK_TIMEOUT: Duration = Duration::from_secs(10);

/// Whether frames can go by a link.
#[derive(Clone)]
pub enum Connection {
    Down(String),
    /// The switch fell silent, for this reason. Its kernel may forward on, so frames still go out
    /// on the link; nothing can be asked over it.
    Stale(Arc<Attachment>, String),
    Up(Arc<Attachment>),
    Closed,
}

impl Connection {
    /// What frames can be sent on.
    pub fn attachment(&self) -> Option<&Arc<Attachment>> {
        match self {
            Self::Up(attachment) | Self::Stale(attachment, _) => Some(attachment),
            Self::Down(_) | Self::Closed => None,
        }
    }

    /// The link, if it is up at this moment.
    fn up(&self) -> Result<Arc<Attachment>, NodeError> {
        match self {
            Self::Up(attachment) => Ok(attachment.clone()),
            Self::Down(reason) | Self::Stale(_, reason) => Err(NodeError::Detached(reason.clone())),
            Self::Closed => Err(NodeError::Closed),
        }
    }
}

/// The part of a link that needs no lock.
pub struct LinkSlot {
    pub budget: Option<u64>,
    /// There may be something to state over it.
    pub unstated: Notify,
    pub copies_sent: Count,
    pub copies_dropped: Count,
    frames_sent: Count,
    frames_unsent: Count,
    target: LinkTarget,
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
    Stale,
    Down,
}

/// The part of a link that changes with it.
struct Lane {
    connection: Connection,
    /// Echoes are not answered at the moment, though the link is up.
    silent: bool,
    /// This machine is in another network since the switch last answered.
    moved: bool,
    /// Rises whenever the link goes in or out of use: copies that waited go nowhere then.
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

/// All links at one moment, and those that are chosen.
struct LinkTable {
    /// In the order in which they are wanted; at least one.
    lanes: Vec<Lane>,
    choice: Choice,
    /// Rises each time another link becomes the main one.
    turn: u64,
}

impl LinkTable {
    /// The main link.
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

    /// What copies go by.
    fn second(&self) -> Option<(usize, &Arc<Attachment>)> {
        let second = self.choice.second()?;
        Some((second, self.lanes[second].connection.attachment()?))
    }

    /// Which links frames go by.
    fn in_use(&self) -> [bool; MAX_LANES] {
        let mut used = [false; MAX_LANES];
        self.main().into_iter().chain(self.second()).for_each(|(number, _)| used[number] = true);
        used
    }
}

/// The links to send by at one moment, with their numbers.
pub struct ActiveLinks {
    pub main: Option<(usize, Arc<Attachment>)>,
    pub second: Option<(usize, Arc<Attachment>)>,
    /// By number; see [`Links::active`].
    pub epochs: [u64; MAX_LANES],
}

/// What the change of a link led to.
pub struct Rerouted {
    /// The main links before and now, if another became that.
    pub main: Option<(usize, usize)>,
    /// Whether frames can go by the main link.
    pub is_attached: bool,
}

/// The owner of all that is known of a node's links.
pub struct Links {
    /// This node's own.
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

    /// This node's own.
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

    /// If this is the main link, a number that differs each time it becomes that.
    pub fn main_turn(&self, attachment: &Attachment) -> Option<u64> {
        let table = self.table.borrow();
        (table.choice.main() == usize::from(attachment.lane)).then_some(table.turn)
    }

    /// Bytes a second that the main link may take.
    pub fn main_budget(&self) -> Option<u64> {
        self.slots[self.main()].budget
    }

    pub fn connection(&self, lane: usize) -> Connection {
        self.table.borrow().lanes[lane].connection.clone()
    }

    /// The main link, if it is up at this moment.
    pub fn attached_now(&self) -> Result<Arc<Attachment>, NodeError> {
        self.table.borrow().connection().up()
    }

    /// The main link, waiting for it a while.
    pub async fn attached(&self) -> Result<Arc<Attachment>, NodeError> {
        let mut changes = self.table.subscribe();
        let is_settled = |table: &LinkTable| matches!(table.connection(), Connection::Up(_) | Connection::Closed);
        let _ = tokio::time::timeout(LINK_TIMEOUT, changes.wait_for(is_settled)).await;
        self.attached_now()
    }

    /// The link that frames go out on: the one that is up, or for a while the one that fell silent.
    pub fn sending_on(&self) -> Result<Arc<Attachment>, NodeError> {
        self.table.borrow().sending_on()
    }

    /// Returns when the main link is not to wait for an answer on this one any more: at once if
    /// this one is silent.
    pub async fn until_unwanted(&self, attachment: &Attachment) {
        let (lane, mut changes) = (usize::from(attachment.lane), self.table.subscribe());
        let is_replaced =
            |table: &LinkTable| table.choice.main() != lane && matches!(table.connection(), Connection::Up(_));
        // The other end of the channel is in `self`.
        let _ = changes.wait_for(is_replaced).await;
        let timeout = OTHERS_TIMEOUT + 4 * attachment.link.rtt();
        let _ = tokio::time::timeout(timeout, changes.wait_for(|table| table.lanes[lane].is_silent())).await;
    }

    /// The links to send by now. Copies for a link whose epoch is another than before go nowhere.
    pub fn active(&self) -> ActiveLinks {
        let table = self.table.borrow();
        let owned = |(number, attachment): (usize, &Arc<Attachment>)| (number, attachment.clone());
        let mut epochs = [0; MAX_LANES];
        epochs.iter_mut().zip(&table.lanes).for_each(|(epoch, lane)| *epoch = lane.epoch);
        ActiveLinks { main: table.main().map(owned), second: table.second().map(owned), epochs }
    }

    /// Bytes of a payload that these links take: the main one, and if anything goes by two
    /// (`doubled`), each of them.
    pub fn max_payload(&self, doubled: bool) -> Option<usize> {
        let table = self.table.borrow();
        max_payload(table.main(), table.second().filter(|_| doubled))
    }

    /// Takes in that a link is up, or is not any more.
    pub fn set_connection(&self, now: u64, lane: usize, connection: Connection) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            (lane.connection, lane.silent, lane.moved) = (connection, false, false);
            true
        })
    }

    /// Why there is still no link.
    pub fn still_lost(&self, now: u64, lane: usize, why: String) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            if let Connection::Down(reason) | Connection::Stale(_, reason) = &mut lane.connection {
                *reason = why;
            }
            true
        })
    }

    /// The link that fell silent is of no use any more.
    pub fn end_stale(&self, now: u64, lane: usize) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            if let Connection::Stale(_, reason) = &mut lane.connection {
                lane.connection = Connection::Down(std::mem::take(reason));
            }
            true
        })
    }

    /// Whether the switch answers; of a link that is up.
    pub fn set_silent(&self, now: u64, lane: usize, silent: bool) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            lane.silent = silent;
            false
        })
    }

    /// Whether this machine has changed networks and the switch has not answered since; of a link
    /// that is up.
    pub fn set_moved(&self, now: u64, lane: usize, moved: bool) -> Option<Rerouted> {
        self.change(now, lane, |lane| {
            lane.moved = moved;
            false
        })
    }

    /// Nothing is sent any more.
    pub fn shut(&self) {
        self.table.send_modify(|table| {
            for lane in &mut table.lanes {
                lane.connection = Connection::Closed;
                lane.epoch += 1;
            }
        });
    }

    /// Changes a link that is not closed, and chooses again. `change` returns whether others are to
    /// know, also if the same links are chosen.
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

    /// Sends a frame by the main link, or by two; whether there is any.
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

    /// How each link is.
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
    /// As [`Links::max_payload`].
    pub fn max_payload(&self, doubled: bool) -> Option<usize> {
        let [main, second] = [&self.main, &self.second].map(|way| way.as_ref().map(|(number, link)| (*number, link)));
        max_payload(main, second.filter(|_| doubled))
    }
}

fn max_payload(main: Option<(usize, &Arc<Attachment>)>, second: Option<(usize, &Arc<Attachment>)>) -> Option<usize> {
    let main = main?.1.max_payload();
    Some(second.map_or(main, |(_, second)| main.min(second.max_payload())))
}
