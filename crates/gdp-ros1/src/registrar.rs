//! Keeps the registrations of a node at its master in force. It registers and unregisters, checks
//! regularly whether the master still knows the node, and reads the master's graph in the same
//! round.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout};

use crate::api::master::{MasterError, SystemState};
use crate::graph::Snapshot;
use crate::registration::RegistrationStep;
use crate::shared::{MasterState, Shared};

/// Timeout for unregistering everything when the node leaves.
const LEAVE: Duration = Duration::from_secs(5);

pub struct Registrar {
    shared: Arc<Shared>,
    /// The last system state of the master, and the types of its topics.
    state: SystemState,
    kinds: BTreeMap<String, String>,
    /// Whether the master has accepted any registration that is not unregistered.
    is_known: bool,
}

impl Registrar {
    pub fn new(shared: Arc<Shared>) -> Self {
        Self { shared, state: SystemState::default(), kinds: BTreeMap::new(), is_known: false }
    }

    /// Runs until the node leaves and has unregistered everything, as far as it can reach the
    /// master.
    pub async fn run(mut self) {
        let mut leaving = self.shared.leaving.subscribe();
        tokio::select! {
            () = self.keep() => {}
            // The master may have executed a call that is cancelled here. So `leave_all` includes
            // it.
            _ = leaving.wait_for(|leaving| *leaving) => {}
        }
        self.shared.registrations().leave_all();
        // A registration that the timeout leaves over stays at a master that does not respond.
        _ = timeout(LEAVE, self.work_off()).await;
    }

    /// Keeps the registrations in force. Never returns.
    async fn keep(&mut self) {
        let (mut master, mut next_look) = (MasterState::Unknown, Instant::now());
        loop {
            if Instant::now() >= next_look {
                next_look = Instant::now() + self.shared.config.poll;
                master = self.look().await;
            }
            // If the master is unreachable, the next poll is soon enough.
            if master == MasterState::Reached {
                master = self.work_off().await;
            }
            self.shared.set_master(master.clone());
            tokio::select! {
                () = self.shared.wake.notified() => {}
                () = sleep_until(next_look) => {}
            }
        }
    }

    /// Polls the master, and makes the registrations that it lost wanted again.
    async fn look(&mut self) -> MasterState {
        self.try_to_look().await.unwrap_or_else(|error| MasterState::Unreachable(error.to_string()))
    }

    async fn try_to_look(&mut self) -> Result<MasterState, MasterError> {
        let Shared { master, config, uri, .. } = &*self.shared;
        let state = master.system_state().await?;
        // This call follows `system_state`. If the name is this node's now, then no other node's
        // registration has changed the state. A node without registrations takes the name itself,
        // perhaps from its own earlier run.
        if self.is_known {
            match master.lookup_node(&config.name).await {
                Ok(other) if other != *uri => return Ok(MasterState::NameTaken(other)),
                // The master does not know the node. Then it lost everything, which the state
                // shows.
                Ok(_) | Err(MasterError::Refused { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        let forgotten = self.shared.registrations().observe(&config.name, &state);
        if forgotten > 0 {
            tracing::warn!(forgotten, uri = master.uri, "the master has forgotten this node, and is told again");
        }
        if self.shared.graph.receiver_count() > 0 {
            self.show(state).await?;
        }
        Ok(MasterState::Reached)
    }

    /// Sends the graph to its watchers.
    async fn show(&mut self, state: SystemState) -> Result<(), MasterError> {
        let has_all_kinds = {
            let graph = self.shared.graph.borrow();
            graph.topics.values().all(|topic| topic.kind.is_some())
        };
        if state != self.state || !has_all_kinds {
            self.kinds = self.shared.master.topic_types().await?.into_iter().collect();
            self.state = state;
        }
        let snapshot = Arc::new(Snapshot::new(&self.state, &self.kinds, &self.shared.connected()));
        self.shared.graph.send_if_modified(|shown| {
            let is_new = *shown != snapshot;
            *shown = snapshot;
            is_new
        });
        Ok(())
    }

    /// Makes all pending calls to the master. Stops early if it is unreachable.
    async fn work_off(&mut self) -> MasterState {
        loop {
            let (next, is_empty) = {
                let registrations = self.shared.registrations();
                (registrations.next(), registrations.is_empty())
            };
            self.is_known &= !is_empty;
            let Some(step) = next else { return MasterState::Reached };
            let result = match &step {
                RegistrationStep::Register { key, kind } => self.shared.register_at_master(key, kind).await,
                RegistrationStep::Unregister { key } => self.shared.unregister_at_master(key).await,
            };
            match result {
                Ok(()) => {
                    self.is_known |= matches!(step, RegistrationStep::Register { .. });
                    self.shared.registrations().done(&step);
                }
                Err(MasterError::Refused { text, .. }) => self.shared.registrations().refused(&step, text),
                Err(error) => return MasterState::Unreachable(error.to_string()),
            }
        }
    }
}
