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

/// To take everything back when the node leaves.
const LEAVE: Duration = Duration::from_secs(5);

pub struct Registrar {
    shared: Arc<Shared>,
    /// The graph, as it was last looked at, with the types of topics.
    state: SystemState,
    kinds: BTreeMap<String, String>,
    /// Whether the master has taken anything that is not taken back.
    is_known: bool,
}

impl Registrar {
    pub fn new(shared: Arc<Shared>) -> Self {
        Self { shared, state: SystemState::default(), kinds: BTreeMap::new(), is_known: false }
    }

    /// Until the node leaves and everything is taken back, as far as the master can be reached.
    pub async fn run(mut self) {
        let mut leaving = self.shared.leaving.subscribe();
        tokio::select! {
            () = self.keep() => {}
            // A call that is cut off here may have been carried out: it is taken back with the
            // others.
            _ = leaving.wait_for(|leaving| *leaving) => {}
        }
        self.shared.registrations().leave_all();
        // What cannot be taken back in time stays with a master that does not answer.
        _ = timeout(LEAVE, self.work_off()).await;
    }

    /// Does not end.
    async fn keep(&mut self) {
        let (mut master, mut next_look) = (MasterState::Unknown, Instant::now());
        loop {
            if Instant::now() >= next_look {
                next_look = Instant::now() + self.shared.config.poll;
                master = self.look().await;
            }
            // While it cannot be reached, the next look is soon enough.
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

    /// Whether the master still knows this node as it should; what it has forgotten is wanted
    /// again.
    async fn look(&mut self) -> MasterState {
        self.try_to_look().await.unwrap_or_else(|error| MasterState::Unreachable(error.to_string()))
    }

    async fn try_to_look(&mut self) -> Result<MasterState, MasterError> {
        let Shared { master, config, uri, .. } = &*self.shared;
        let state = master.system_state().await?;
        // After the state: if the name is this node's now, the state does not lack it because
        // another has taken it. Who has nothing registered yet takes the name itself, perhaps from
        // its own run before.
        if self.is_known {
            match master.lookup_node(&config.name).await {
                Ok(other) if other != *uri => return Ok(MasterState::NameTaken(other)),
                // Unknown: all is forgotten, as the state will show.
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

    /// Has the graph shown to those who watch it.
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

    /// Tells the master what it has to know. Ends early if it cannot be reached.
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
