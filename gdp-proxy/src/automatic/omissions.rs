//! Logs entities that match a pattern and are not carried: one line for each reason, not one for
//! each name.
//!
//! A ROS graph may have any number of names, which may come and go all the time. A reason is logged
//! at once, and then at most once in [`PERIOD`]. The next line counts the names in between.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::mem::{Discriminant, discriminant};
use std::time::{Duration, Instant};

use gdp::Name;
use gdp_ros::catalog::MAX_ENTRIES;

/// Shortest time between two lines with the same reason.
pub const PERIOD: Duration = Duration::from_secs(60);

/// Reasons for which an entity is not carried.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    CatalogHasAllNames,
    CatalogHasAllBytes,
    /// All routes of the proxy are in use; the number is the bound.
    NoFreeRoute(usize),
    /// `remap` gives it the name of another exposed entity.
    RemappedOntoAnother,
    /// Another entity already uses the 256-bit name in the same direction.
    NameIsTaken {
        name: Name,
        by: String,
    },
    /// A local server exists for the service or action: both would execute each call.
    ServedHere,
    /// Its card, certificates or catalog entry cannot be made.
    Failed(String),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CatalogHasAllNames => write!(f, "there are {MAX_ENTRIES} names in the catalog already"),
            Self::CatalogHasAllBytes => f.write_str(
                "the catalog is full with as many grants in it; expose less, or give the readers a role in a domain",
            ),
            Self::NoFreeRoute(most) => write!(f, "there are {most} routes already; run a second proxy"),
            Self::RemappedOntoAnother => f.write_str("remap gives it the name of another"),
            Self::NameIsTaken { name, by } => {
                write!(f, "its name {name:#} is already that of {by}, in the same direction")
            }
            Self::ServedHere => f.write_str("it is served here already; give the import a prefix"),
            Self::Failed(error) => f.write_str(error),
        }
    }
}

/// The entities that are not carried, with the reason. The key is the title, such as `topic
/// /chatter`.
pub type Omitted = BTreeMap<String, Reason>;

/// The omitted entities that the log has reported.
#[derive(Default)]
pub struct Omissions {
    known: Omitted,
    /// The last line of each kind of reason.
    reasons: HashMap<Discriminant<Reason>, Logged>,
}

#[derive(Default)]
struct Logged {
    at: Option<Instant>,
    /// Number of names that were omitted since then.
    news: usize,
}

/// One line of the log.
#[derive(Debug, PartialEq, Eq)]
pub struct Line {
    pub names: usize,
    /// The title of one of them, as an example.
    pub what: String,
    pub reason: Reason,
}

impl Omissions {
    /// Records the entities that are omitted now. Returns the lines to log.
    pub fn update(&mut self, now: Instant, omitted: Omitted) -> Vec<Line> {
        let mut examples = HashMap::new();
        for (what, reason) in &omitted {
            let (kind, is_new) = (discriminant(reason), self.known.get(what) != Some(reason));
            self.reasons.entry(kind).or_default().news += usize::from(is_new);
            let example = examples.entry(kind).or_insert((is_new, what, reason));
            // A new name is a better example than one that was logged before.
            if is_new && !example.0 {
                *example = (is_new, what, reason);
            }
        }
        let mut lines = Vec::new();
        for (kind, (_, what, reason)) in examples {
            let logged = self.reasons.entry(kind).or_default();
            if logged.news > 0 && logged.at.is_none_or(|at| now >= at + PERIOD) {
                let names = std::mem::take(&mut logged.news);
                logged.at = Some(now);
                lines.push(Line { names, what: what.clone(), reason: reason.clone() });
            }
        }
        self.known = omitted;
        lines
    }

    #[cfg(test)]
    pub fn known(&self) -> &Omitted {
        &self.known
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self { names: 1, what, reason } => write!(f, "{what} is not carried: {reason}"),
            Self { names, what, reason } => write!(f, "{names} names are not carried, such as {what}: {reason}"),
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/automatic/omissions.rs"]
mod tests;
