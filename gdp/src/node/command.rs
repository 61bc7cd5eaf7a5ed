//! Messages from a node's handles and tasks to its receiving thread and its supervisor.

use std::sync::{Arc, mpsc};
use std::time::Instant;

use gdp_wire::Name;

use super::attachment::Attachment;
use super::statement::Stated;
use super::subscription_receiver::{Change, SubscriptionReceiver};
use gdp_core::cert::{Revocation, Signed};
use gdp_core::name::NameProof;
use gdp_link::link::LinkError;
use gdp_link::port::WakeEvent;

/// An update of the RIB that the supervisor sends.
pub enum RibUpdate {
    /// A publisher or subscription was dropped.
    Withdraw { name: Name, stated: Stated },
    /// The RIB lacks this revocation.
    Revoke { proof: NameProof, revocation: Signed<Revocation> },
}

/// A command to the receiving thread.
pub enum Command {
    /// Receive frames on this new link.
    Attach {
        attachment: Arc<Attachment>,
        /// The link that this one replaces, and the time until which the switch may still send on
        /// it.
        stale: Option<(Arc<Attachment>, Instant)>,
    },
    Subscribe {
        name: Name,
        receiver: Box<SubscriptionReceiver>,
    },
    Unsubscribe {
        name: Name,
    },
    /// Update the writers and keys of the name's reader.
    Change {
        name: Name,
        changes: Vec<Change>,
    },
    /// The application's queue has space again.
    Resume {
        name: Name,
    },
    /// The node is closed: end the thread and all subscriptions.
    Stop,
}

/// The sending end of the commands to the receiving thread. Clones share it.
#[derive(Clone)]
pub struct Commands {
    // Dropped first, so that the thread finds the queue closed when it wakes.
    sender: mpsc::Sender<Command>,
    wake: WakeOnDrop,
}

#[derive(Clone)]
struct WakeOnDrop(Arc<WakeEvent>);

impl Drop for WakeOnDrop {
    fn drop(&mut self) {
        self.0.set();
    }
}

impl Commands {
    /// Returns the sending end, and the queue and the event of the thread.
    pub fn new() -> Result<(Self, mpsc::Receiver<Command>, Arc<WakeEvent>), LinkError> {
        let (sender, queue) = mpsc::channel();
        let what = || "an event of the receiving thread".to_owned();
        let wake = WakeEvent::new().map_err(|source| LinkError::Io { what: what(), source })?;
        let wake = Arc::new(wake);
        Ok((Self { sender, wake: WakeOnDrop(wake.clone()) }, queue, wake))
    }

    pub fn send(&self, command: Command) {
        // The thread ends only when this node closes.
        let _ = self.sender.send(command);
        self.wake.0.set();
    }
}
