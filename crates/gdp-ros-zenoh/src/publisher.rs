//! Publishers of a topic of any type. Transient-local ones have a cache, from which late
//! subscribers request the last messages.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use bytes::Bytes;
use parking_lot::Mutex;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Reliability};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use crate::attachment::Attachment;
use crate::node::{ZenohError, ZenohNode};
use crate::qos::Qos;
use crate::roll::{Announced, Roll};
use crate::token::Role;
use crate::topic::Topic;

/// Period in which a reliable transient-local publisher repeats the number of its last message.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// Bound on the messages that a transient-local publisher keeps for late subscribers, as in DDS.
const MAX_CACHE: usize = 10_000;

/// A publisher, which exists until it is dropped.
pub struct RawPublisher {
    sink: Arc<Declared>,
    announced: Mutex<Announced>,
    roll: Arc<Roll>,
    topic: Topic,
    sequence: AtomicI64,
}

enum Declared {
    Plain(Publisher<'static>),
    Advanced(AdvancedPublisher<'static>),
}

impl RawPublisher {
    /// Creates a publisher of the node with this full name, or of the own node if the name is
    /// empty.
    pub fn new(of: &ZenohNode, topic: Topic, node: &str) -> Result<Self, ZenohError> {
        let roll = of.roll()?.clone();
        let announced = roll.announce(Role::Publisher, &topic, node)?;
        let Qos { reliable, transient_local, depth, .. } = topic.qos;
        // A subscriber that is too slow would stop everything that this session sends.
        let congestion = if blocks(&topic.qos) { CongestionControl::Block } else { CongestionControl::Drop };
        let reliability = if reliable { Reliability::Reliable } else { Reliability::BestEffort };
        let publisher = roll.session().declare_publisher(topic.key(roll.domain()));
        let publisher = publisher.congestion_control(congestion).reliability(reliability);
        let sink = match transient_local {
            false => Declared::Plain(publisher.wait()?),
            true => {
                let cache = CacheConfig::default()
                    .max_samples(depth.map_or(MAX_CACHE, |depth| MAX_CACHE.min(depth.max(1) as usize)));
                let mut publisher = publisher.cache(cache).publisher_detection();
                if reliable {
                    let heartbeat = MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT);
                    publisher = publisher.sample_miss_detection(heartbeat);
                }
                Declared::Advanced(publisher.wait()?)
            }
        };
        let announced = Mutex::new(announced);
        Ok(Self { sink: sink.into(), announced, roll, topic, sequence: AtomicI64::new(1) })
    }

    /// Shows the publisher as one of the node with this full name.
    pub fn assign(&self, node: &str) -> Result<(), ZenohError> {
        let announced = self.roll.announce(Role::Publisher, &self.topic, node)?;
        *self.announced.lock() = announced;
        Ok(())
    }

    /// Whether there is a subscriber.
    pub fn is_matched(&self) -> bool {
        let status = match &*self.sink {
            Declared::Plain(publisher) => publisher.matching_status().wait(),
            Declared::Advanced(publisher) => publisher.matching_status().wait(),
        };
        status.is_ok_and(|status| status.matching())
    }

    /// Publishes a CDR message with its source time in Unix nanoseconds.
    pub async fn publish(&self, bytes: Bytes, time_ns: u64) -> Result<(), ZenohError> {
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let gid = self.announced.lock().gid;
        let attachment = Attachment { sequence, time_ns: i64::try_from(time_ns).unwrap_or(i64::MAX), gid };
        if !blocks(&self.topic.qos) {
            return Ok(self.sink.put(&self.roll, bytes, attachment)?);
        }
        let (sink, roll) = (self.sink.clone(), self.roll.clone());
        let put = tokio::task::spawn_blocking(move || sink.put(&roll, bytes, attachment));
        put.await.unwrap_or_else(|error| Err(error.into())).map_err(ZenohError::from)
    }
}

impl Declared {
    fn put(&self, roll: &Roll, bytes: Bytes, attachment: Attachment) -> zenoh::Result<()> {
        let attachment = attachment.to_bytes();
        match self {
            Self::Plain(publisher) => publisher
                .put(bytes)
                .encoding(Encoding::ZENOH_BYTES)
                .attachment(attachment)
                .timestamp(roll.session().new_timestamp())
                .wait(),
            // It sets the time itself.
            Self::Advanced(publisher) => {
                publisher.put(bytes).encoding(Encoding::ZENOH_BYTES).attachment(attachment).wait()
            }
        }
    }
}

/// Whether a publisher waits for slow subscribers, as rmw_zenoh does it.
fn blocks(qos: &Qos) -> bool {
    qos.reliable && qos.depth.is_none()
}
