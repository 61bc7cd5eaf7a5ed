//! Calls and their replies.
//!
//! A request goes to one server's own name, under keys of the caller for that server only. The
//! reply goes to the caller's own name, under keys of the server for that caller only. No other
//! entity can read them, and no frame goes to the name of the service.

use std::sync::Arc;

use bytes::Bytes;
use gdp_wire::Name;
use tokio::sync::{oneshot, watch};

use super::ending::{Ended, Ending};
use super::error::NodeError;
use super::handle::Handle;
use super::publisher::send_through;
use super::request_queue::RequestQueue;
use super::service::PendingReply;
use super::service_instances::{Instance, PendingCall};
use super::state::State;
use super::statement::{Stated, Statement};
use gdp_core::cert::{AdCert, Issued, Reading};
use gdp_e2e::seal::{Draft, Encoding, Message, MessageId};

/// Maximum number of outstanding calls of a node.
const MAX_CALLS: usize = 4096;

/// Receives the calls to a name. Dropping it withdraws the name.
pub struct Server {
    node: Arc<Handle>,
    name: Name,
    requests: RequestQueue,
    ending: Arc<Ending>,
}

impl Server {
    pub(super) fn new(node: Arc<Handle>, name: Name, requests: RequestQueue, ending: Arc<Ending>) -> Self {
        Self { node, name, requests, ending }
    }

    /// Waits until serving ends, and returns the reason.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Continues to serve with this certificate, as [`Publisher::renew`](super::Publisher::renew)
    /// does for publishing.
    pub async fn renew(&mut self, ad_cert: Issued<AdCert>) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Write { proof, ad_cert };
        self.node.state.renew(self.name, Stated::Served, renewed).await
    }

    pub fn name(&self) -> Name {
        self.name
    }

    /// Returns the next call, or `None` after the node closes or the certificate ends. Safe to
    /// cancel.
    ///
    /// Some thousands of calls can wait. Excess calls are dropped, counted and never answered.
    pub async fn recv(&mut self) -> Option<Call> {
        let request = self.requests.recv().await?;
        Some(Call { node: self.node.clone(), request })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.node.state.withdraw(self.name, Stated::Served);
    }
}

/// A call that waits for its reply. Dropping it leaves it unanswered.
pub struct Call {
    node: Arc<Handle>,
    request: Message,
}

impl Call {
    /// Returns the name of the caller.
    pub fn client(&self) -> Name {
        self.request.writer
    }

    /// Identifies the request among those of its caller.
    pub fn id(&self) -> MessageId {
        MessageId { session: self.request.session, sequence: self.request.sequence }
    }

    pub fn encoding(&self) -> Encoding {
        self.request.encoding
    }

    pub fn body(&self) -> &Bytes {
        &self.request.body
    }

    /// Replies to the caller only. `Ok` means that the reply is sent or queued.
    pub async fn reply(self, encoding: Encoding, body: &[u8]) -> Result<(), NodeError> {
        let state = &self.node.state;
        let Message { session, sequence, writer, .. } = self.request;
        let gone = || NodeError::Detached(format!("the caller {writer:#} is gone"));
        let publication = state.send_path.publications.get(&writer).ok_or_else(gone)?;
        let in_reply_to = Some(MessageId { session, sequence });
        let draft = Draft { in_reply_to, ..Draft::new(encoding, body) };
        send_through(&publication, &state.send_path, &[draft], |_| {}).await.map(drop)
    }
}

/// Calls a name. Dropping it withdraws the statement that this node calls it.
pub struct Client {
    node: Arc<Handle>,
    name: Name,
    ending: Arc<Ending>,
}

impl Client {
    pub(super) fn new(node: Arc<Handle>, name: Name, ending: Arc<Ending>) -> Self {
        Self { node, name, ending }
    }

    pub fn name(&self) -> Name {
        self.name
    }

    /// Waits until calling ends, and returns the reason.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Continues to call with this grant, as [`Subscription::renew`](super::Subscription::renew)
    /// does for reading. Outstanding calls continue.
    pub async fn renew(&self, grant: Reading) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Read { proof, grant };
        self.node.state.renew(self.name, Stated::Called, renewed).await
    }

    /// Returns the number of attached servers that this node knows of.
    pub fn servers(&self) -> usize {
        self.node.state.servers(self.name)
    }

    /// Returns these servers, the preferred one first.
    pub fn instances(&self) -> Vec<Instance> {
        self.node.state.instances(self.name)
    }

    /// Returns a receiver that is notified of each attached or detached server: call
    /// [`Self::instances`] then. It ends with the client.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.node.state.server_changes(self.name)
    }

    /// Sends a request to one server and waits for its reply, without a timeout.
    ///
    /// The nearest server is selected, or of equally near ones the one with the fewest outstanding
    /// calls of this node. [`Message::writer`] of the reply is the server.
    ///
    /// # Errors
    ///
    /// Fails at once if the server is detached before it replies. The request is never repeated at
    /// another server, because the first one may have executed it.
    pub async fn call(&self, encoding: Encoding, body: &[u8]) -> Result<Message, NodeError> {
        let pending = self.node.state.choose(self.name, None).ok_or(NodeError::NoServer(self.name))?;
        self.call_there(pending, encoding, body, |_| {}).await
    }

    /// Calls this server as [`Self::call`] does, independent of its distance, to continue an
    /// earlier exchange. Its name is the [writer](Message::writer) of an earlier reply.
    pub async fn call_at(&self, instance: Name, encoding: Encoding, body: &[u8]) -> Result<Message, NodeError> {
        self.call_at_with(instance, encoding, body, |_| {}).await
    }

    /// Calls this server as [`Self::call_at`] does. Passes the request's ID to `begun` when it is
    /// sent. The server sees the same [`Call::id`].
    pub async fn call_at_with(
        &self,
        instance: Name,
        encoding: Encoding,
        body: &[u8],
        begun: impl FnOnce(MessageId) + Send,
    ) -> Result<Message, NodeError> {
        let absent = NodeError::NoInstance { service: self.name, instance };
        let pending = self.node.state.choose(self.name, Some(&instance)).ok_or(absent)?;
        self.call_there(pending, encoding, body, begun).await
    }

    /// Sends a request to this server without waiting for a reply. `Ok` means that the request is
    /// sent or queued. A reply to it is ignored.
    pub async fn notify_at(&self, instance: Name, encoding: Encoding, body: &[u8]) -> Result<(), NodeError> {
        let (state, service) = (&self.node.state, self.name);
        let absent = || NodeError::NoInstance { service, instance };
        // Only to a server of this service: the entity may have a publication for another one.
        let _pending = state.choose(service, Some(&instance)).ok_or_else(absent)?;
        let publication = state.send_path.publications.get(&instance).ok_or_else(absent)?;
        let draft = Draft { service: Some(service), ..Draft::new(encoding, body) };
        send_through(&publication, &state.send_path, &[draft], |_| {}).await.map(drop)
    }

    async fn call_there(
        &self,
        pending: PendingCall,
        encoding: Encoding,
        body: &[u8],
        started: impl FnOnce(MessageId) + Send,
    ) -> Result<Message, NodeError> {
        let (state, service, instance) = (&self.node.state, self.name, pending.instance);
        let left = || NodeError::InstanceLeft { service, instance };
        // A server that has just joined has no publication yet, and one that has left has none any
        // more.
        let absent = || if pending.has_left() { left() } else { NodeError::NoInstance { service, instance } };
        let publication = state.send_path.publications.get(&instance).ok_or_else(absent)?;
        let waiting = state.calls.lock().len();
        if waiting >= MAX_CALLS {
            return Err(NodeError::TooManyCalls(waiting));
        }
        let session = publication.sealer.session;
        let (reply, replied) = oneshot::channel();
        let mut guard = CallGuard { state, id: None };
        let begun = |sequence| {
            let id = MessageId { session, sequence };
            guard.id = Some(id);
            state.calls.lock().insert(id, PendingReply { instance, reply });
            started(id);
        };
        let draft = Draft { service: Some(service), ..Draft::new(encoding, body) };
        let drafts = [draft];
        let exchange = async {
            send_through(&publication, &state.send_path, &drafts, begun).await?;
            replied.await.map_err(|_| NodeError::Closed)
        };
        tokio::select! {
            // A reply that has arrived counts, even if the server has left since.
            biased;
            result = exchange => result.map_err(|error| if pending.has_left() { left() } else { error }),
            () = pending.left() => Err(left()),
            why = self.ending.wait() => Err(why.into()),
        }
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.node.state.withdraw(self.name, Stated::Called);
    }
}

/// Removes the outstanding call when it is dropped.
struct CallGuard<'a> {
    state: &'a State,
    id: Option<MessageId>,
}

impl Drop for CallGuard<'_> {
    fn drop(&mut self) {
        self.id.map(|id| self.state.calls.lock().remove(&id));
    }
}
