//! Subscribers of a session.

use std::fmt;
use std::future::IntoFuture;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use futures::Stream;
use futures::future::BoxFuture;
use gdp_core::card::NameCard;
use gdp_e2e::seal::{Encoding, Message};
use gdp_wire::Name;

use super::attached::Attached;
use super::error::Error;
use super::sample::Sample;
use crate::node::{Ended, SubscribeOptions, Subscription, Wants};

/// Maximum of [`SubscriberBuilder::queue`]. Their bodies have at most 64 MB together anyway.
const MAX_QUEUE: usize = 1 << 20;

/// A subscriber before it is attached: await it. By default it receives every message of reliable
/// publishers, and the newest of others.
#[derive(Clone, Debug)]
#[must_use = "await it"]
pub struct SubscriberBuilder {
    session: Arc<Attached>,
    topic: String,
    options: SubscribeOptions,
}

impl SubscriberBuilder {
    pub(super) fn new(session: Arc<Attached>, topic: String) -> Self {
        Self { session, topic, options: SubscribeOptions::as_offered() }
    }

    /// Receives every message, in order. Publishers that are not reliable are then refused.
    pub fn reliable(mut self) -> Self {
        self.options.wants = Wants::Every;
        self
    }

    /// Receives only the newest message, as soon as it is complete.
    pub fn newest(mut self) -> Self {
        self.options = SubscribeOptions { queue: self.options.queue, ..SubscribeOptions::best_effort() };
        self
    }

    /// Sets how many messages may wait for [`Subscriber::recv`]. Default: 256. Excess messages of
    /// publishers that are not reliable are dropped. At most 1,048,576.
    pub fn queue(mut self, messages: usize) -> Self {
        self.options.queue = messages.clamp(1, MAX_QUEUE);
        self
    }

    /// Attaches at the low-level node, with these options.
    #[doc(hidden)]
    pub async fn subscribe(self) -> Result<(Subscription, NameCard), Error> {
        let Self { session, topic, options } = self;
        let card = session.find(&topic, "topic").await?;
        let grant = session.grant(&card)?;
        Ok((session.node.subscribe(card.proof(), grant, options).await?, card))
    }
}

impl IntoFuture for SubscriberBuilder {
    type Output = Result<Subscriber, Error>;
    type IntoFuture = BoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(async {
            let (topic, session) = (self.topic.as_str().into(), self.session.clone());
            let (node, card) = self.subscribe().await?;
            Ok(Subscriber { session, ended: Some(Box::pin(node.ended())), node, card, topic })
        })
    }
}

/// Reads a topic. Dropping it ends the subscription.
///
/// It is a `Stream` of `Result<Sample, Error>`: an error is the last item, and says that the right
/// to read has ended. The stream ends without one when the session is closed.
pub struct Subscriber {
    node: Subscription,
    /// Presents renewed credentials, as long as a handle exists.
    session: Arc<Attached>,
    /// Until the end was reported.
    ended: Option<BoxFuture<'static, Ended>>,
    card: NameCard,
    topic: Arc<str>,
}

impl Subscriber {
    /// Returns the next message, or `None` after the session is closed. Safe to cancel.
    ///
    /// # Errors
    ///
    /// Fails once, when the right to read has expired or was revoked.
    pub async fn recv(&mut self) -> Result<Option<Sample>, Error> {
        std::future::poll_fn(|context| self.poll_sample(context)).await.transpose()
    }

    /// Goes on to read with the grant that the keyring, or the other member, has now. Call it
    /// before the one in use ends: no message is lost.
    ///
    /// # Errors
    ///
    /// Fails if there is no valid one, or if the fabric refuses it. The one in use stays in force.
    pub async fn renew(&mut self) -> Result<(), Error> {
        let grant = self.session.new_grant(&self.card, &self.topic, "topic").await?;
        Ok(self.node.renew(grant).await?)
    }

    /// Returns the name that is read.
    pub fn name(&self) -> Name {
        self.node.name()
    }

    /// Returns the topic as the program named it.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns the name's card, which states for example the type of a ROS topic.
    pub fn card(&self) -> &NameCard {
        &self.card
    }

    fn poll_sample(&mut self, context: &mut Context<'_>) -> Poll<Option<Result<Sample, Error>>> {
        while let Some(message) = ready!(self.node.poll_recv(context)) {
            if is_for_programs(&message) {
                return Poll::Ready(Some(Ok(Sample::new(self.topic.clone(), message))));
            }
        }
        let Some(ended) = &mut self.ended else { return Poll::Ready(None) };
        let why = ready!(ended.as_mut().poll(context));
        self.ended = None;
        Poll::Ready(match why {
            Ended::Closed => None,
            why => Some(Err(why.into())),
        })
    }
}

/// Returns whether a message is none by which proxies describe a topic to one another: they have
/// encodings of their own, from 0x4700 to 0x47ff.
fn is_for_programs(message: &Message) -> bool {
    !matches!(message.encoding, Encoding::Other(0x4700..=0x47ff))
}

impl Stream for Subscriber {
    type Item = Result<Sample, Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.poll_sample(context)
    }
}

impl fmt::Debug for Subscriber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Subscriber").field("topic", &self.topic).field("name", &self.name()).finish_non_exhaustive()
    }
}
