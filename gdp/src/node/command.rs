//! Messages from a node's handles and tasks to its receiving thread and its supervisor.

use std::sync::{Arc, mpsc};
use std::time::Instant;

use gdp_wire::Name;

use super::attachment::Attachment;
use super::links::Links;
use super::statement::Stated;
use super::subscription_receiver::{Change, SubscriptionReceiver};
use gdp_core::cert::{Revocation, Signed};
use gdp_core::name::NameProof;

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
    sender: mpsc::Sender<Command>,
    links: Arc<Links>,
}

impl Commands {
    /// `links`: the thread waits for frames on one of these links.
    pub fn new(sender: mpsc::Sender<Command>, links: Arc<Links>) -> Self {
        Self { sender, links }
    }

    pub fn send(&self, command: Command) {
        // The thread ends only when this node closes.
        let _ = self.sender.send(command);
        if let Ok(attachment) = self.links.sending_on() {
            attachment.data.wake();
        }
    }
}
