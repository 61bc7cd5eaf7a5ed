//! Publishers of ROS messages.

use std::fmt;
use std::future::IntoFuture;
use std::marker::PhantomData;
use std::sync::Arc;

use futures::future::BoxFuture;
use gdp::Publisher;

use super::context::RosContext;
use super::error::RosSdkError;
use super::source::RosSource;
use super::types::{self, RosMessage};
use crate::roster::Offer;

/// A publisher of ROS messages before it is attached: await it. By default it offers the default
/// QoS of ROS 2: reliable, the last 10 messages.
#[must_use = "await it"]
pub struct RosPublisherBuilder<T> {
    ros: RosContext,
    topic: String,
    offer: Offer,
    of: PhantomData<fn(T)>,
}

impl<T: RosMessage> RosPublisherBuilder<T> {
    pub(super) fn new(ros: RosContext, topic: String) -> Self {
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
        let source = RosSource::attach(&self.ros, self.topic, kind, &schema, self.offer).await?;
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
    source: Arc<RosSource>,
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
