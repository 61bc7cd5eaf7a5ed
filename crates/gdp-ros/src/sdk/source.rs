//! A publisher of the fabric that proxies take for a publisher of ROS.

use std::sync::{Arc, Weak};
use std::time::Instant;

use gdp::Publisher;
use gdp::unstable::{NodeError, PublishOptions};
use gdp_core::cbor::CborError;
use gdp_e2e::seal::Draft;
use gdp_msg::{Encoding, Schema, TypeName};
use parking_lot::Mutex;

use super::context::RosContext;
use super::error::RosSdkError;
use crate::qos_mapping;
use crate::roster::{self, Kind, Offer, Outgoing};
use crate::types::sealed;

/// A publisher that announces itself to proxies as a ROS publisher, while it exists.
pub struct RosSource {
    pub publisher: Publisher,
    roster: Mutex<Outgoing<()>>,
    origin: [u8; 4],
}

impl RosSource {
    pub async fn attach(
        ros: &RosContext,
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
        let (roster, origin) = roster::single(kind, schema, offer);
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
async fn announce_until_dropped(source: Weak<RosSource>) {
    // Nothing changes what it announces, so the time of the next announcement is known.
    while let Some(due) = source.upgrade().and_then(|source| source.roster.lock().due()) {
        tokio::time::sleep_until(due.into()).await;
        let Some(source) = source.upgrade() else { return };
        if let Err(error) = source.announce() {
            tracing::warn!(topic = source.publisher.topic(), %error, "cannot announce the publisher to proxies");
        }
    }
}
