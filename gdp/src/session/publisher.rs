//! Publishers of a session.

use std::fmt;
use std::future::IntoFuture;
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use gdp_core::card::NameCard;
use gdp_e2e::seal::{Draft, Encoding};
use gdp_wire::Name;

use super::attached::Attached;
use super::error::Error;
use super::publisher_handle::PublisherHandle;
use crate::node;
use crate::node::PublishOptions;

/// Interval of the checks for readers.
const LOOK: Duration = Duration::from_millis(20);

/// A publisher before it is attached: await it. By default it offers the newest message.
#[derive(Clone, Debug)]
#[must_use = "await it"]
pub struct PublisherBuilder {
    session: Arc<Attached>,
    topic: String,
    encoding: Encoding,
    options: PublishOptions,
}

impl PublisherBuilder {
    pub(super) fn new(session: Arc<Attached>, topic: String) -> Self {
        Self { session, topic, encoding: Encoding::Bytes, options: PublishOptions::best_effort() }
    }

    /// Offers every message, in order. Readers may request the last 1024 again.
    pub fn reliable(mut self) -> Self {
        let PublishOptions { reliability, history, .. } = PublishOptions::reliable();
        self.options = PublishOptions { reliability, history, ..self.options };
        self
    }

    /// Sets how many messages readers may request again.
    pub fn history(mut self, messages: usize) -> Self {
        self.options.history = messages;
        self
    }

    /// Sends the last messages, so many, to readers that join later.
    pub fn latched(mut self, messages: usize) -> Self {
        self.options.latched = messages;
        self
    }

    /// Sets the traffic class, 0 to 7. Higher classes are sent first. Default: 3.
    pub fn class(mut self, class: u8) -> Self {
        self.options.class = class.min(7);
        self
    }

    /// Sets the encoding that every message states. Default: [`Encoding::Bytes`].
    pub fn encoding(mut self, encoding: Encoding) -> Self {
        self.encoding = encoding;
        self
    }

    /// Replaces the options.
    #[doc(hidden)]
    pub fn options(mut self, options: PublishOptions) -> Self {
        self.options = options;
        self
    }

    async fn attach(self) -> Result<Publisher, Error> {
        let Self { session, topic, encoding, options } = self;
        let card = session.find(&topic, "topic").await?;
        let ad = session.ad(&card)?;
        let node = session.node.publish(card.proof(), ad, options).await?;
        let shared = Arc::new(PublisherHandle { node, card, topic });
        session.remember(&shared);
        Ok(Publisher { shared, session, encoding })
    }
}

impl IntoFuture for PublisherBuilder {
    type Output = Result<Publisher, Error>;
    type IntoFuture = BoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.attach())
    }
}

/// Publishes a topic. Clones are the same publisher, for other tasks and threads. Dropping the last
/// one withdraws it: unsent messages are lost, see [`Self::flush`].
#[derive(Clone)]
pub struct Publisher {
    shared: Arc<PublisherHandle>,
    /// Presents renewed credentials, as long as a handle exists.
    session: Arc<Attached>,
    encoding: Encoding,
}

impl Publisher {
    /// Seals and sends a message, and returns its sequence number. `Ok` means that the message is
    /// sent or queued. Waits only if the publisher is reliable and its history is full.
    ///
    /// # Errors
    ///
    /// Fails if the right to publish has ended. Without a link to the switch, a reliable message is
    /// stored, and another one fails.
    pub async fn put(&self, payload: impl AsRef<[u8]>) -> Result<u64, Error> {
        Ok(self.shared.node.send_shared(&[Draft::new(self.encoding, payload.as_ref())]).await?)
    }

    /// Waits until all messages have left this host, and every reader of a reliable publisher has
    /// acknowledged them.
    ///
    /// # Errors
    ///
    /// Says after `timeout` what is missing.
    pub async fn flush(&self, timeout: Duration) -> Result<(), Error> {
        self.shared.flush(timeout).await
    }

    /// Goes on to publish with the certificate that the keyring has now, and readers miss nothing.
    /// Call it before the one in use ends.
    ///
    /// # Errors
    ///
    /// Fails if there is no valid one, or if the fabric refuses it. The one in use stays in force.
    pub async fn renew(&self) -> Result<(), Error> {
        let ad = self.session.ad(&self.shared.card)?;
        Ok(self.shared.node.renew_shared(ad).await?)
    }

    /// Returns the number of attached readers. Messages without readers are sent to nobody.
    pub fn readers(&self) -> usize {
        self.shared.node.readers()
    }

    /// Waits until so many readers are attached.
    ///
    /// # Errors
    ///
    /// Fails if the right to publish ends.
    pub async fn wait_for_readers(&self, readers: usize) -> Result<(), Error> {
        let mut look = tokio::time::interval(LOOK);
        let mut ended = std::pin::pin!(self.shared.node.ended());
        while self.readers() < readers {
            tokio::select! {
                _ = look.tick() => {}
                why = &mut ended => return Err(why.into()),
            }
        }
        Ok(())
    }

    /// Returns the name that is published.
    pub fn name(&self) -> Name {
        self.shared.node.name()
    }

    /// Returns the topic as the program named it.
    pub fn topic(&self) -> &str {
        &self.shared.topic
    }

    /// Returns the name's card, which states for example the type of a ROS topic.
    pub fn card(&self) -> &NameCard {
        &self.shared.card
    }

    /// Returns the handle of the low-level node.
    #[doc(hidden)]
    pub fn node(&self) -> &node::Publisher {
        &self.shared.node
    }
}

impl fmt::Debug for Publisher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Publisher").field("topic", &self.topic()).field("name", &self.name()).finish_non_exhaustive()
    }
}
