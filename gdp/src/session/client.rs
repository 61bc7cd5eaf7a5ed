//! Clients of services.

use std::fmt;
use std::future::IntoFuture;
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use gdp_core::card::NameCard;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;

use super::attached::Attached;
use super::error::Error;
use super::sample::Sample;
use crate::node;

/// Time for a server to attach and to reply, if the program sets none.
const TIMEOUT: Duration = Duration::from_secs(10);

/// A client before it is attached: await it.
#[derive(Clone, Debug)]
#[must_use = "await it"]
pub struct ClientBuilder {
    session: Arc<Attached>,
    service: String,
    encoding: Encoding,
    timeout: Duration,
}

impl ClientBuilder {
    pub(super) fn new(session: Arc<Attached>, service: String) -> Self {
        Self { session, service, encoding: Encoding::Bytes, timeout: TIMEOUT }
    }

    /// Sets the encoding that every request states. Default: [`Encoding::Bytes`].
    pub fn encoding(mut self, encoding: Encoding) -> Self {
        self.encoding = encoding;
        self
    }

    /// Sets how long a call waits for a server and its reply. Default: 10 s.
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    async fn attach(self) -> Result<Client, Error> {
        let Self { session, service, encoding, timeout } = self;
        let card = session.find(&service, "service").await?;
        let grant = session.grant(&card)?;
        let node = session.node.client(card.proof(), grant).await?.into();
        Ok(Client { node, session, card, service: service.into(), encoding, timeout })
    }
}

impl IntoFuture for ClientBuilder {
    type Output = Result<Client, Error>;
    type IntoFuture = BoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.attach())
    }
}

/// Calls a service. Clones are the same client.
#[derive(Clone)]
pub struct Client {
    node: Arc<node::Client>,
    /// Presents renewed credentials, as long as a handle exists.
    session: Arc<Attached>,
    card: NameCard,
    service: Arc<str>,
    encoding: Encoding,
    timeout: Duration,
}

impl Client {
    /// Sends a request to the nearest server, and returns its reply. Waits for a server if none is
    /// attached. A request goes to one server once, and is never repeated.
    ///
    /// # Errors
    ///
    /// Fails if no server attaches, if it leaves before it replies, or if the time is over.
    pub async fn call(&self, request: impl AsRef<[u8]>) -> Result<Sample, Error> {
        let mut is_attached = false;
        let call = async {
            let mut changes = self.node.changes();
            while self.node.servers() == 0 {
                if changes.changed().await.is_err() {
                    return Err(Error::from(self.node.ended().await));
                }
            }
            is_attached = true;
            Ok(self.node.call(self.encoding, request.as_ref()).await?)
        };
        let reply = tokio::time::timeout(self.timeout, call).await;
        let (name, after) = (self.service.to_string(), self.timeout);
        let reply = match (reply, is_attached) {
            (Ok(reply), _) => reply?,
            (Err(_), true) => return Err(Error::NoReply { name, after }),
            (Err(_), false) => return Err(Error::NoServer { name, after }),
        };
        Ok(Sample::new(self.service.clone(), reply))
    }

    /// Goes on to call with the grant that the keyring, or the other member, has now. Call it
    /// before the one in use ends.
    ///
    /// # Errors
    ///
    /// Fails if there is no valid one, or if the fabric refuses it. The one in use stays in force.
    pub async fn renew(&self) -> Result<(), Error> {
        let grant = self.session.new_grant(&self.card, &self.service, "service").await?;
        Ok(self.node.renew(grant).await?)
    }

    /// Returns the number of attached servers.
    pub fn servers(&self) -> usize {
        self.node.servers()
    }

    /// Returns the name that is called.
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

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Client").field("service", &self.service).field("name", &self.name()).finish_non_exhaustive()
    }
}
