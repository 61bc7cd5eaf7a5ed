//! A service that this node calls or serves, and the calls that wait for replies.

use std::collections::HashMap;
use std::sync::Arc;

use gdp_wire::Name;
use tokio::sync::oneshot;

use super::ending::{Ended, Ending};
use super::request_queue::Tray;
use super::service_instances::ServiceInstances;
use gdp_e2e::seal::Message;
use gdp_proto::control::NameRole;

/// Services by name and by this node's role.
pub type Services = HashMap<(Name, NameRole), Service>;

/// A service that this node calls or serves.
pub struct Service {
    pub instances: ServiceInstances,
    pub ending: Arc<Ending>,
    /// The request queue of a service that this node may serve.
    pub tray: Option<Tray>,
}

impl Service {
    /// Ends calls and requests of this service.
    pub fn end(&mut self, why: Ended) {
        self.ending.end(why);
        self.tray = None;
    }
}

/// A call that waits for its reply.
pub struct PendingReply {
    /// The server that may reply.
    pub instance: Name,
    pub reply: oneshot::Sender<Message>,
}
