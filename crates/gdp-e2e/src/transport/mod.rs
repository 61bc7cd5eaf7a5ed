//! Schedules and repairs sealed messages (`docs/architecture.md`, "A message").
//!
//! The transport decides the order and rate of frames, retransmissions, and when to give up a
//! message. It consists of state machines without sockets, clocks or keys. Time is in nanoseconds
//! of any monotonic clock.
//!
//! ```text
//!  Publisher ── seal ── push(Sealed) ─►┌ Uplink ──────────────────────────────┐
//!  (any task; waits if Full            │ a topic: Outbox  queue, history      │
//!   until Output::Room)                │          Peers   a Path per reader   │
//!                                      │ turns by class, pacing, budget       │
//!  sending task ◄──── poll: Output ────└──────────────────────────────────────┘
//!    Send(Transmit)   frames to the socket; to a second Uplink by copy(), if the topic is doubled
//!    Reseal           the message again, in smaller frames, by resealed()
//!    Heartbeat, Unavailable  sealed and sent by the node                ▲
//!                                                                │ feedback(reader, Report | Nack)
//!  ═════════════════════════ network ════════════════════════════╪══════════════════════
//!                                                                │
//!  receiving thread ── open ── segment, complete ─►┌ Inbound ────┴─────────────────────────┐
//!                                                  │ gaps, order or newest, deadline       │
//!  Subscription ◄──── poll: Arrival::Message ──────│ poll: Arrival::Feedback(Report, Nack) │
//!                                                  └───────────────────────────────────────┘
//! ```
//!
//! - [`Uplink`]: one for each link to a switch, behind one lock. Publishers push, one task polls,
//!   and the receiving thread passes feedback.
//! - [`Inbound`]: one for each session of a writer, owned by the receiving thread. The thread
//!   reports a segment after opening it under the session's key, and a message after verifying its
//!   signature.
//!
//! No reader can use more than its share. The speed of a topic follows the fastest reader that
//! reports. The retransmissions for each reader have a budget. No reader can make the writer retain
//! more than its history.

mod arrival;
mod black_hole;
mod congestion;
mod delivery_rate;
mod history;
mod inbound;
mod meter;
mod outbox;
mod peers;
mod reordering;
mod repair_budget;
mod reports;
mod sealed;
mod sent_log;
mod slot;
mod topic;
mod uplink;

pub use crate::transport::arrival::{Arrival, InboundCounters, InboundOptions, Order, Segment};
pub use history::{History, Overflow, Reliability, TopicCounters};
pub use inbound::Inbound;
pub use sealed::{Position, Sealed};
pub use topic::TopicOptions;
pub use uplink::{Full, Output, TopicId, Transmit, Uplink, UplinkOptions};

/// Nanoseconds in a millisecond.
const MS: u64 = 1_000_000;

/// Bytes of the header before a frame's payload, which count towards rates and budgets.
const FRAME_HEADER: u64 = size_of::<gdp_wire::Header>() as u64;

#[cfg(test)]
#[path = "../../tests/unit/transport/cases.rs"]
mod cases;
#[cfg(test)]
#[path = "../../tests/unit/transport/gigabit.rs"]
mod gigabit;
#[cfg(test)]
#[path = "../../tests/unit/transport/properties.rs"]
mod properties;
#[cfg(test)]
#[path = "../../tests/unit/transport/simulation.rs"]
mod simulation;
#[cfg(test)]
#[path = "../../tests/unit/transport/stale.rs"]
mod stale;
#[cfg(test)]
#[path = "../../tests/unit/transport/turns.rs"]
mod turns;
