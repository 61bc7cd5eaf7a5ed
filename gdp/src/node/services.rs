//! Calls and their replies. A request is sealed like a message of the name, under keys of the caller that its servers alone have; the reply
//! goes to the caller's own name, under keys of the server that this caller alone has. So no caller reads another's.

use std::sync::Arc;

use bytes::Bytes;
use gdp_wire::Name;
use tokio::sync::oneshot;

use super::ending::{Ended, Ending};
use super::options::SubscribeOptions;
use super::publication::Publication;
use super::publisher::send_through;
use super::state::{State, Statement, lock};
use super::subscription::Queue;
use super::{Handle, NodeError, Stated};
use crate::cert::{AdCert, Issued, Reading};
use crate::seal::{Draft, Encoding, Message, MessageId};

/// Calls of a node that may wait for their replies at once.
const MAX_CALLS: usize = 4096;

/// Takes calls to a name. Dropping it withdraws the name.
pub struct Server {
    node: Arc<Handle>,
    queue: Queue,
    ending: Arc<Ending>,
}

impl Server {
    pub(super) fn new(node: Arc<Handle>, queue: Queue, ending: Arc<Ending>) -> Self {
        Self { node, queue, ending }
    }

    /// Waits until nothing is served any more, and says why.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Serves on by this certificate, as [`Publisher::renew`](super::Publisher::renew) publishes.
    pub async fn renew(&mut self, ad_cert: Issued<AdCert>) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Write { proof, ad_cert };
        self.node.state.renew(self.queue.name, Stated::Served, renewed).await
    }

    pub fn name(&self) -> Name {
        self.queue.name
    }

    /// The next call; `None` once the node is closed, or the certificate holds no more. Safe to cancel.
    pub async fn recv(&mut self) -> Option<Call> {
        let request = self.queue.recv(&self.node.state).await?;
        Some(Call { node: self.node.clone(), request })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.node.state.withdraw(self.queue.name, Stated::Served);
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
        let publication = lock(&state.publications).get(&writer).cloned().ok_or_else(gone)?;
        let in_reply_to = Some(MessageId { session, sequence });
        let draft = Draft { in_reply_to, ..Draft::new(encoding, body) };
        send_through(&publication, &state.outlet, &[draft], |_| {}).await.map(drop)
    }
}

/// Calls a name. Dropping it withdraws that.
pub struct Client {
    node: Arc<Handle>,
    publication: Arc<Publication>,
}

/// A call that waits for its reply.
pub struct Pending {
    publication: Arc<Publication>,
    reply: oneshot::Sender<Message>,
}

impl Client {
    pub(super) fn new(node: Arc<Handle>, publication: Arc<Publication>) -> Self {
        Self { node, publication }
    }

    pub fn name(&self) -> Name {
        self.publication.name
    }

    /// Waits until nothing can be called any more, and says why.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.publication.ending.wait()
    }

    /// Calls on by this grant, as [`Subscription::renew`](super::Subscription::renew) reads.
    pub async fn renew(&mut self, grant: Reading) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Read { proof, grant };
        self.node.state.renew(self.publication.name, Stated::Called, renewed).await
    }

    /// Servers that are attached at the moment, as far as is known here.
    pub fn servers(&self) -> usize {
        self.publication.readers()
    }

    /// Sends a request and waits for the first reply to it, for as long as the caller of this function does. A request is never sent
    /// again to another server: it may have been carried out.
    pub async fn call(&self, encoding: Encoding, body: &[u8]) -> Result<Message, NodeError> {
        let state = &self.node.state;
        if self.servers() == 0 {
            return Err(NodeError::NoServer(self.name()));
        }
        let waiting = lock(&state.calls).len();
        if waiting >= MAX_CALLS {
            return Err(NodeError::TooManyCalls(waiting));
        }
        let session = self.publication.session;
        let (reply, replied) = oneshot::channel();
        let mut guard = Waiting { state, id: None };
        let begun = |sequence| {
            let id = MessageId { session, sequence };
            guard.id = Some(id);
            lock(&state.calls).insert(id, Pending { publication: self.publication.clone(), reply });
        };
        let draft = Draft::new(encoding, body);
        send_through(&self.publication, &state.outlet, &[draft], begun).await?;
        replied.await.map_err(|_| NodeError::Closed)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.node.state.withdraw(self.publication.name, Stated::Called);
    }
}

/// Nobody waits any more once this is dropped.
struct Waiting<'a> {
    state: &'a State,
    id: Option<MessageId>,
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.id.map(|id| lock(&self.state.calls).remove(&id));
    }
}

impl State {
    /// Takes replies from now on, as long as the node runs.
    pub fn open_inbox(self: &Arc<Self>) {
        let own = self.identity.name();
        let mut opened = lock(&self.inbox_opened);
        if std::mem::replace(&mut *opened, true) {
            return;
        }
        let (mut queue, _) = self.listen(own, SubscribeOptions::reliable());
        let state = self.clone();
        tokio::spawn(async move {
            while let Some(reply) = queue.recv(&state).await {
                state.take_reply(reply);
            }
            // Whoever waits still waits in vain.
            lock(&state.calls).clear();
        });
    }

    /// Only one who serves the name that was called may answer, and once.
    fn take_reply(&self, reply: Message) {
        let Some(id) = reply.in_reply_to else { return };
        let called = lock(&self.calls).get(&id).map(|pending| pending.publication.clone());
        if called.is_some_and(|publication| publication.is_reader(&reply.writer))
            && let Some(pending) = lock(&self.calls).remove(&id)
        {
            let _ = pending.reply.send(reply);
        }
    }
}
