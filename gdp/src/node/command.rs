//! What handles and tasks of a node tell its receiving thread and its supervisor.

use std::sync::{Arc, mpsc};
use std::time::Instant;

use gdp_wire::Name;

use super::attachment::Attachment;
use super::links::Links;
use super::statement::Stated;
use super::subscription_receiver::{Change, SubscriptionReceiver};
use gdp_core::cert::{Revocation, Signed};
use gdp_core::name::NameProof;

/// What the supervisor is to bring to the RIB.
pub enum RibUpdate {
    /// A publisher or subscription was dropped.
    Withdraw { name: Name, stated: Stated },
    /// The RIB does not know this revocation.
    Revoke { proof: NameProof, revocation: Signed<Revocation> },
}

/// What the rest of the node tells the receiving thread.
pub enum Command {
    /// Frames now come on this link, which is new.
    Attach {
        attachment: Arc<Attachment>,
        /// A link that this one replaces, and until when the switch may still send on it.
        stale: Option<(Arc<Attachment>, Instant)>,
    },
    Subscribe {
        name: Name,
        receiver: Box<SubscriptionReceiver>,
    },
    Unsubscribe {
        name: Name,
    },
    /// What the reader of the name is to believe.
    Change {
        name: Name,
        changes: Vec<Change>,
    },
    /// The application has made room.
    Resume {
        name: Name,
    },
    /// The node is closed: end, and with it all subscriptions.
    Stop,
}

/// The way to the receiving thread. Clones lead to the same.
#[derive(Clone)]
pub struct Commands {
    sender: mpsc::Sender<Command>,
    links: Arc<Links>,
}

impl Commands {
    /// `links`: the thread waits for frames on one of these.
    pub fn new(sender: mpsc::Sender<Command>, links: Arc<Links>) -> Self {
        Self { sender, links }
    }

    pub fn send(&self, command: Command) {
        // The thread ends only once this node is closed.
        let _ = self.sender.send(command);
        if let Ok(attachment) = self.links.sending_on() {
            attachment.data.wake();
        }
    }
}
