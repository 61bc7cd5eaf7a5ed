//! What was refused in the last minute, by peer: links and registrations. `gdp-ctl status` shows
//! it. Any peer may cause refusals, so their number and the length of a reason are bounded.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use gdp_proto::admin::links::Counts;
use gdp_proto::admin::status::RecentRefusal;
use gdp_proto::admin::words::RefusedThing;
use gdp_proto::control::RefusalCode;
use gdp_util::line_limit::{LineLimit, differ_in_digits_at_most};
use gdp_wire::Name;

/// The maximum number of peers to remember, once for each thing. The oldest make room.
const MAX_ENTRIES: usize = 64;

/// The maximum length of a reason in bytes.
const MAX_REASON: usize = 512;

/// The window is counted in slots: a refusal counts for 50 to 60 s.
const SLOTS: usize = 6;
const SLOT: Duration = Duration::from_secs(10);

/// Maximum number of log lines about each thing in a minute. Anybody can make keys, and each is a
/// new peer.
const LINES: u32 = 10;

#[derive(Debug)]
pub struct RecentRefusals {
    start: Instant,
    entries: HashMap<(Name, &'static str), Refusals>,
    /// All refusals since the start, by thing and kind. Both are of closed sets.
    total: BTreeMap<&'static str, Counts>,
    link_lines: LineLimit,
    registration_lines: LineLimit,
}

#[derive(Debug)]
struct Refusals {
    what: RefusedThing,
    reason: String,
    at: Instant,
    /// The number of the latest slot, and the counts by slot number modulo [`SLOTS`].
    slot: u64,
    counts: [u32; SLOTS],
}

impl RecentRefusals {
    pub fn new(start: Instant) -> Self {
        let [link_lines, registration_lines] = [(); 2].map(|()| LineLimit::new(LINES, Duration::from_secs(60)));
        Self { start, entries: HashMap::new(), total: BTreeMap::new(), link_lines, registration_lines }
    }

    /// Asks for a log line about a refusal, as [`LineLimit::take`] does.
    pub fn line(&self, what: RefusedThing, now: Instant) -> Option<u64> {
        match what {
            RefusedThing::Link => self.link_lines.take(now),
            RefusedThing::Registration => self.registration_lines.take(now),
        }
    }

    /// Records a refusal. Registrations have a code, links only a reason. Returns whether the last
    /// minute has no refusal of the peer for this reason.
    pub fn add(
        &mut self,
        peer: Name,
        what: RefusedThing,
        code: Option<RefusalCode>,
        reason: &str,
        now: Instant,
    ) -> bool {
        let kind = code.map_or_else(|| "NotAdmitted".to_owned(), |code| format!("{code:?}"));
        *self.total.entry(what.as_str()).or_default().entry(kind).or_default() += 1;
        let (key, slot) = ((peer, what.as_str()), self.slot(now));
        self.entries.retain(|_, entry| entry.count(slot) > 0);
        if self.entries.len() >= MAX_ENTRIES && !self.entries.contains_key(&key) {
            let oldest = self.entries.iter().min_by_key(|(_, entry)| entry.at).map(|(key, _)| *key);
            oldest.and_then(|oldest| self.entries.remove(&oldest));
        }
        let new = || Refusals { what, reason: String::new(), at: now, slot, counts: [0; SLOTS] };
        let entry = self.entries.entry(key).or_insert_with(new);
        entry.advance(slot);
        let count = &mut entry.counts[slot as usize % SLOTS];
        *count = count.saturating_add(1);
        entry.at = now;
        let reason = shortened(reason);
        let is_new = !differ_in_digits_at_most(&entry.reason, reason);
        entry.reason = reason.to_owned();
        is_new
    }

    /// Returns the refusals of the last minute, the latest first.
    pub fn all(&self, now: Instant) -> Vec<RecentRefusal> {
        let slot = self.slot(now);
        let mut all: Vec<_> = self.entries.iter().filter(|(_, entry)| entry.count(slot) > 0).collect();
        all.sort_by_key(|(_, entry)| std::cmp::Reverse(entry.at));
        let output = |(&(peer, _), entry): (&(Name, &str), &Refusals)| RecentRefusal {
            peer,
            what: entry.what,
            reason: entry.reason.clone(),
            count: entry.count(slot),
            age_s: now.saturating_duration_since(entry.at).as_secs(),
        };
        all.into_iter().map(output).collect()
    }

    /// Returns the refusals since the start, by thing and code.
    pub fn total(&self) -> BTreeMap<String, Counts> {
        self.total.iter().map(|(what, counts)| ((*what).to_owned(), counts.clone())).collect()
    }

    fn slot(&self, now: Instant) -> u64 {
        now.saturating_duration_since(self.start).as_secs() / SLOT.as_secs()
    }
}

/// Returns the part of a reason that is kept.
pub fn shortened(reason: &str) -> &str {
    &reason[..reason.floor_char_boundary(MAX_REASON)]
}

impl Refusals {
    /// Returns the count of the slots up to this one.
    fn count(&self, slot: u64) -> u32 {
        let is_recent = |back: &u64| *back <= self.slot && slot.saturating_sub(self.slot) + back < SLOTS as u64;
        (0..SLOTS as u64)
            .filter(is_recent)
            .map(|back| self.counts[(self.slot - back) as usize % SLOTS])
            .fold(0, u32::saturating_add)
    }

    /// Clears the counts of slots that have passed since the latest one.
    fn advance(&mut self, slot: u64) {
        for passed in (self.slot + 1..=slot).take(SLOTS) {
            self.counts[passed as usize % SLOTS] = 0;
        }
        if slot.saturating_sub(self.slot) >= SLOTS as u64 {
            self.counts = [0; SLOTS];
        }
        self.slot = self.slot.max(slot);
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/recent_refusals.rs"]
mod tests;
