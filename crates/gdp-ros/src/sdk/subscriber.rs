//! Subscribers of ROS messages.

use std::collections::HashMap;
use std::fmt;
use std::marker::PhantomData;
use std::time::SystemTime;

use gdp_msg::{Encoding, TypeName};
use gdp_wire::Name;

use super::context::RosContext;
use super::error::RosSdkError;
use super::types::{self, RosMessage};
use crate::feed::{Feed, ReceivedMessage};
use crate::roster::{Dialect, Kind};
use crate::types::{Converter, Form, Types, unsealed};

/// Maximum number of types of publishers for which a converter is stored.
const MAX_KNOWN: usize = 64;

/// A ROS message with its source.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Received<T> {
    /// The message.
    pub message: T,
    /// The entity that sent it: a proxy, or a program.
    pub source: Name,
    /// When it was sent, by the source's clock.
    pub time: SystemTime,
}

/// Reads ROS messages of one type.
pub struct RosSubscriber<T> {
    feed: Feed,
    types: Types,
    topic: String,
    own: Kind,
    definition: String,
    /// Of types that publishers announced: how to make own ones of them.
    converters: HashMap<(Kind, Encoding), Converter>,
    of: PhantomData<fn() -> T>,
}

impl<T: RosMessage> RosSubscriber<T> {
    pub(super) async fn attach(ros: &RosContext, topic: String) -> Result<Self, RosSdkError> {
        let types = ros.types()?;
        let (own, schema) = types::kind::<T>(&types)?;
        let (subscription, card) = ros.session.subscriber(topic.as_str()).subscribe().await?;
        let (feed, definition) = (Feed::new(subscription, &card), schema.text());
        Ok(Self { feed, types, topic, own, definition, converters: HashMap::new(), of: PhantomData })
    }

    /// Returns the next message, or `None` after the session is closed. Safe to cancel.
    ///
    /// # Errors
    ///
    /// Fails if the right to read has ended, or for a message of another type. After the latter the
    /// next messages can be read.
    pub async fn recv(&mut self) -> Result<Option<Received<T>>, RosSdkError> {
        let Some(received) = next(&mut self.feed, &self.topic).await? else { return Ok(None) };
        let source = received.message.writer;
        let time = received.time();
        let message = self.decode(received)?;
        Ok(Some(Received { message, source, time }))
    }

    fn decode(&mut self, received: ReceivedMessage) -> Result<T, RosSdkError> {
        let ReceivedMessage { message, kind, definition } = received;
        if TypeName::parse(&kind.name)? != TypeName::parse(T::TYPE)? {
            let (topic, wanted) = (self.topic.clone(), T::TYPE.to_owned());
            return Err(RosSdkError::OtherType { topic, carded: kind.name, wanted });
        }
        let wrong = |error| RosSdkError::Type(T::TYPE.into(), Box::new(error));
        let (encoding, body) = unsealed(message.encoding, message.body).map_err(wrong)?;
        let key = (kind, encoding);
        if !self.converters.contains_key(&key) {
            if self.converters.len() >= MAX_KNOWN {
                self.converters.clear();
            }
            let converter = self.converter(&key, definition.as_deref()).map_err(wrong)?;
            self.converters.insert(key.clone(), converter);
        }
        let body = match self.converters.get_mut(&key) {
            Some(converter) => converter.convert(body)?,
            None => body,
        };
        types::from_cdr(&body)
    }

    /// Returns how to make own messages of those of a publisher.
    fn converter(
        &self,
        (kind, encoding): &(Kind, Encoding),
        definition: Option<&str>,
    ) -> Result<Converter, crate::types::TypeError> {
        if kind.dialect == Dialect::Ros2 && *encoding == Encoding::Cdr && kind.agrees(&self.own) {
            return Ok(Converter::None);
        }
        let from = Form { kind, definition, encoding: *encoding };
        self.types
            .converter(&from, &Form { kind: &self.own, definition: Some(&self.definition), encoding: Encoding::Cdr })
    }
}

impl<T: RosMessage> fmt::Debug for RosSubscriber<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RosSubscriber").field("topic", &self.topic).field("type", &T::TYPE).finish_non_exhaustive()
    }
}

/// Returns the next message of a publisher of ROS. Logs what is left out.
pub(super) async fn next(feed: &mut Feed, topic: &str) -> Result<Option<ReceivedMessage>, RosSdkError> {
    let received = feed.next().await;
    for warning in feed.take_said() {
        tracing::warn!(topic, "{warning}");
    }
    match received {
        Some(received) => Ok(Some(received)),
        None => match feed.ended().await {
            gdp::unstable::Ended::Closed => Ok(None),
            why => Err(gdp::Error::from(why).into()),
        },
    }
}
