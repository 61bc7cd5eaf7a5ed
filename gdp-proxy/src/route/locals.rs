//! The counterparts of all publishers elsewhere, for one topic.

use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

use gdp_wire::Name;

use super::local::{Local, Made};
use gdp_ros::roster::{Change, Offer};

/// Publishers elsewhere that have a counterpart. More have none.
const MAX_LOCALS: usize = 512;

/// Bytes that are kept of what all of them latch, or wait for subscribers.
const MAX_BYTES: usize = 256 << 20;

/// Counterparts that stay for a moment after their publisher. Of more, the oldest go at once.
const MAX_LEAVING: usize = 64;

/// Writers that are made: so many at once, and one more in each period. Who says something else of its publishers with every message would keep the whole ROS
/// graph busy.
const BURST: u32 = MAX_LOCALS as u32;
const PERIOD: Duration = Duration::from_millis(50);

/// Whose counterpart it is. `None`: of all writers that tell no publishers apart.
pub type Whose = Option<(Name, u32)>;

pub struct Locals {
    by: HashMap<Whose, Local>,
    leaving: VecDeque<Made>,
    /// Messages that waited with those that had to go before it was their time, since that was last asked.
    abandoned: u64,
    budget: Budget,
}

struct Budget {
    left: u32,
    since: Instant,
}

impl Locals {
    pub fn new(now: Instant) -> Self {
        Self { by: HashMap::new(), leaving: VecDeque::new(), abandoned: 0, budget: Budget { left: BURST, since: now } }
    }

    pub fn get(&mut self, whose: &Whose) -> Option<&mut Local> {
        self.by.get_mut(whose)
    }

    pub fn insert(&mut self, whose: Whose, local: Local) {
        self.by.insert(whose, local);
    }

    /// False if there is no room.
    pub fn change(&mut self, now: Instant, change: Change) -> bool {
        let gone = match change {
            Change::Left { writer, number } => self.by.remove(&Some((writer, number))).and_then(Local::into_made),
            Change::Silent { writer, number } => {
                // Nobody is to take it for there a moment longer.
                self.by.get_mut(&Some((writer, number))).and_then(Local::silence);
                None
            }
            Change::Joined { writer, number, kind, definition, offers } => {
                let (whose, is_full) = (Some((writer, number)), self.by.len() >= MAX_LOCALS);
                match self.by.get_mut(&whose) {
                    Some(local) => local.renew(kind, definition, offers),
                    None if is_full => return false,
                    None => {
                        self.by.insert(whose, Local::new(kind, definition, offers));
                        None
                    }
                }
            }
        };
        if let Some(made) = gone.filter(|made| !made.is_over(now)) {
            made.writer.vacate();
            self.leaving.push_back(made);
        }
        while self.leaving.len() > MAX_LEAVING {
            self.abandoned += self.leaving.pop_front().map_or(0, Made::abandon);
        }
        true
    }

    /// Those that are to be made now, as far as so many may be.
    pub fn due(&mut self, now: Instant) -> Vec<Whose> {
        let due: Vec<Whose> = self.by.iter().filter(|(_, local)| local.is_due(now)).map(|(whose, _)| *whose).collect();
        due.into_iter().take_while(|_| self.budget.take(now)).collect()
    }

    /// All that are there, also those that are about to go.
    pub fn made(&mut self) -> impl Iterator<Item = &mut Made> {
        self.by.values_mut().filter_map(Local::made_mut).chain(&mut self.leaving)
    }

    pub fn is_busy(&mut self) -> bool {
        self.made().any(|made| made.is_holding())
    }

    /// Lets the oldest messages go of whoever has most, until all are no more than [`MAX_BYTES`] together: how many, and those that have gone
    /// with their counterparts.
    pub fn trim(&mut self) -> u64 {
        let bytes = self.by.values().map(Local::bytes).chain(self.leaving.iter().map(Made::bytes));
        let (mut bytes, mut gone): (usize, _) = (bytes.sum(), std::mem::take(&mut self.abandoned));
        while bytes > MAX_BYTES {
            let there = self.by.values_mut().max_by_key(|local| local.bytes());
            let leaving = self.leaving.iter_mut().max_by_key(|made| made.bytes());
            let freed = match (there, leaving) {
                (Some(there), Some(leaving)) if leaving.bytes() > there.bytes() => leaving.evict(),
                (Some(there), _) => there.evict(),
                (None, Some(leaving)) => leaving.evict(),
                (None, None) => 0,
            };
            (bytes, gone) = (bytes.saturating_sub(freed), gone + 1);
        }
        gone
    }

    /// Lets those go whose time is over.
    pub fn sweep(&mut self, now: Instant) {
        self.leaving.retain(|made| !made.is_over(now));
    }

    /// What each of them offers that is there.
    pub fn offers(&mut self) -> impl Iterator<Item = (Whose, Offer)> {
        self.by.iter_mut().filter_map(|(whose, local)| Some((*whose, local.made_mut()?.offers)))
    }

    /// Whether none could be made of those that are to be there.
    pub fn are_hopeless(&self) -> bool {
        self.faults().next().is_some() && !self.by.values().any(Local::is_made)
    }

    /// The publishers that have none, and why.
    pub fn faults(&self) -> impl Iterator<Item = (&Whose, &str)> {
        self.by.iter().filter_map(|(whose, local)| Some((whose, local.fault()?)))
    }
}

impl Budget {
    fn take(&mut self, now: Instant) -> bool {
        let periods = now.saturating_duration_since(self.since).as_millis() / PERIOD.as_millis();
        if periods > 0 {
            let more = u32::try_from(periods).unwrap_or(BURST);
            (self.left, self.since) = (self.left.saturating_add(more).min(BURST), now);
        }
        let may = self.left > 0;
        self.left -= u32::from(may);
        may
    }
}

#[cfg(test)]
mod tests {
    use gdp_e2e::seal::{Encoding, Message};

    use super::*;
    use gdp_ros::roster::{Dialect, Kind};

    #[test]
    fn a_roster_that_changes_all_the_time_makes_only_so_many_writers() {
        let start = Instant::now();
        let mut locals = Locals::new(start);
        let mut made = 0;
        for i in 0..10_000 {
            let now = start + Duration::from_millis(i);
            locals.change(now, joined(7, Offer { depth: i as u32, ..OFFER }));
            made += locals.due(now).len();
        }
        assert!((512..=512 + 200).contains(&made), "{made}");
        let taken = (100..1000).filter(|number| locals.change(start, joined(*number, OFFER))).count();
        assert_eq!(taken, MAX_LOCALS - 1);
    }

    #[test]
    fn what_all_latch_together_is_bounded_and_the_largest_lose_their_oldest() {
        let (now, mut locals) = (Instant::now(), Locals::new(Instant::now()));
        let latches = Offer { transient_local: true, depth: 100, ..OFFER };
        let body = bytes::Bytes::from(vec![0; 8 << 20]);
        let mut keep = |number, count| {
            locals.change(now, joined(number, latches));
            let local = locals.get(&Some((WRITER, number))).unwrap();
            (0..count).for_each(|_| local.keep(&message(body.clone())));
            local.bytes()
        };
        let small = keep(0, 1);
        assert_eq!((small, keep(1, 7)), (8 << 20, 56 << 20));
        assert_eq!(keep(2, 9), 64 << 20, "of one publisher no more");
        (3..6).for_each(|number| _ = keep(number, 8));
        assert_eq!(locals.trim(), 8);
        let mut bytes: Vec<usize> = (0..6).map(|i| locals.get(&Some((WRITER, i))).unwrap().bytes() >> 20).collect();
        bytes.sort_unstable();
        assert_eq!(bytes, [8, 48, 48, 48, 48, 56]);
        assert_eq!(locals.trim(), 0);
    }

    #[test]
    fn it_is_hopeless_while_no_counterpart_can_be_made() {
        let (now, mut locals) = (Instant::now(), Locals::new(Instant::now()));
        assert!(!locals.are_hopeless(), "nobody is to be there");
        locals.change(now, joined(0, OFFER));
        assert!(!locals.are_hopeless(), "it was not tried");
        locals.get(&Some((WRITER, 0))).unwrap().failed(now, "no type".into());
        assert!(locals.are_hopeless());
        locals.change(now, Change::Left { writer: WRITER, number: 0 });
        assert!(!locals.are_hopeless());
    }

    const WRITER: Name = Name::from_bytes([1; 32]);

    const OFFER: Offer =
        Offer { reliable: true, transient_local: false, depth: 1, deadline_ns: 0, lifespan_ns: 0, liveliness_ns: 0 };

    fn joined(number: u32, offers: Offer) -> Change {
        let kind = Kind { dialect: Dialect::Ros2, name: "std_msgs/msg/String".into(), hash: vec![] };
        Change::Joined { writer: WRITER, number, kind, definition: None, offers }
    }

    fn message(body: bytes::Bytes) -> Message {
        Message {
            name: Name::from_bytes([0; 32]),
            writer: WRITER,
            session: [0; 16],
            sequence: 0,
            timestamp_ns: 0,
            encoding: Encoding::Cdr,
            in_reply_to: None,
            origin: bytes::Bytes::new(),
            latched: None,
            service: None,
            body,
        }
    }
}
