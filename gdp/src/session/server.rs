//! Servers of a session.

use std::fmt;
use std::future::IntoFuture;
use std::sync::Arc;

use bytes::Bytes;
use futures::future::BoxFuture;
use gdp_core::card::NameCard;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;

use super::attached::Attached;
use super::error::Error;
use crate::node;
use crate::node::{Call, Ended};

/// A server before it is attached: await it.
#[derive(Clone, Debug)]
#[must_use = "await it"]
pub struct ServerBuilder {
    session: Arc<Attached>,
    service: String,
    encoding: Encoding,
}

impl ServerBuilder {
    pub(super) fn new(session: Arc<Attached>, service: String) -> Self {
        Self { session, service, encoding: Encoding::Bytes }
    }

    /// Sets the encoding that every reply states. Default: [`Encoding::Bytes`].
    pub fn encoding(mut self, encoding: Encoding) -> Self {
        self.encoding = encoding;
        self
    }

    async fn attach(self) -> Result<Server, Error> {
        let Self { session, service, encoding } = self;
        let card = session.find(&service, "service").await?;
        let ad = session.ad(&card)?;
        let node = session.node.serve(card.proof(), ad).await?;
        Ok(Server { node, session, card, service: service.into(), encoding })
    }
}

impl IntoFuture for ServerBuilder {
    type Output = Result<Server, Error>;
    type IntoFuture = BoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.attach())
    }
}

/// Receives the calls to a service, as one of its servers. Dropping it withdraws the server.
pub struct Server {
    node: node::Server,
    /// Presents renewed credentials, as long as a handle exists.
    session: Arc<Attached>,
    card: NameCard,
    service: Arc<str>,
    encoding: Encoding,
}

impl Server {
    /// Returns the next call, or `None` after the session is closed. Safe to cancel.
    ///
    /// # Errors
    ///
    /// Fails when the right to serve has expired or was revoked.
    pub async fn recv(&mut self) -> Result<Option<IncomingCall>, Error> {
        match self.node.recv().await {
            Some(call) => Ok(Some(IncomingCall { call, encoding: self.encoding })),
            None => match self.node.ended().await {
                Ended::Closed => Ok(None),
                why => Err(why.into()),
            },
        }
    }

    /// Goes on to serve with the certificate that the keyring has now. Call it before the one in
    /// use ends.
    ///
    /// # Errors
    ///
    /// Fails if there is no valid one, or if the fabric refuses it. The one in use stays in force.
    pub async fn renew(&mut self) -> Result<(), Error> {
        let ad = self.session.ad(&self.card)?;
        Ok(self.node.renew(ad).await?)
    }

    /// Returns the name that is served.
    pub fn name(&self) -> Name {
        self.node.name()
    }

    /// Returns the service as the program named it.
    pub fn service(&self) -> &str {
        &self.service
    }

    /// Returns the name's card, which states for example the type of a ROS service.
    pub fn card(&self) -> &NameCard {
        &self.card
    }
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server").field("service", &self.service).field("name", &self.name()).finish_non_exhaustive()
    }
}

/// A call that waits for its reply. Dropping it leaves it unanswered.
pub struct IncomingCall {
    call: Call,
    encoding: Encoding,
}

impl IncomingCall {
    /// Returns the content of the request.
    pub fn payload(&self) -> &Bytes {
        self.call.body()
    }

    /// Returns the encoding that the caller states.
    pub fn encoding(&self) -> Encoding {
        self.call.encoding()
    }

    /// Returns the entity that calls.
    pub fn source(&self) -> Name {
        self.call.client()
    }

    /// Replies to the caller only. `Ok` means that the reply is sent or queued.
    ///
    /// # Errors
    ///
    /// Fails if the caller has left.
    pub async fn reply(self, payload: impl AsRef<[u8]>) -> Result<(), Error> {
        Ok(self.call.reply(self.encoding, payload.as_ref()).await?)
    }
}

impl fmt::Debug for IncomingCall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("IncomingCall").field("source", &self.source()).field("bytes", &self.payload().len()).finish()
    }
}
