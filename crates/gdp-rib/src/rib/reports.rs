//! State of switches: the entities attached to them, from their reports, and their reachability,
//! from the topology. The RIB forgets a switch that stays unreachable, with all registrations that
//! came through it.

use std::collections::BTreeSet;

use gdp_core::cert::CertError;
use gdp_core::name::NameProof;
use gdp_proto::control::{Refusal, RefusalCode};
use gdp_wire::Name;
use gdp_wire::table::MAX_LINKS;

use super::{RESTART_TIME, Rib, Timer, UNREPORTED};
use crate::rib::model::{At, Now, RegistrationKey, limit_reached, refusal};

impl Rib {
    pub(super) fn try_report(
        &mut self,
        now: Now,
        proof: &NameProof,
        attached: &[Name],
        own_bit: Option<u8>,
    ) -> Result<(), Refusal> {
        let switch = proof.name().map_err(|error| refusal(CertError::Crypto(error)))?;
        let most = MAX_LINKS as usize;
        if attached.len() > most {
            return Err(limit_reached(format!("a switch has at most {most} links")));
        }
        let taken = |bit| self.paths.bits.get(&bit).is_some_and(|of| *of != switch);
        self.bits.give(switch, own_bit, taken).map_err(|full| Refusal::new(RefusalCode::Limit, full.to_string()))?;
        let is_new = !self.switches.contains_key(&switch);
        self.switches.entry(switch).or_default();
        if is_new {
            self.follow_border(switch);
        }
        self.silent.remove(&switch);
        if let Some(at) = self.unreported.remove(&switch) {
            self.timers.remove(&(at, Timer::Unreported { switch }));
        }
        self.reconcile(&switch, attached);
        self.check_reachability(now);
        Ok(())
    }

    /// Compares a switch's reported attachments with those stored, and sends it the full FIB.
    fn reconcile(&mut self, switch: &Name, attached: &[Name]) {
        let attached: BTreeSet<Name> = attached.iter().copied().collect();
        let Some(state) = self.switches.get_mut(switch) else { return };
        state.fib.restart();
        let gone: Vec<Name> = state.attached.difference(&attached).copied().collect();
        let unknown = attached.difference(&state.attached).map(|entity| (*switch, *entity));
        self.detached.extend(unknown);
        for entity in gone {
            self.end_attachments_at(&entity, switch);
        }
        self.peer_updates.reconnected(switch);
    }

    /// Schedules unreachable switches to be forgotten, and reachable ones without a report to be
    /// asked for it.
    pub(super) fn check_reachability(&mut self, now: Now) {
        for (name, state) in &mut self.switches {
            let reached = *name == self.root || self.paths.reaches(name);
            match (reached, state.forget_at) {
                (true, Some(at)) => {
                    self.timers.remove(&(at, Timer::Switch { switch: *name }));
                    state.forget_at = None;
                }
                (false, None) => {
                    let at = now.clock + RESTART_TIME;
                    self.timers.insert((at, Timer::Switch { switch: *name }));
                    state.forget_at = Some(at);
                }
                _ => {}
            }
        }
        let reported = |switch: &Name| self.switches.contains_key(switch) && !self.silent.contains(switch);
        for switch in self.paths.costs.keys().filter(|switch| !reported(switch)) {
            self.unreported.entry(*switch).or_insert_with(|| {
                let at = now.clock + UNREPORTED;
                self.timers.insert((at, Timer::Unreported { switch: *switch }));
                at
            });
        }
    }

    /// Resolves egress bits in conflict after a partition. An unknown switch states a bit that the
    /// RIB assigned to another switch. Switches send frames with that bit to its first owner, so
    /// the other switch gets a new bit.
    pub(super) fn settle_bits(&mut self) {
        let lost = |(switch, bit): &(Name, u8)| {
            let has = self.paths.bits.get(bit);
            has.is_some_and(|has| has != switch && self.bits.of(has).is_none())
        };
        for (switch, _) in self.bits.all().filter(lost).collect::<Vec<_>>() {
            let paths = &self.paths;
            if self.bits.exchange(switch, |bit| paths.bits.contains_key(&bit)).is_err() {
                continue;
            }
            tracing::warn!(switch = %format_args!("{switch:#}"), "its egress bit is in use elsewhere: it gets another");
            let registered = self.names.registered_at(&switch);
            registered.iter().for_each(|(name, ..)| self.follow_up(*name, &[At::Here(switch)]));
            let entities: BTreeSet<Name> = registered.iter().map(|(_, entity, _)| *entity).collect();
            entities.iter().for_each(|entity| self.reroute_inbox(entity));
            self.follow_border(switch);
            if let Some(state) = self.switches.get_mut(&switch) {
                state.fib.restart();
            }
        }
    }

    /// Asks a reachable switch that has not reported for a while to report.
    pub(super) fn ask_to_report(&mut self, now: Now, switch: Name) {
        self.unreported.remove(&switch);
        let is_silent = self.silent.contains(&switch) || !self.switches.contains_key(&switch);
        if self.paths.reaches(&switch) && is_silent {
            self.detached.insert((switch, switch));
            self.check_reachability(now);
        }
    }

    pub(super) fn forget_switch(&mut self, switch: &Name) {
        let Some(state) = self.switches.get(switch) else { return };
        for entity in state.attached.clone() {
            self.end_attachments_at(&entity, switch);
        }
        for (name, entity, role) in self.names.registered_at(switch) {
            self.unregister(RegistrationKey { name, entity, role }, *switch);
        }
        self.switches.remove(switch);
        self.silent.remove(switch);
        self.bits.forget(switch);
        self.follow_border(*switch);
    }
}
