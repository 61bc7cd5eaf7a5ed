//! What switches report: their neighbours, from which paths follow, and who is attached to them. A switch that nobody
//! reaches any more is forgotten after a while, with all that came through it.

use std::collections::BTreeSet;

use gdp::cert::CertError;
use gdp::control::{Refusal, RefusalCode};
use gdp::name::NameProof;
use gdp_wire::Name;
use gdp_wire::table::MAX_LINKS;

use super::telling::Stake;
use super::{HOLD, Now, Rib, Timer, limit_reached, refusal};

impl Rib {
    pub(super) fn try_report(
        &mut self,
        now: Now,
        proof: &NameProof,
        neighbours: &[(Name, u32)],
        attached: Option<&[Name]>,
        own_bit: Option<u8>,
    ) -> Result<(), Refusal> {
        let switch = proof.name().map_err(|error| refusal(CertError::Crypto(error)))?;
        let most = MAX_LINKS as usize;
        if neighbours.len() > most || attached.is_some_and(|list| list.len() > most) {
            return Err(limit_reached(format!("a switch has at most {most} links")));
        }
        self.topology
            .report(switch, neighbours.iter().copied(), own_bit)
            .map_err(|full| Refusal::new(RefusalCode::Limit, full.to_string()))?;
        let known = self.switches.contains_key(&switch);
        self.switches.entry(switch).or_default();
        match attached {
            Some(attached) => self.reconcile(&switch, attached),
            None if !known => drop(self.detached.insert((switch, switch))),
            None => {}
        }
        self.recompute(now);
        Ok(())
    }

    /// Compares the entities that are attached to a switch with those the RIB knows of, and sends it the whole FIB.
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
        self.telling.reconnected(switch);
    }

    fn recompute(&mut self, now: Now) {
        for switch in self.topology.recompute() {
            if let Some(state) = self.switches.get_mut(&switch) {
                state.fib.touch_masks();
            }
        }
        for (name, state) in &mut self.switches {
            let reached = *name == self.root || self.topology.connected(&self.root, name);
            match (reached, state.hold) {
                (true, Some(at)) => {
                    self.timers.remove(&(at, Timer::Switch { switch: *name }));
                    state.hold = None;
                }
                (false, None) => {
                    let at = now.clock + HOLD;
                    self.timers.insert((at, Timer::Switch { switch: *name }));
                    state.hold = Some(at);
                }
                _ => {}
            }
        }
    }

    pub(super) fn forget_switch(&mut self, now: Now, switch: &Name) {
        let Some(state) = self.switches.get(switch) else { return };
        for entity in state.attached.clone() {
            self.end_attachments_at(&entity, switch);
        }
        for (name, entity, role) in self.names.registered_at(switch) {
            self.unregister(Stake { name, entity, role }, *switch);
        }
        self.switches.remove(switch);
        self.topology.forget(switch);
        self.recompute(now);
    }
}
