//! The QoS in a liveliness token: six fields with a colon between them. An empty field is the
//! default of ROS 2.
//!
//! ```text
//! reliability : durability : history,depth : deadline s,ns : lifespan s,ns : liveliness,s,ns
//! ```

use std::fmt;

/// QoS of an endpoint. Durations are nanoseconds, and 0 is infinite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    pub reliable: bool,
    pub transient_local: bool,
    /// Keep-last depth in messages, or `None` for "keep all".
    pub depth: Option<u32>,
    pub deadline_ns: u64,
    pub lifespan_ns: u64,
    pub liveliness_ns: u64,
    /// Whether the endpoint itself asserts its liveliness, by topic.
    pub manual_liveliness: bool,
}

/// The default QoS of ROS 2.
impl Default for Qos {
    fn default() -> Self {
        Self {
            reliable: true,
            transient_local: false,
            depth: Some(DEPTH),
            deadline_ns: 0,
            lifespan_ns: 0,
            liveliness_ns: 0,
            manual_liveliness: false,
        }
    }
}

const DEPTH: u32 = 10;

/// Seconds from which a duration is infinite. ROS writes 2^63 - 1 nanoseconds.
const INFINITE_S: u64 = i64::MAX as u64 / 1_000_000_000;

impl Qos {
    /// Reads the QoS of a token, which may be hostile.
    pub fn parse(text: &str) -> Option<Self> {
        let mut fields = text.split(':');
        let mut next = || fields.next();
        let (reliability, durability, history) = (next()?, next()?, next()?);
        let (deadline, lifespan, liveliness) = (next()?, next()?, next()?);
        if next().is_some() {
            return None;
        }
        let (history, depth) = history.split_once(',')?;
        let (liveliness, lease) = liveliness.split_once(',')?;
        let depth = if depth.is_empty() { DEPTH } else { depth.parse().ok()? };
        Some(Self {
            reliable: match reliability {
                "" | "0" | "1" => true,
                "2" => false,
                _ => return None,
            },
            transient_local: match durability {
                "" | "0" | "2" => false,
                "1" => true,
                _ => return None,
            },
            depth: match history {
                "" | "0" | "1" => Some(depth),
                "2" => None,
                _ => return None,
            },
            deadline_ns: duration(deadline)?,
            lifespan_ns: duration(lifespan)?,
            liveliness_ns: duration(lease)?,
            manual_liveliness: match liveliness {
                "" | "0" | "1" | "2" => false,
                "3" => true,
                _ => return None,
            },
        })
    }
}

/// Reads a duration in seconds and nanoseconds. Without digits it is infinite, which is 0.
fn duration(text: &str) -> Option<u64> {
    let (seconds, nanoseconds) = text.split_once(',')?;
    let number = |text: &str| if text.is_empty() { Some(0) } else { text.parse::<u64>().ok() };
    let (seconds, nanoseconds) = (number(seconds)?, number(nanoseconds)?);
    match seconds {
        INFINITE_S.. => Some(0),
        _ => seconds.checked_mul(1_000_000_000)?.checked_add(nanoseconds),
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.reliable { ":" } else { "2:" })?;
        f.write_str(if self.transient_local { "1:" } else { ":" })?;
        match self.depth {
            Some(depth) => write!(f, ",{depth}:")?,
            None => write!(f, "2,{DEPTH}:")?,
        }
        for (ns, end) in [(self.deadline_ns, ":"), (self.lifespan_ns, ":")] {
            write_duration(f, ns)?;
            f.write_str(end)?;
        }
        f.write_str(if self.manual_liveliness { "3," } else { "," })?;
        write_duration(f, self.liveliness_ns)
    }
}

fn write_duration(f: &mut fmt::Formatter<'_>, ns: u64) -> fmt::Result {
    match ns {
        0 => f.write_str(","),
        ns => write!(f, "{},{}", ns / 1_000_000_000, ns % 1_000_000_000),
    }
}

#[cfg(test)]
#[path = "../tests/unit/qos.rs"]
mod tests;
