//! Maps quality of service from the configuration to DDS.

use rustdds::{QosPolicies, QosPolicyBuilder, policy};
use schemars::JsonSchema;
use serde::Deserialize;

use gdp_ros::roster::Offer;

/// Messages of a topic that RustDDS stores for a reader, whatever their size. The proxy reads them
/// at once, so a few suffice.
const READER_SAMPLES: u16 = 32;

/// Messages that a writer stores for reliable readers until they are acknowledged, unless its depth
/// is greater. The next message replaces the oldest, so a reader that died does not block the
/// others.
const WRITER_SAMPLES: u16 = 256;

/// Bound on the time that a write waits for the sockets of this host.
const MAX_BLOCKING: rustdds::Duration = rustdds::Duration::from_millis(20);

/// QoS of a ROS 2 publisher or subscription. The default is that of ROS 2: reliable, volatile,
/// depth 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Qos {
    /// Whether lost messages are sent again; by default `reliable`.
    pub reliability: Reliability,
    /// Whether late subscribers get earlier messages; by default `volatile`.
    pub durability: Durability,
    /// Keep-last history depth in messages, at least 1. It also bounds the messages that wait for
    /// the fabric before some are dropped.
    pub depth: Depth,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reliability {
    #[default]
    Reliable,
    BestEffort,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Durability {
    #[default]
    Volatile,
    TransientLocal,
}

/// A history depth in messages, from 1 to 10000.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(try_from = "u64")]
pub struct Depth(u16);

impl Depth {
    pub const MAX: u16 = 10_000;

    pub const ONE: Self = Self(1);

    pub fn get(self) -> u16 {
        self.0
    }
}

impl TryFrom<u64> for Depth {
    type Error = String;

    fn try_from(depth: u64) -> Result<Self, String> {
        match u16::try_from(depth) {
            Ok(depth @ 1..=Self::MAX) => Ok(Self(depth)),
            _ => Err(format!("a depth of {depth} is not possible: write 1 to {}", Self::MAX)),
        }
    }
}

impl Default for Qos {
    fn default() -> Self {
        Self { reliability: Reliability::default(), durability: Durability::default(), depth: Depth(10) }
    }
}

impl From<Qos> for Offer {
    fn from(qos: Qos) -> Self {
        Self {
            reliable: qos.reliability == Reliability::Reliable,
            transient_local: qos.durability == Durability::TransientLocal,
            depth: qos.depth.get().into(),
            deadline_ns: 0,
            lifespan_ns: 0,
            liveliness_ns: 0,
            manual_liveliness: false,
        }
    }
}

/// Returns the QoS of a DDS reader that matches publishers with at least this offer.
pub(super) fn reader(offers: &Offer) -> QosPolicies {
    builder(offers, READER_SAMPLES).build()
}

/// Shortest lease of liveliness that a writer offers, in nanoseconds. A remote publisher could
/// otherwise make this participant assert its liveliness all the time.
const MIN_LEASE_NS: u64 = 100_000_000;

/// Returns the QoS of a DDS writer with this offer. A lease is at least [`MIN_LEASE_NS`].
pub(super) fn writer(offers: &Offer) -> QosPolicies {
    let duration = |ns: u64| rustdds::Duration::from_nanos(i64::try_from(ns).unwrap_or(i64::MAX));
    let mut builder = builder(offers, WRITER_SAMPLES);
    if offers.deadline_ns > 0 {
        builder = builder.deadline(policy::Deadline(duration(offers.deadline_ns)));
    }
    if offers.lifespan_ns > 0 {
        builder = builder.lifespan(policy::Lifespan { duration: duration(offers.lifespan_ns) });
    }
    if offers.liveliness_ns > 0 {
        let lease_duration = duration(offers.liveliness_ns.max(MIN_LEASE_NS));
        builder = builder.liveliness(match offers.manual_liveliness {
            true => policy::Liveliness::ManualByTopic { lease_duration },
            false => policy::Liveliness::Automatic { lease_duration },
        });
    }
    builder.build()
}

/// Returns a history depth in messages: at most [`Depth::MAX`], which 0 stands for.
pub(super) fn depth(offered: u32) -> usize {
    let most = usize::from(Depth::MAX);
    if offered == 0 { most } else { most.min(offered as usize) }
}

/// Builds the common policies. ROS 2 sets no resource limits, but RustDDS would then store up to
/// 8192 messages that a reliable reader has not acknowledged.
fn builder(offers: &Offer, samples: u16) -> QosPolicyBuilder {
    let reliability = match offers.reliable {
        true => policy::Reliability::Reliable { max_blocking_time: MAX_BLOCKING },
        false => policy::Reliability::BestEffort,
    };
    let durability = match offers.transient_local {
        true => policy::Durability::TransientLocal,
        false => policy::Durability::Volatile,
    };
    let depth = depth(offers.depth) as i32;
    let max_samples = depth.max(samples.into());
    let limits = policy::ResourceLimits { max_samples, max_instances: 1, max_samples_per_instance: max_samples };
    QosPolicyBuilder::new()
        .reliability(reliability)
        .durability(durability)
        .history(policy::History::KeepLast { depth })
        .resource_limits(limits)
}
