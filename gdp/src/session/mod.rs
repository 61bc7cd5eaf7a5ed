//! A session: an attached entity that finds names and rights in its keyring.
//!
//! The session owns the node, and a task that presents renewed credentials. Handles keep the node
//! attached. Nothing in here knows links, frames or statements: that is the node's.

mod attached;
mod client;
mod config;
mod error;
mod followed_keyring;
mod publisher;
mod publisher_handle;
mod sample;
mod server;
mod subscriber;

use std::fmt;
use std::sync::{Arc, Weak};
use std::time::Duration;

use gdp_core::card::NameCard;
use gdp_util::file_watch::{FileSet, FileWatcher};
use gdp_wire::Name;
use parking_lot::Mutex;

use self::attached::Attached;
use crate::node::Node;

pub use self::client::{Client, ClientBuilder};
pub use self::config::Config;
pub use self::error::Error;
pub use self::publisher::{Publisher, PublisherBuilder};
pub use self::sample::Sample;
pub use self::server::{IncomingCall, Server, ServerBuilder};
pub use self::subscriber::{Subscriber, SubscriberBuilder};

/// How long [`Session::close`] waits for readers.
const FLUSH: Duration = Duration::from_secs(5);

/// Opens a session: reads the keyring, and attaches to the switch. Call it within a tokio runtime.
///
/// # Errors
///
/// Fails if a file is missing or wrong, or if no switch answers in time.
pub async fn open(config: Config) -> Result<Session, Error> {
    let (mut keyring, config) = config.load()?;
    // Before the node reads the files for the last time, so that no change is missed.
    let watched = keyring.current().credentials.clone().map(|files| {
        let watched = FileSet::new(&FileWatcher::start(), files.paths());
        (files, watched)
    });
    let node = Node::connect(config).await?;
    let following = watched.map(|(files, watched)| {
        let node = node.clone();
        tokio::spawn(async move { node.follow_credentials(&files, watched).await }).abort_handle()
    });
    let (keyring, publishers) = (Mutex::new(keyring), Mutex::new(Vec::new()));
    Ok(Session(Arc::new(Attached { node, keyring, publishers, following })))
}

/// An entity that is attached to a switch. Clones are the same session. It detaches when the last
/// clone and the last of its handles are dropped, or with [`Self::close`].
#[derive(Clone)]
pub struct Session(Arc<Attached>);

impl Session {
    /// Publishes a topic. `topic` is a ROS name of the keyring's cards, a card's file, a name of 64
    /// hex digits, or its first digits. Await the builder.
    pub fn publisher(&self, topic: impl Into<String>) -> PublisherBuilder {
        PublisherBuilder::new(self.0.clone(), topic.into())
    }

    /// Reads a topic: one of the keyring as for [`Self::publisher`], or `/LABEL/TOPIC` of another
    /// member of the domain. Await the builder.
    pub fn subscriber(&self, topic: impl Into<String>) -> SubscriberBuilder {
        SubscriberBuilder::new(self.0.clone(), topic.into())
    }

    /// Calls a service, named as a topic is for [`Self::subscriber`]. Await the builder.
    pub fn client(&self, service: impl Into<String>) -> ClientBuilder {
        ClientBuilder::new(self.0.clone(), service.into())
    }

    /// Serves calls, as one of the servers of a service. Named as a topic is for
    /// [`Self::publisher`]. Await the builder.
    pub fn server(&self, service: impl Into<String>) -> ServerBuilder {
        ServerBuilder::new(self.0.clone(), service.into())
    }

    /// Returns this entity's name, for which owners issue certificates.
    pub fn name(&self) -> Name {
        self.0.node.name()
    }

    /// Returns the switch at the other end of the link.
    ///
    /// # Errors
    ///
    /// Returns the reason why there is no link now. The session goes on to try.
    pub fn switch(&self) -> Result<Name, Error> {
        Ok(self.0.node.switch()?)
    }

    /// Finds a name's card, for an owner's [`SigningKey::allow_publish`] or to show its metadata.
    /// `kind` is `topic` or `service`.
    ///
    /// [`SigningKey::allow_publish`]: crate::SigningKey::allow_publish
    ///
    /// # Errors
    ///
    /// Fails if neither the keyring nor the directory of the domain has it.
    pub async fn find(&self, name: &str, kind: &str) -> Result<NameCard, Error> {
        self.0.find(name, kind).await
    }

    /// Waits until the readers of every reliable publisher have acknowledged all messages, for at
    /// most 5 s. Then detaches, which withdraws all names. Handles fail from then on.
    ///
    /// A publisher that the program dropped earlier is withdrawn already, and nothing waits for its
    /// readers: [`Publisher::flush`] it before you drop it.
    ///
    /// # Errors
    ///
    /// Says which messages did not arrive. The session is closed nevertheless.
    pub async fn close(&self) -> Result<(), Error> {
        let publishers: Vec<_> = self.0.publishers.lock().iter().filter_map(Weak::upgrade).collect();
        let flushed = futures::future::join_all(publishers.iter().map(|publisher| publisher.flush(FLUSH))).await;
        self.0.node.close().await;
        flushed.into_iter().collect()
    }

    /// Returns the low-level node.
    #[doc(hidden)]
    pub fn node(&self) -> &Node {
        &self.0.node
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
