//! The direct path of small messages that need no conversion. DDS's receiving thread seals and
//! sends them, and the node's receiving thread writes them into DDS, without the route's task.
//!
//! Everything else takes the way of the task, and the direct path then waits for the task. So no
//! message overtakes an earlier one of its publisher. The readers ([`Reader::set_sink`],
//! [`gdp::unstable::Subscription::set_sink`]) see to that.
//!
//! [`Reader::set_sink`]: crate::graph::Reader::set_sink

use std::cell::Cell;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp::unstable::ImmediateSender;
use gdp_e2e::seal::{Draft, Encoding, Message};
use gdp_wire::Name;
use parking_lot::Mutex;

use crate::graph::{ArrivalSink, Arrived, ImmediateWriter, Key};
use crate::peer_proxies::SiblingProxies;
use crate::stats::RouteCounters;
use gdp_ros::roster;

/// Bound on the bytes of a message on the direct path. The sealing of a larger one would keep the
/// receiving thread from its work.
const MAX_BODY: usize = 16 << 10;

/// Time that a receiving thread has for its other work after it has sent a message. It leaves what
/// follows sooner to the task, so that its socket does not overflow on a busy machine.
const REST: Duration = Duration::from_micros(50);

thread_local! {
    /// When this receiving thread has sent a message the last time.
    static SENT: Cell<Option<Instant>> = const { Cell::new(None) };
}

/// The time of the last message that was written for a publisher.
pub type LastWrite = Arc<Mutex<Option<Instant>>>;

/// The direct path from a ROS graph into the fabric.
pub struct Outward {
    pub sender: ImmediateSender,
    pub encoding: Encoding,
    /// The origins of the publishers that are carried.
    pub origins: HashMap<Key, [u8; 4]>,
    pub counters: Arc<RouteCounters>,
}

impl Outward {
    pub fn into_sink(self) -> ArrivalSink {
        Arc::new(move |arrived| self.send(arrived))
    }

    fn send(&self, arrived: &Arrived) -> bool {
        let Arrived { from, bytes, written_ns, lost } = arrived;
        let Some(origin) = from.and_then(|key| self.origins.get(&key)) else { return false };
        if *lost > 0 || bytes.len() > MAX_BODY {
            return false;
        }
        let began = Instant::now();
        if SENT.get().is_some_and(|last| began - last < REST) {
            return false;
        }
        let draft = Draft { origin, ..Draft::new(self.encoding, bytes) };
        // The task meets the same error, and handles it.
        if !self.sender.send(&draft).unwrap_or(false) {
            return false;
        }
        SENT.set(Some(Instant::now()));
        written_ns.iter().for_each(|written_ns| self.counters.arrival.record_since(*written_ns));
        self.counters.handling.record(began.elapsed());
        self.counters.passed_directly(bytes.len());
        true
    }
}

/// The direct path from the fabric into a ROS graph.
pub struct Inward {
    pub siblings: SiblingProxies,
    /// The writers by entity, session and number of their publisher.
    pub locals: HashMap<(Name, [u8; 16], u32), DirectLocal>,
    pub counters: Arc<RouteCounters>,
}

/// The local writer of one remote publisher.
pub struct DirectLocal {
    pub writer: ImmediateWriter,
    pub written: LastWrite,
}

impl Inward {
    pub fn into_sink(self) -> gdp::unstable::MessageSink {
        Box::new(move |message| (!self.write(&message)).then_some(message))
    }

    fn write(&self, message: &Message) -> bool {
        let Message { writer, session, timestamp_ns, encoding, origin, latched, body, .. } = message;
        if *encoding != Encoding::Cdr || latched.is_some() || body.len() > MAX_BODY {
            return false;
        }
        let Some(number) = roster::number(origin) else { return false };
        let Some(local) = self.locals.get(&(*writer, *session, number)) else { return false };
        let began = Instant::now();
        if self.siblings.contain(began, writer) || !local.writer.write(body.clone(), *timestamp_ns) {
            return false;
        }
        *local.written.lock() = Some(Instant::now());
        self.counters.arrival.record_since(*timestamp_ns);
        self.counters.handling.record(began.elapsed());
        self.counters.passed_directly(body.len());
        true
    }
}
