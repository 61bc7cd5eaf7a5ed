//! Publishers of ROS messages.

use std::fmt;
use std::future::IntoFuture;
use std::marker::PhantomData;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use futures::future::BoxFuture;
use gdp::Publisher;
use gdp::unstable::{NodeError, PublishOptions};
use gdp_core::cbor::CborError;
use gdp_e2e::seal::Draft;
use gdp_msg::{Encoding, Schema, TypeName};
use parking_lot::Mutex;

use super::types::{self, RosMessage};
use super::{Ros, RosSdkError};
use crate::encoder::type_hash;
use crate::qos_mapping;
use crate::roster::{self, Dialect, Kind, Offer, Outgoing};
use crate::types::sealed;

/// Interval of the checks for a due list of publishers.
const LOOK: Duration = Duration::from_millis(200);

/// A publisher of ROS messages before it is attached: await it. By default it offers the default
/// QoS of ROS 2: reliable, the last 10 messages.
#[must_use = "await it"]
pub struct RosPublisherBuilder<T> {
    ros: Ros,
    topic: String,
    offer: Offer,
    of: PhantomData<fn(T)>,
}

impl<T: RosMessage> RosPublisherBuilder<T> {
    pub(super) fn new(ros: Ros, topic: String) -> Self {
        Self { ros, topic, offer: Offer::DEFAULT, of: PhantomData }
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

    async fn attach(self) -> Result<RosPublisher<T>, RosSdkError> {
        let (kind, schema) = types::kind::<T>(&self.ros.types()?)?;
        let source = Announced::attach(&self.ros, self.topic, kind, &schema, self.offer).await?;
        Ok(RosPublisher { source, of: PhantomData })
    }
}

impl<T: RosMessage + 'static> IntoFuture for RosPublisherBuilder<T> {
    type Output = Result<RosPublisher<T>, RosSdkError>;
    type IntoFuture = BoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.attach())
    }
}

impl<T: RosMessage> fmt::Debug for RosPublisherBuilder<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RosPublisherBuilder").field("topic", &self.topic).field("type", &T::TYPE).finish()
    }
}

/// Publishes ROS messages. Clones are the same publisher.
pub struct RosPublisher<T> {
    source: Arc<Announced>,
    of: PhantomData<fn(T)>,
}

impl<T: RosMessage> RosPublisher<T> {
    /// Sends a message, and returns its sequence number.
    ///
    /// # Errors
    ///
    /// Fails as [`Publisher::put`] does.
    pub async fn put(&self, message: &T) -> Result<u64, RosSdkError> {
        self.source.put(&types::to_cdr(message)?).await
    }

    /// Returns the publisher, for example to flush it.
    pub fn publisher(&self) -> &Publisher {
        &self.source.publisher
    }
}

impl<T> Clone for RosPublisher<T> {
    fn clone(&self) -> Self {
        Self { source: self.source.clone(), of: PhantomData }
    }
}

impl<T: RosMessage> fmt::Debug for RosPublisher<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RosPublisher").field("type", &T::TYPE).field("publisher", &self.source.publisher).finish()
    }
}

/// A publisher that announces itself to proxies as a ROS publisher, while it exists.
pub(super) struct Announced {
    pub publisher: Publisher,
    roster: Mutex<Outgoing<()>>,
    origin: [u8; 4],
}

impl Announced {
    pub async fn attach(
        ros: &Ros,
        topic: String,
        kind: Kind,
        schema: &Schema,
        offer: Offer,
    ) -> Result<Arc<Self>, RosSdkError> {
        let latched = qos_mapping::latched_depth(&offer);
        let options = PublishOptions { latched, ..qos_mapping::publish_options(&offer) };
        let card = ros.session.find(&topic, "topic").await?;
        if let Some(carded) = card.get("type").filter(|text| !text.is_empty())
            && TypeName::parse(carded)? != TypeName::parse(&kind.name)?
        {
            return Err(RosSdkError::OtherType { topic, carded: carded.into(), wanted: kind.name });
        }
        let publisher = ros.session.publisher(topic).options(options).await?;
        let text = Some(schema.text()).filter(|text| text.len() <= roster::MAX_DEFINITION);
        let mut roster = Outgoing::new(kind, text);
        roster.joined((), "", offer);
        let origin = roster::origin(roster.number(&()).unwrap_or_default());
        let source = Arc::new(Self { publisher, roster: Mutex::new(roster), origin });
        source.announce()?;
        tokio::spawn(announce_until_dropped(Arc::downgrade(&source)));
        Ok(source)
    }

    /// Sends an encoded message.
    pub async fn put(&self, body: &[u8]) -> Result<u64, RosSdkError> {
        let draft = Draft { origin: &self.origin, ..Draft::new(sealed(Encoding::Cdr), body) };
        let sent = self.publisher.node().send_shared(&[draft]).await;
        sent.map_err(|error: NodeError| gdp::Error::from(error).into())
    }

    fn announce(&self) -> Result<(), CborError> {
        self.roster.lock().announce(Instant::now(), self.publisher.node())
    }
}

/// Announces the publisher whenever it is due. Does not keep it alive.
async fn announce_until_dropped(source: Weak<Announced>) {
    loop {
        tokio::time::sleep(LOOK).await;
        let Some(source) = source.upgrade() else { return };
        if let Err(error) = source.announce() {
            tracing::warn!(topic = source.publisher.topic(), %error, "cannot announce the publisher to proxies");
        }
    }
}

/// Returns the type of definitions of this project's kind, with its hash.
pub(super) fn kind_of(name: &TypeName, schema: &Schema) -> Kind {
    Kind { dialect: Dialect::Ros2, name: name.to_string(), hash: type_hash(schema) }
}
