//! What the page shows of a switch, in the order of its panels. Lists are bounded, and texts of
//! others have their control characters escaped. The page only draws it.

use std::collections::BTreeMap;

use gdp_util::escape::Escaped;
use gdp_wire::Name;
use serde::Serialize;

/// Everything at one time. Counters are totals: the page derives rates from two snapshots.
#[derive(Debug, Default, Serialize)]
pub struct PageSnapshot {
    /// Unix time in milliseconds.
    pub at_ms: u64,
    /// Milliseconds since this program started, by a clock that nobody sets: for rates.
    pub uptime_ms: u64,
    /// Why the daemon does not answer.
    pub no_daemon: Option<String>,
    pub problems: Bounded<Problem>,
    pub switch: Option<OwnSwitch>,
    pub nodes: Bounded<MapNode>,
    pub edges: Vec<MapEdge>,
    pub links: Bounded<LinkLine>,
    pub names: Bounded<NameLine>,
    pub domains: Bounded<DomainLine>,
    /// None if this machine does not have the domain's files.
    pub robots: Option<Bounded<RobotLine>>,
    pub robots_error: Option<String>,
    /// Frames by counter, of all data planes.
    pub counters: BTreeMap<String, u64>,
    /// The latest first.
    pub events: Vec<EventLine>,
}

/// What an operator has to look at.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    pub severity: Severity,
    pub what: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    Down,
    Warning,
}

/// The first elements of a list, and how many more there are.
#[derive(Debug, Serialize)]
pub struct Bounded<T> {
    pub rows: Vec<T>,
    pub more: usize,
}

impl<T> Default for Bounded<T> {
    fn default() -> Self {
        Self { rows: Vec::new(), more: 0 }
    }
}

impl<T> Bounded<T> {
    pub fn new(all: impl IntoIterator<Item = T>, most: usize) -> Self {
        let mut all = all.into_iter();
        let rows = all.by_ref().take(most).collect();
        Self { rows, more: all.count() }
    }
}

/// A name, and what people call it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Labelled {
    /// 64 hexadecimal digits.
    pub name: String,
    pub short: String,
    pub label: Option<String>,
}

/// What people call names: topics of cards in the keyring, and labels of members.
#[derive(Clone, Debug, Default)]
pub struct Labels(pub BTreeMap<Name, String>);

impl Labels {
    pub fn of(&self, name: Name) -> Labelled {
        let label = self.0.get(&name).map(|label| text(label));
        Labelled { name: name.to_string(), short: format!("{name:#}"), label }
    }
}

/// Longest text of others that is shown.
const MAX_TEXT: usize = 300;

/// Returns a text of others as it may be shown.
pub fn text(text: &str) -> String {
    let mut shown: String = text.chars().take(MAX_TEXT).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    Escaped(shown).to_string()
}

/// The switch that answers.
#[derive(Debug, Serialize)]
pub struct OwnSwitch {
    pub switch: Labelled,
    pub domain: Option<Labelled>,
    pub data_plane: String,
    pub udp: Option<String>,
    /// Where the domain's RIB is.
    pub rib: Option<Labelled>,
    pub rib_here: bool,
    pub ready: bool,
    /// Names in the FIB.
    pub fib_names: usize,
    /// Names in the RIB, if it is here.
    pub rib_names: Option<usize>,
    pub switches: usize,
    pub reached: usize,
    /// End of the membership, in Unix seconds.
    pub member_until: Option<u64>,
}

/// A switch on the map, or one of another domain at the other end of a border.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct MapNode {
    pub switch: Labelled,
    pub own: bool,
    pub rib: bool,
    /// There is a path to it.
    pub reached: bool,
    /// The other domain that it belongs to.
    pub domain: Option<Labelled>,
    /// Entities that are attached to it, if the RIB is here.
    pub attached: Option<usize>,
}

/// A link between two nodes of the map.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct MapEdge {
    pub ends: [String; 2],
    pub cost: u32,
    /// `up`, `silent` if a daemon does not answer, or `half` if only one end states it.
    pub state: &'static str,
}

/// A link of the switch, or a peer that has none.
#[derive(Debug, Serialize)]
pub struct LinkLine {
    pub peer: Labelled,
    pub role: &'static str,
    /// `up`, `grace` or `down`.
    pub state: &'static str,
    pub via: String,
    pub address: String,
    pub plane: String,
    pub rtt_us: Option<u64>,
    pub age_s: Option<u64>,
    /// Frames.
    pub sent: u64,
    pub arrived: u64,
    pub dropped: u64,
    /// Frames of this switch that the peer refused.
    pub refused: u64,
    /// Why there is no link.
    pub reason: Option<String>,
}

/// A name with its publishers and readers.
#[derive(Debug, Serialize)]
pub struct NameLine {
    pub name: Labelled,
    /// Publishers and servers.
    pub writers: Bounded<Labelled>,
    /// Readers and callers.
    pub readers: Bounded<Labelled>,
    /// `topic`, `service`, `endpoint` for the name of an entity itself, or `–` if it is not known.
    pub kind: &'static str,
    /// Frames, estimated from samples; none unless it is among the busiest.
    pub frames: Option<u64>,
}

/// A trust domain.
#[derive(Debug, Serialize)]
pub struct DomainLine {
    pub domain: Labelled,
    /// `own`, `parent`, `child` or `peer`.
    pub kind: &'static str,
    pub state: &'static str,
    /// Unix seconds.
    pub until: Option<u64>,
    pub detail: String,
}

/// A member of the domain.
#[derive(Debug, Serialize)]
pub struct RobotLine {
    pub label: String,
    pub state: &'static str,
    pub entity: Option<Labelled>,
    pub expose: String,
    pub import: String,
    pub read: String,
    /// End of the membership, in Unix seconds; none if there is none.
    pub until: Option<u64>,
    pub renews: bool,
}

/// Something that happened.
#[derive(Clone, Debug, Serialize)]
pub struct EventLine {
    /// Unix time in milliseconds.
    pub at_ms: u64,
    pub kind: &'static str,
    pub what: String,
}
