//! Quality of service, from the configuration to DDS.

use rustdds::{QosPolicies, QosPolicyBuilder, policy};
use schemars::JsonSchema;
use serde::Deserialize;

use gdp_ros::roster::Offer;

/// Messages that RustDDS keeps of a topic it reads, whatever their size. They are taken out at
/// once, so few will do.
const READER_SAMPLES: u16 = 32;

/// Messages a writer keeps for reliable readers that have not acknowledged them, if its depth is
/// not greater. The next one replaces the oldest, so a reader that died takes nothing from the
/// others.
const WRITER_SAMPLES: u16 = 256;

/// How long a write may wait for the sockets of this host.
const MAX_BLOCKING: rustdds::Duration = rustdds::Duration::from_millis(20);

/// What a ROS 2 node states for a publisher or subscription. The default is ROS 2's own: reliable,
/// volatile, depth 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Qos {
    pub reliability: Reliability,
    pub durability: Durability,
    /// Keep-last history depth, in messages; also what may wait for the fabric before messages are
    /// dropped. At least 1.
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

/// A history depth from 1 to [`Depth::MAX`].
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
        }
    }
}

/// For a DDS reader that takes what publishers of this offer and of lesser ones send.
pub(super) fn reader(offers: &Offer) -> QosPolicies {
    builder(offers, READER_SAMPLES).build()
}

/// For a DDS writer that offers this.
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
        let lease_duration = duration(offers.liveliness_ns);
        builder = builder.liveliness(policy::Liveliness::Automatic { lease_duration });
    }
    builder.build()
}

/// Resource limits are stated although ROS 2 states none: RustDDS would otherwise keep up to 8192
/// messages that a reliable reader has not acknowledged.
fn builder(offers: &Offer, samples: u16) -> QosPolicyBuilder {
    let reliability = match offers.reliable {
        true => policy::Reliability::Reliable { max_blocking_time: MAX_BLOCKING },
        false => policy::Reliability::BestEffort,
    };
    let durability = match offers.transient_local {
        true => policy::Durability::TransientLocal,
        false => policy::Durability::Volatile,
    };
    let depth = match offers.depth {
        0 => Depth::MAX.into(),
        depth => depth.min(Depth::MAX.into()) as i32,
    };
    let max_samples = depth.max(samples.into());
    let limits = policy::ResourceLimits { max_samples, max_instances: 1, max_samples_per_instance: max_samples };
    QosPolicyBuilder::new()
        .reliability(reliability)
        .durability(durability)
        .history(policy::History::KeepLast { depth })
        .resource_limits(limits)
}
