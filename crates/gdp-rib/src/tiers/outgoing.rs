//! Messages to neighbours and their outcome: hellos to parents, pushes, and queries that climb.

use std::time::Duration;

use gdp_proto::control::{MAX_ANCESTORS, TierEntry, TierHolds, TierPush, TierRequest, TierResponse};
use gdp_wire::Name;

use super::incoming::may_hear;
use super::queries::{Climbing, TIMEOUT};
use super::side::{HELLO, HELLO_AGAIN, RESTART_TIME, SessionState};
use super::table::{Item, RecordTable};
use super::verification::{Judged, Revoked, Verification};
use super::{Effect, Sent, Tiers};
use crate::feed::Room;
use crate::rib::Now;
use crate::tiers::ticket::Ticket;

/// Capacity of one push. A message has at most 64 KiB, and the rest is for the envelope. A single
/// entry always fits.
const ROOM: Room = Room { entries: 512, bytes: 48 * 1024 };

/// Encoded size in bytes of a removed key.
const KEY_SIZE: usize = 160;

impl Tiers {
    /// Returns the messages to send now.
    pub fn effects(&mut self, now: Now) -> Vec<Effect> {
        self.tick(now);
        self.spread();
        let mut effects = Vec::new();
        for (domain, side) in self.sides.iter_mut().filter(|(domain, _)| self.adjacent.contains(*domain)) {
            if side.is_asked {
                continue;
            }
            let (to, home) = (*domain, self.home);
            if side.kind.is_parent() && side.hello_at <= now.clock {
                (side.is_asked, side.hello_at) = (true, now.clock + HELLO);
                let request = TierRequest::Hello { run: side.run, holds: side.table.holds() };
                effects.push(Effect::Ask { to, sent: Sent::Hello { run: side.run }, request });
            } else if side.is_followed()
                && let Some(parcel) = side.sent.feed.next(now.clock, ROOM, |item| item.map_or(KEY_SIZE, Item::size))
            {
                side.is_asked = true;
                let (run, generation, extent) = (side.run, parcel.generation, parcel.extent);
                let set = parcel.set.iter().map(|item| item.to_entry(now.clock, home)).collect();
                let push = TierPush { run, generation, extent, set, remove: parcel.remove };
                let (sent, request) = (Sent::Push(TierHolds { run, generation }), TierRequest::Push(Box::new(push)));
                effects.push(Effect::Ask { to, sent, request });
            }
        }
        let idle: Vec<Ticket> = self.queries.climbing.iter().filter(|(_, c)| c.at.is_none()).map(|(t, _)| *t).collect();
        effects.extend(idle.into_iter().filter_map(|ticket| self.ask_next(now, ticket)));
        let answers = std::mem::take(&mut self.answers);
        effects.extend(answers.into_iter().map(|(ticket, response)| Effect::Answer { ticket, response }));
        effects
    }

    /// Sends a query to the next parent. Without a further parent, the query is answered with no
    /// entries.
    fn ask_next(&mut self, now: Now, ticket: Ticket) -> Option<Effect> {
        let climbing = self.queries.climbing.get_mut(&ticket)?;
        let Some(to) = climbing.left.pop() else {
            let Climbing { name, path, .. } = self.queries.climbing.remove(&ticket)?;
            let asker = path.first().copied().unwrap_or(self.home);
            self.queries.miss(now.clock, name, asker);
            self.answers.push((ticket, TierResponse::Answer { entries: Vec::new(), truncated: false }));
            return None;
        };
        (climbing.at, climbing.until) = (Some(to), now.clock + TIMEOUT);
        let request = TierRequest::Query { name: climbing.name, path: climbing.path.clone() };
        Some(Effect::Ask { to, sent: Sent::Query(ticket), request })
    }

    /// Records the answer to a message, or `None` if it was lost.
    pub fn answered(&mut self, now: Now, to: Name, sent: Sent, response: Option<TierResponse>, revoked: &impl Revoked) {
        self.tick(now);
        let run = match sent {
            Sent::Query(ticket) => return self.query_answered(now, to, ticket, response, revoked),
            Sent::Hello { run } | Sent::Push(TierHolds { run, .. }) => run,
        };
        let Some(side) = self.sides.get_mut(&to).filter(|side| side.run == run) else { return };
        side.is_asked = false;
        match (sent, response) {
            (Sent::Hello { .. }, Some(TierResponse::Hello { run, holds, ancestors })) => {
                side.hello(now.clock, run, holds);
                side.lacking.take_if(|_| !side.sent.feed.lacks());
                self.check_parent(now, to, ancestors);
            }
            (Sent::Hello { .. }, Some(TierResponse::Refused(refusal))) => {
                side.lacking = Some(refusal.reason);
                side.lose(now.clock);
            }
            (Sent::Hello { .. }, _) => {
                side.hello_at = now.clock + HELLO_AGAIN;
                side.lose(now.clock);
            }
            (Sent::Push(TierHolds { generation, .. }), response) => {
                if let Some(TierResponse::Partly { reason, .. }) = response {
                    side.sent.feed.answered_partly(now.clock, generation);
                    side.lacking = Some(reason);
                    return;
                }
                let done = matches!(response, Some(TierResponse::Done));
                side.sent.feed.answered(now.clock, generation, done);
                match response {
                    Some(TierResponse::Done) if !side.sent.feed.lacks() => side.lacking = None,
                    Some(TierResponse::Refused(refusal)) => side.lacking = Some(refusal.reason),
                    _ => {}
                }
            }
            (Sent::Query(_), _) => {}
        }
    }

    /// Refuses a parent that has this domain as an ancestor.
    fn check_parent(&mut self, now: Now, parent: Name, ancestors: Vec<Name>) {
        let Some(side) = self.sides.get_mut(&parent) else { return };
        side.ancestors = ancestors.into_iter().take(MAX_ANCESTORS).collect();
        let is_below = side.ancestors.contains(&self.home);
        match &side.session {
            SessionState::Refused { until, .. } if !is_below && *until <= now.clock => side.session = SessionState::Up,
            SessionState::Refused { .. } => return,
            _ if is_below => {
                side.cycles += 1;
                side.count("cycle");
                // All domains of a cycle may detect it at once. The random delay keeps them from
                // retrying at once.
                let until = now.clock + RESTART_TIME + spread_out(self.home, side.cycles);
                let reason = format!(
                    "a cycle: domain {:#} is above domain {parent:#}, which can be no parent of it: take `parent: \
                     true` away \
                     from one of them",
                    self.home
                );
                side.session = SessionState::Refused { until, reason };
                self.clear(parent);
            }
            _ => return,
        }
        self.all_changed();
    }

    fn query_answered(
        &mut self,
        now: Now,
        from: Name,
        ticket: Ticket,
        response: Option<TierResponse>,
        revoked: &impl Revoked,
    ) {
        let Some(climbing) = self.queries.climbing.get_mut(&ticket).filter(|climbing| climbing.at == Some(from)) else {
            return;
        };
        climbing.at = None;
        let Some(TierResponse::Answer { entries, truncated }) = response else { return };
        let asker = climbing.path.first().copied().unwrap_or(self.home);
        let (name, home) = (climbing.name, self.home);
        let judge = Verification { home, now, revoked };
        let (mut told, nothing) = (Vec::new(), RecordTable::default());
        for entry in entries {
            match judge.entry(from, &nothing, entry) {
                Ok(Judged { item: Item::Part { record: held, .. }, .. })
                    if held.key.name == name && may_hear(&held, asker, home) =>
                {
                    told.push(TierEntry::Part(Box::new(held.to_remote(now.clock, home))));
                }
                Ok(_) => self.count(from, "not_asked"),
                Err(refusal) => self.count(from, refusal.as_str()),
            }
        }
        if !told.is_empty() {
            self.queries.climbing.remove(&ticket);
            self.answers.push((ticket, TierResponse::Answer { entries: told, truncated }));
        }
    }
}

/// Returns a delay of up to 60 s that differs for each domain and attempt.
fn spread_out(domain: Name, attempt: u64) -> Duration {
    let mixed = (domain.words()[0] ^ attempt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    Duration::from_millis((mixed >> 32) % 60_000)
}
