//! ROS messages of types that are known by their names only, as JSON values.

use std::fmt;
use std::future::IntoFuture;
use std::sync::Arc;
use std::time::SystemTime;

use futures::future::BoxFuture;
use gdp::Publisher;
use gdp_msg::Schema;
use gdp_wire::Name;
use serde_json::Value;

use super::context::RosContext;
use super::error::RosSdkError;
use super::source::RosSource;
use super::subscriber::next;
use crate::encoder::Encoder;
use crate::feed::{Decoded, Decoder, Feed};
use crate::roster::Offer;
use crate::user_input::UserInput;

/// A publisher of a type that the program names, before it is attached: await it. By default it
/// offers the default QoS of ROS 2: reliable, the last 10 messages.
#[derive(Clone, Debug)]
#[must_use = "await it"]
pub struct DynamicPublisherBuilder {
    ros: RosContext,
    topic: String,
    type_name: String,
    offer: Offer,
}

impl DynamicPublisherBuilder {
    pub(super) fn new(ros: RosContext, topic: String, type_name: String) -> Self {
        Self { ros, topic, type_name, offer: Offer::DEFAULT }
    }

    /// Offers only the newest message.
    pub fn best_effort(mut self) -> Self {
        self.offer.reliable = false;
        self
    }

    /// Sends the last messages, as many as the depth, to readers that join later.
    pub fn transient_local(mut self) -> Self {
        self.offer.transient_local = true;
        self
    }

    /// Sets the depth of the history.
    pub fn depth(mut self, messages: u32) -> Self {
        self.offer.depth = messages.max(1);
        self
    }

    async fn attach(self) -> Result<DynamicPublisher, RosSdkError> {
        let encoder = Encoder::new(&self.ros.types()?, &self.type_name)?;
        let kind = encoder.kind().clone();
        let source = RosSource::attach(&self.ros, self.topic, kind, encoder.schema(), self.offer).await?;
        Ok(DynamicPublisher { source, encoder: encoder.into() })
    }
}

impl IntoFuture for DynamicPublisherBuilder {
    type Output = Result<DynamicPublisher, RosSdkError>;
    type IntoFuture = BoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.attach())
    }
}

/// Publishes ROS messages of a type that the program names. Clones are the same publisher.
#[derive(Clone)]
pub struct DynamicPublisher {
    source: Arc<RosSource>,
    encoder: Arc<Encoder>,
}

impl DynamicPublisher {
    /// Sends a message, and returns its sequence number. `values` is an object with fields. Omitted
    /// fields have the default of the definition, or else are zero or empty.
    ///
    /// # Errors
    ///
    /// Fails if the values do not fit the type, and as [`Publisher::put`] does.
    pub async fn put(&self, values: &Value) -> Result<u64, RosSdkError> {
        self.put_text(&values.to_string()).await
    }

    /// Sends a message that is written in YAML or JSON. `now` is the current time, and `auto` a
    /// header with it.
    ///
    /// # Errors
    ///
    /// Fails as [`Self::put`] does.
    pub async fn put_text(&self, values: &str) -> Result<u64, RosSdkError> {
        let name = || self.encoder.kind().name.clone();
        let input = UserInput::parse(values).map_err(|error| RosSdkError::Cdr(name(), error.to_string()))?;
        let (body, _) = self.encoder.encode(&input)?;
        self.source.put(&body).await
    }

    /// Returns the publisher, for example to flush it.
    pub fn publisher(&self) -> &Publisher {
        &self.source.publisher
    }

    /// Returns the type of the messages.
    pub fn type_name(&self) -> &str {
        &self.encoder.kind().name
    }
}

impl fmt::Debug for DynamicPublisher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (type_name, publisher) = (self.type_name(), self.publisher());
        f.debug_struct("DynamicPublisher").field("type", &type_name).field("publisher", publisher).finish()
    }
}

/// A ROS message as a JSON object. Arrays of bytes are base64, and integers beyond 2^53 are text.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct DynamicMessage {
    /// The type, as its publisher states it.
    pub type_name: String,
    /// The fields.
    pub value: Value,
    /// The entity that sent it: a proxy, or a program.
    pub source: Name,
    /// When it was sent, by the source's clock.
    pub time: SystemTime,
    /// The definitions of the type.
    #[doc(hidden)]
    pub schema: Arc<Schema>,
}

/// Reads ROS messages of any type.
pub struct DynamicSubscriber {
    feed: Feed,
    decoder: Decoder,
    topic: String,
}

impl DynamicSubscriber {
    pub(super) async fn attach(ros: &RosContext, topic: String) -> Result<Self, RosSdkError> {
        let decoder = Decoder::new(ros.types()?);
        let (subscription, card) = ros.session.subscriber(topic.as_str()).subscribe().await?;
        Ok(Self { feed: Feed::new(subscription, &card), decoder, topic })
    }

    /// Returns the next message, or `None` after the session is closed. Safe to cancel.
    ///
    /// # Errors
    ///
    /// Fails if the right to read has ended, or for a message that cannot be decoded. After the
    /// latter the next messages can be read.
    pub async fn recv(&mut self) -> Result<Option<DynamicMessage>, RosSdkError> {
        let Some(received) = next(&mut self.feed, &self.topic).await? else { return Ok(None) };
        let Decoded { schema, value, .. } = self.decoder.decode(&received)?;
        let schema = schema.clone();
        let time = received.time();
        Ok(Some(DynamicMessage { type_name: received.kind.name, value, source: received.message.writer, time, schema }))
    }
}

impl fmt::Debug for DynamicSubscriber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DynamicSubscriber").field("topic", &self.topic).finish_non_exhaustive()
    }
}
