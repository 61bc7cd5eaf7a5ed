//! Logs what matches a pattern and is not carried: one line for each reason, not one for each name.
//!
//! A ROS graph may have any number of names, and they may come and go all the time. Each reason is
//! logged at once when there is news, then at most once in [`PERIOD`]; what comes in between is in
//! the next line's count.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::mem::{Discriminant, discriminant};
use std::time::{Duration, Instant};

use gdp::Name;
use gdp_ros::catalog::MAX_ENTRIES;

/// Between two lines of one reason.
pub const PERIOD: Duration = Duration::from_secs(60);

/// Why something is not carried.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    CatalogHasAllNames,
    CatalogHasAllBytes,
    /// Of so many.
    NoFreeRoute(usize),
    /// `remap` gives it the name of something else that is exposed.
    RemappedOntoAnother,
    /// The 256-bit name is that of something else already, in the same direction.
    NameIsTaken {
        name: Name,
        by: String,
    },
    /// A service or action: both servers would carry out each call.
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

/// What is not carried, with the reason; by its title, such as `topic /chatter`.
pub type Omitted = BTreeMap<String, Reason>;

/// What the log has of it.
#[derive(Default)]
pub struct Omissions {
    known: Omitted,
    /// By the kind of reason.
    reasons: HashMap<Discriminant<Reason>, Logged>,
}

#[derive(Default)]
struct Logged {
    at: Option<Instant>,
    /// Names that were omitted since then.
    news: usize,
}

/// One line of the log.
#[derive(Debug, PartialEq, Eq)]
pub struct Line {
    pub names: usize,
    /// One of them, and its reason.
    pub what: String,
    pub reason: Reason,
}

impl Omissions {
    /// What is omitted now. Returns what the log is to say.
    pub fn update(&mut self, now: Instant, omitted: Omitted) -> Vec<Line> {
        let mut examples = HashMap::new();
        for (what, reason) in &omitted {
            let (kind, is_new) = (discriminant(reason), self.known.get(what) != Some(reason));
            self.reasons.entry(kind).or_default().news += usize::from(is_new);
            let example = examples.entry(kind).or_insert((is_new, what, reason));
            // A name that is new is a better example than one that was logged before.
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
