//! Supervises one link of the node.
//!
//! The supervisor makes the link, attaches, repeats the application's statements and answers the
//! switch. It reconnects after a loss, or at once after this machine has changed networks. The
//! application's handles notice only lost messages. [`run`] supervises all links of a node.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::abort_on_drop::AbortOnDrop;
use super::attachment::Attachment;
use super::command::{Command, RibUpdate};
use super::config::LinkConfig;
use super::dialler::Dialler;
use super::error::NodeError;
use super::link_tasks::{
    ANSWER, keep_stated, leave_unneeded, watch_moves, watch_mtu, watch_silence, watch_stale, watch_tunnel,
};
use super::links::Connection;
use super::network::HostNetwork;
use super::pause::{BACKOFF, ExpediteToken};
use super::requests::{answer, update_rib};
use super::state::State;
use gdp_core::link_target::LinkTarget;
use gdp_core::peer::GRACEFUL_RESTART_TIME;
use gdp_link::link::{LinkError, RekeySchedule};
use gdp_util::backoff::Backoff;
use gdp_util::unix_time::unix_nanos;

/// State of a link over TLS that is not dialled.
const UNNEEDED: &str = "a preferred link is up";

/// A link with a silent switch, in use until this time at the latest.
struct StaleLink {
    attachment: Arc<Attachment>,
    until: Instant,
}

/// Supervises the links of a node until `stop` becomes true. Sends the result of each link's first
/// connection through `first`, with the lane of the link.
pub async fn run(
    state: Arc<State>,
    links: Vec<LinkConfig>,
    rekey: RekeySchedule,
    timeout: Duration,
    updates: mpsc::UnboundedReceiver<RibUpdate>,
    first: mpsc::UnboundedSender<(u8, Result<(), NodeError>)>,
    mut stop: watch::Receiver<bool>,
) {
    let (ending, mut supervisors) = (watch::Sender::new(false), JoinSet::new());
    let network = HostNetwork::open(state.network_changes.clone()).inspect_err(|error| {
        tracing::warn!(%error, "the kernel does not say when the network changes; links that are lost by that are \
                                made anew after seconds");
    });
    let network = network.ok().map(Arc::new);
    let run = unix_nanos();
    for (lane, config) in (0..).zip(links) {
        let (identity, home) = ((state.identity.clone(), run), state.home.clone());
        let dialler = Dialler::new(identity, home, lane, config, rekey, network.clone());
        let supervisor =
            Supervisor { state: state.clone(), lane, dialler, expedite: ExpediteToken::default(), reason_known: false };
        supervisors.spawn(supervisor.run(timeout, first.clone(), ending.subscribe()));
    }
    drop(first);
    tokio::select! {
        () = update_rib(&state, updates) => {}
        () = state.keep() => {}
        _ = stop.wait_for(|stop| *stop) => {}
    }
    state.close();
    state.revoked.save();
    state.commands.send(Command::Stop);
    state.send_path.shut();
    ending.send_replace(true);
    while supervisors.join_next().await.is_some() {}
}

struct Supervisor {
    state: Arc<State>,
    lane: u8,
    dialler: Dialler,
    expedite: ExpediteToken,
    /// The switch has told why there is no link.
    reason_known: bool,
}

impl Supervisor {
    fn lane(&self) -> usize {
        self.lane.into()
    }

    /// Makes the first link within `timeout`. A permanent error is returned at once.
    async fn connect(&mut self, timeout: Duration) -> Result<Arc<Attachment>, NodeError> {
        let mut backoff = BACKOFF;
        let attempts = async {
            loop {
                match self.attempt(None).await {
                    Err(error) if error.may_pass() => {
                        self.still_lost(&error);
                        self.pause(&mut backoff).await;
                    }
                    result => return result,
                }
            }
        };
        let result = tokio::time::timeout(timeout, attempts).await;
        result.unwrap_or_else(|_| match self.state.send_path.links.connection(self.lane()) {
            Connection::Down(reason) => Err(NodeError::Detached(reason)),
            _ => Err(NodeError::Closed),
        })
    }

    /// Runs until `ending` becomes true.
    async fn run(
        mut self,
        timeout: Duration,
        first: mpsc::UnboundedSender<(u8, Result<(), NodeError>)>,
        mut ending: watch::Receiver<bool>,
    ) {
        tokio::select! {
            () = self.supervise(timeout, first) => {}
            _ = ending.wait_for(|ending| *ending) => {}
        }
        if let Some(port) = &self.dialler.port {
            port.close("the node was closed").await;
        }
    }

    async fn supervise(&mut self, timeout: Duration, first: mpsc::UnboundedSender<(u8, Result<(), NodeError>)>) {
        self.wait_for_need().await;
        let connected = self.connect(timeout).await;
        if let Err(error) = &connected {
            self.still_lost(error);
        }
        let (result, connected) = match connected {
            Ok(attachment) => (Ok(()), Some(attachment)),
            Err(error) => (Err(error), None),
        };
        let _ = first.send((self.lane, result));
        drop(first);
        let mut attachment = match connected {
            Some(attachment) => attachment,
            None => self.reconnect(None).await,
        };
        loop {
            let reason = self.serve(attachment.clone()).await;
            if self.is_last_resort() && self.state.send_path.links.is_unneeded(self.lane()) {
                tracing::info!(switch = %self.dialler.target, "a preferred link is up, so the link over TLS is closed");
                self.state.send_path.set_connection(self.lane(), Connection::Down(UNNEEDED.into()));
                attachment = self.reconnect(None).await;
                tracing::info!(switch = %self.dialler.target, "no preferred link is up, so the link over TLS is");
                continue;
            }
            tracing::warn!(switch = %self.dialler.target, %reason, "lost the link to the switch");
            self.reason_known = !attachment.link.fell_silent();
            attachment = if attachment.link.fell_silent() {
                self.state.send_path.set_connection(self.lane(), Connection::Stale(attachment.clone(), reason));
                let stale = StaleLink { attachment, until: Instant::now() + GRACEFUL_RESTART_TIME };
                self.reconnect_while_stale(&stale).await
            } else {
                self.state.send_path.set_connection(self.lane(), Connection::Down(reason));
                self.reconnect(None).await
            };
            tracing::info!(switch = %attachment.link.peer().name, "the link to the switch is back");
        }
    }

    /// Makes a new link. Meanwhile frames leave on the stale link while it is usable.
    async fn reconnect_while_stale(&mut self, stale: &StaleLink) -> Arc<Attachment> {
        let state = self.state.clone();
        let probing = async {
            watch_stale(&state.send_path, &stale.attachment, stale.until).await;
            std::future::pending().await
        };
        tokio::select! {
            attachment = self.reconnect(Some(stale)) => attachment,
            attachment = probing => attachment,
        }
    }

    async fn reconnect(&mut self, stale: Option<&StaleLink>) -> Arc<Attachment> {
        let mut backoff = BACKOFF;
        loop {
            self.pause(&mut backoff).await;
            self.wait_for_need().await;
            match self.attempt(stale).await {
                Ok(attachment) => return attachment,
                Err(error) => {
                    tracing::debug!(switch = %self.dialler.target, %error, "no link to the switch");
                    self.still_lost(&error);
                }
            }
        }
    }

    /// Whether the link is dialled only while no preferred one is up.
    fn is_last_resort(&self) -> bool {
        self.lane > 0 && matches!(self.dialler.target, LinkTarget::Tls { .. })
    }

    /// Waits until the link may be dialled.
    async fn wait_for_need(&self) {
        if self.is_last_resort() {
            self.state.send_path.links.until_needed(self.lane()).await;
        }
    }

    /// Waits before the next attempt, or until the path to the switch differs from that of the last
    /// attempt.
    async fn pause(&mut self, backoff: &mut Backoff) {
        let Self { dialler, expedite, .. } = self;
        expedite.pause(backoff, dialler.news(), dialler.is_blind()).await;
    }

    /// Runs one link until it closes, and returns the reason.
    async fn serve(&self, attachment: Arc<Attachment>) -> String {
        let (state, send_path) = (&self.state, &self.state.send_path);
        let others = send_path.links.slots().len() > 1;
        let _watch = others.then(|| AbortOnDrop(tokio::spawn(watch_silence(send_path.clone(), attachment.clone()))));
        let _upkeep = AbortOnDrop(tokio::spawn(keep_stated(state.clone(), attachment.clone())));
        let _keys = AbortOnDrop(tokio::spawn(attachment.clone().keep_keys()));
        let tunnel = self.dialler.tunnel().map(|tunnel| watch_tunnel(tunnel.ended(), attachment.link.clone()));
        let _tunnel = tunnel.map(|watch| AbortOnDrop(tokio::spawn(watch)));
        let leave = self.is_last_resort().then(|| leave_unneeded(send_path.clone(), attachment.clone()));
        let _leave = leave.map(|leave| AbortOnDrop(tokio::spawn(leave)));
        let outer = self.dialler.outer(attachment.link.addr());
        let Dialler { network, port, through, .. } = &self.dialler;
        let _network = network.clone().zip(port.clone()).map(|(network, port)| {
            let mtu = watch_mtu(network.clone(), port.clone(), attachment.link.clone());
            let moves = watch_moves(send_path.clone(), network, port, (outer, *through), attachment.clone());
            (AbortOnDrop(tokio::spawn(mtu)), AbortOnDrop(tokio::spawn(moves)))
        });
        let (at, home) = (attachment.link.clone(), state.home.clone());
        let _home = AbortOnDrop(tokio::spawn(async move { home.watch(&at).await }));
        let link = &attachment.link;
        loop {
            tokio::select! {
                reason = link.closed() => return reason,
                Some((request, responder)) = link.accept_request() => {
                    tokio::spawn(answer(self.state.clone(), attachment.clone(), request, responder));
                }
            }
        }
    }

    /// Makes a link and attaches.
    async fn attempt(&mut self, stale: Option<&StaleLink>) -> Result<Arc<Attachment>, NodeError> {
        let attachment = self.dial(stale).await?;
        self.state.attach(&attachment).await?;
        self.reason_known = false;
        self.state.counters.links.add(1);
        self.state.send_path.set_connection(self.lane(), Connection::Up(attachment.clone()));
        Ok(attachment)
    }

    /// Publishes why there is no link. A reset replaces no reason that the switch has told.
    /// Switches of earlier releases at times reset a refused link, and give no reason
    /// (`INITIAL_WINDOW` of gdp-link).
    fn still_lost(&mut self, error: &NodeError) {
        let is_reset = matches!(error, NodeError::Link(LinkError::Reset));
        if !(is_reset && self.reason_known) {
            self.state.send_path.still_lost(self.lane(), error.to_string());
            self.reason_known = matches!(error, NodeError::Refused(_) | NodeError::Link(LinkError::Closed(_)));
        }
    }

    /// Makes a link. The switch may send on it after the node has attached, so the node receives on
    /// it before. It also receives on the stale link as long as the switch may send there.
    async fn dial(&mut self, stale: Option<&StaleLink>) -> Result<Arc<Attachment>, NodeError> {
        let (port, candidates) = self.dialler.begin().await?;
        let stale = stale.map(|stale| (stale.attachment.clone(), stale.until.into_std()));
        let mut apart = false;
        loop {
            let link = self.dialler.dial_first(&port, &candidates, apart).await?;
            let attachment = Arc::new(Attachment::new(self.lane, link, self.dialler.path.clone(), &port));
            self.state.commands.send(Command::Attach { attachment: attachment.clone(), stale: stale.clone() });
            if !attachment.link.is_by_pair() {
                return Ok(attachment);
            }
            tokio::select! {
                is_answered = attachment.is_answered(ANSWER) => if is_answered {
                    return Ok(attachment);
                },
                reason = attachment.link.closed() => return Err(LinkError::Closed(reason).into()),
            }
            tracing::warn!(
                to = %attachment.link.addr(),
                "the switch on this host does not answer where it takes frames (a packet filter?); they go through \
                 its daemon"
            );
            attachment.link.close("frames do not reach the switch by its pair of interfaces");
            apart = true;
        }
    }
}
