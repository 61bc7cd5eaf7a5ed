//! A service that this node calls or serves, and a call that waits for its reply.

use std::collections::HashMap;
use std::sync::Arc;

use gdp_wire::Name;
use tokio::sync::oneshot;

use super::ending::{Ended, Ending};
use super::request_queue::Tray;
use super::service_instances::ServiceInstances;
use gdp_e2e::seal::Message;
use gdp_proto::control::NameRole;

/// By name, and by what this node is in it.
pub type Services = HashMap<(Name, NameRole), Service>;

/// A service that this node calls or serves.
pub struct Service {
    pub instances: ServiceInstances,
    pub ending: Arc<Ending>,
    /// For what it serves, as long as it may.
    pub tray: Option<Tray>,
}

impl Service {
    /// Nothing is called by this any more, and no more requests are taken.
    pub fn end(&mut self, why: Ended) {
        self.ending.end(why);
        self.tray = None;
    }
}

/// A call that waits for its reply.
pub struct PendingReply {
    /// Who may give it.
    pub instance: Name,
    pub reply: oneshot::Sender<Message>,
}
