//! Calls and their replies. A call goes to one server of the service, to its own name, under keys
//! of the caller that this server alone has; the reply goes to the caller's own name, under keys of
//! the server that this caller alone has. So nobody else reads either, and no frame goes to the
//! name of the service.

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

/// Calls of a node that may wait for their replies at once.
const MAX_CALLS: usize = 4096;

/// Takes calls to a name. Dropping it withdraws the name.
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

    /// Waits until nothing is served any more, and says why.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Serves on by this certificate, as [`Publisher::renew`](super::Publisher::renew) publishes.
    pub async fn renew(&mut self, ad_cert: Issued<AdCert>) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Write { proof, ad_cert };
        self.node.state.renew(self.name, Stated::Served, renewed).await
    }

    pub fn name(&self) -> Name {
        self.name
    }

    /// The next call; `None` once the node is closed, or the certificate holds no more. Safe to
    /// cancel. Some thousands wait here; more are dropped and counted, and never answered.
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

/// A call that waits for its reply. Dropped, it is never answered.
pub struct Call {
    node: Arc<Handle>,
    request: Message,
}

impl Call {
    /// Who calls.
    pub fn client(&self) -> Name {
        self.request.writer
    }

    pub fn encoding(&self) -> Encoding {
        self.request.encoding
    }

    pub fn body(&self) -> &Bytes {
        &self.request.body
    }

    /// Replies to the caller alone: `Ok` says that the reply is on its way or waits for its turn.
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

/// Calls a name. Dropping it withdraws that.
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

    /// Waits until nothing can be called any more, and says why.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Calls on by this grant, as [`Subscription::renew`](super::Subscription::renew) reads; also
    /// while calls wait.
    pub async fn renew(&self, grant: Reading) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Read { proof, grant };
        self.node.state.renew(self.name, Stated::Called, renewed).await
    }

    /// Servers that are attached at the moment, as far as is known here.
    pub fn servers(&self) -> usize {
        self.node.state.servers(self.name)
    }

    /// These servers, the one that is called next in front.
    pub fn instances(&self) -> Vec<Instance> {
        self.node.state.instances(self.name)
    }

    /// Sees a change whenever a server is attached that was not, or is not any more: ask
    /// [`Self::instances`] then. Ends with the client.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.node.state.server_changes(self.name)
    }

    /// Sends a request to one server, and waits for the reply to it for as long as the caller of
    /// this function does. The server is the nearest; of several that are as near, the one with the
    /// fewest calls of this node waiting. [`Message::writer`] of the reply is who it was. If that
    /// is not attached any more before it replies, this fails at once: a request is never sent
    /// again to another server, for it may have been carried out.
    pub async fn call(&self, encoding: Encoding, body: &[u8]) -> Result<Message, NodeError> {
        let pending = self.node.state.choose(self.name, None).ok_or(NodeError::NoServer(self.name))?;
        self.call_there(pending, encoding, body).await
    }

    /// As [`Self::call`], of this server whichever is nearest: what was begun at one is continued
    /// there. Its name is the [writer](Message::writer) of an earlier reply.
    pub async fn call_at(&self, instance: Name, encoding: Encoding, body: &[u8]) -> Result<Message, NodeError> {
        let absent = NodeError::NoInstance { service: self.name, instance };
        let pending = self.node.state.choose(self.name, Some(&instance)).ok_or(absent)?;
        self.call_there(pending, encoding, body).await
    }

    async fn call_there(&self, pending: PendingCall, encoding: Encoding, body: &[u8]) -> Result<Message, NodeError> {
        let (state, service, instance) = (&self.node.state, self.name, pending.instance);
        let left = || NodeError::InstanceLeft { service, instance };
        // There is no way to one that has only just come, and none any more to one that has left.
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
        };
        let draft = Draft { service: Some(service), ..Draft::new(encoding, body) };
        let drafts = [draft];
        let exchange = async {
            send_through(&publication, &state.send_path, &drafts, begun).await?;
            replied.await.map_err(|_| NodeError::Closed)
        };
        tokio::select! {
            // A reply that is here counts, whatever became of the server since.
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

/// Nobody waits any more once this is dropped.
struct CallGuard<'a> {
    state: &'a State,
    id: Option<MessageId>,
}

impl Drop for CallGuard<'_> {
    fn drop(&mut self) {
        self.id.map(|id| self.state.calls.lock().remove(&id));
    }
}
