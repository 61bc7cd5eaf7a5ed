//! What is to be told to each of those who sent goals, until they have it.

use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use bytes::Bytes;
use gdp::Name;

use super::LINGER;
use crate::call::{Event, Events, MAX_EVENTS};

/// Those who are told.
const MAX_CALLERS: usize = 256;

/// Feedback that waits for one of them, and bytes of it; beyond, the oldest goes.
const MAX_WAITING: usize = 256;
const MAX_WAITING_BYTES: usize = 4 << 20;

/// Bytes in one reply, if it has more than one event.
const MAX_REPLY: usize = 1 << 20;

/// Of an action that is served.
#[derive(Default)]
pub struct Log {
    callers: HashMap<Name, Caller>,
}

struct Caller {
    /// Of the event that comes next; the first is 1.
    next: u64,
    feedback: VecDeque<(u64, Bytes)>,
    bytes: usize,
    dropped: u64,
    /// The newest; what was before is of no interest.
    status: Option<(u64, Bytes)>,
    heard: Instant,
}

/// Nobody else can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{MAX_CALLERS} callers are told of their goals already; call again later")]
pub struct LogError;

impl Log {
    /// It calls, and is told from now on.
    pub fn heard(&mut self, now: Instant, caller: Name) -> Result<(), LogError> {
        if let Some(known) = self.callers.get_mut(&caller) {
            known.heard = now;
            return Ok(());
        }
        if self.callers.len() >= MAX_CALLERS {
            return Err(LogError);
        }
        let (feedback, status) = (VecDeque::new(), None);
        let new = Caller { next: 1, feedback, bytes: 0, dropped: 0, status, heard: now };
        self.callers.insert(caller, new);
        Ok(())
    }

    /// Returns how many it is not told for this.
    pub fn feedback(&mut self, caller: &Name, message: Bytes) -> u64 {
        let Some(caller) = self.callers.get_mut(caller) else { return 1 };
        caller.bytes += message.len();
        caller.feedback.push_back((caller.next, message));
        caller.next += 1;
        let before = caller.dropped;
        while caller.feedback.len() > MAX_WAITING || (caller.bytes > MAX_WAITING_BYTES && caller.feedback.len() > 1) {
            caller.drop_first();
            caller.dropped += 1;
        }
        caller.dropped - before
    }

    /// Of its goals, if that is another than before.
    pub fn status(&mut self, caller: &Name, message: Bytes) {
        let Some(caller) = self.callers.get_mut(caller) else { return };
        if caller.status.as_ref().is_none_or(|(_, before)| *before != message) {
            caller.status = Some((caller.next, message));
            caller.next += 1;
        }
    }

    /// What it has not been told after the event of this number; `None` if there is nothing. What was before, it has.
    pub fn after(&mut self, caller: &Name, after: u64) -> Option<Events> {
        let caller = self.callers.get_mut(caller)?;
        while caller.feedback.front().is_some_and(|(number, _)| *number <= after) {
            caller.drop_first();
        }
        let status = caller.status.iter().filter(|(number, _)| *number > after);
        let mut waiting: Vec<(u64, Event)> =
            status.map(|(number, message)| (*number, Event::Status(message.clone()))).collect();
        waiting.extend(caller.feedback.iter().map(|(number, message)| (*number, Event::Feedback(message.clone()))));
        waiting.sort_by_key(|(number, _)| *number);
        let mut events = Events { last: after, dropped: 0, events: Vec::new() };
        let mut size = 0;
        for (number, event) in waiting.into_iter().take(MAX_EVENTS) {
            let (Event::Feedback(message) | Event::Status(message)) = &event;
            size += message.len();
            if size > MAX_REPLY && !events.events.is_empty() {
                break;
            }
            events.last = number;
            events.events.push(event);
        }
        if events.events.is_empty() {
            return None;
        }
        events.dropped = std::mem::take(&mut caller.dropped);
        Some(events)
    }

    /// Forgets those who were not heard of for long; `stays`: whose goals go on.
    pub fn sweep(&mut self, now: Instant, stays: impl Fn(&Name) -> bool) {
        self.callers.retain(|caller, known| now.saturating_duration_since(known.heard) < LINGER || stays(caller));
    }

    pub fn callers(&self) -> impl Iterator<Item = &Name> {
        self.callers.keys()
    }
}

impl Caller {
    fn drop_first(&mut self) {
        self.bytes -= self.feedback.pop_front().map_or(0, |(_, message)| message.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(number: u64) -> Name {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&number.to_be_bytes());
        Name::from_bytes(bytes)
    }

    fn of(callers: &[u64]) -> Log {
        let mut log = Log::default();
        callers.iter().for_each(|caller| log.heard(Instant::now(), name(*caller)).unwrap());
        log
    }

    fn feedback(number: u64) -> Bytes {
        number.to_be_bytes().to_vec().into()
    }

    #[test]
    fn each_is_told_what_it_has_not_heard_and_nothing_of_others() {
        let mut log = of(&[1, 2]);
        assert_eq!(log.after(&name(1), 0), None);
        log.feedback(&name(1), feedback(1));
        log.status(&name(1), Bytes::from_static(b"running"));
        log.feedback(&name(1), feedback(2));
        let told = log.after(&name(1), 0).unwrap();
        let status = Event::Status(Bytes::from_static(b"running"));
        let expected = [Event::Feedback(feedback(1)), status, Event::Feedback(feedback(2))];
        assert_eq!((told.last, told.dropped, &told.events[..]), (3, 0, &expected[..]));
        assert_eq!(log.after(&name(1), 0), Some(told), "a reply may have been lost");
        assert_eq!(log.after(&name(1), 2).unwrap().events, expected[2..]);
        assert_eq!((log.after(&name(1), 3), log.after(&name(2), 0)), (None, None));
        log.status(&name(1), Bytes::from_static(b"running"));
        assert_eq!(log.after(&name(1), 3), None, "that is known");
    }

    #[test]
    fn only_the_newest_status_is_told() {
        let mut log = of(&[1]);
        log.status(&name(1), Bytes::from_static(b"running"));
        log.status(&name(1), Bytes::from_static(b"done"));
        let told = log.after(&name(1), 0).unwrap();
        assert_eq!((told.last, told.events), (2, vec![Event::Status(Bytes::from_static(b"done"))]));
    }

    #[test]
    fn what_waits_is_bounded_and_what_goes_is_counted() {
        let mut log = of(&[1]);
        let dropped: u64 = (0..MAX_WAITING as u64 + 5).map(|number| log.feedback(&name(1), feedback(number))).sum();
        assert_eq!(dropped, 5);
        let told = log.after(&name(1), 0).unwrap();
        assert_eq!((told.dropped, told.events.len()), (5, MAX_WAITING));
        assert_eq!(told.events[0], Event::Feedback(feedback(5)));
        assert_eq!(log.after(&name(1), told.last), None);
        // Bytes are bounded as well, in a reply and before.
        let large = Bytes::from(vec![0; MAX_WAITING_BYTES / 2]);
        let dropped: Vec<u64> = (0..4).map(|_| log.feedback(&name(1), large.clone())).collect();
        assert_eq!(dropped, [0, 0, 1, 1]);
        let told = log.after(&name(1), told.last).unwrap();
        assert_eq!((told.events.len(), told.dropped), (1, 2));
        assert_eq!(log.feedback(&name(9), feedback(1)), 1, "nobody");
    }

    #[test]
    fn callers_are_bounded_and_forgotten() {
        let start = Instant::now();
        let mut log = of(&(0..MAX_CALLERS as u64).collect::<Vec<_>>());
        assert_eq!(log.heard(start, name(9999)), Err(LogError));
        log.sweep(start + 2 * LINGER, |caller| *caller == name(7));
        assert_eq!(log.callers().collect::<Vec<_>>(), [&name(7)]);
        assert_eq!(log.heard(start, name(9999)), Ok(()));
    }
}
