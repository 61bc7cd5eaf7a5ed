//! Keeps one link of the node: makes it, attaches, states again what the application wants stated,
//! answers the switch, and begins anew when the link is lost, or at once when this machine is in
//! another network. The application's handles never notice but for what was lost. [`run`] keeps all
//! links of a node.

use crate::node::abort_on_drop::AbortOnDrop;
use crate::node::attachment::Attachment;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use gdp_wire::{Header, Name};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until, timeout_at};

use super::choice::Pulse;
use super::lane::{LinkSlot, Status};
use super::network::{Network, NetworkPath, until_led};
use super::pause::{BACKOFF, ExpediteToken, wait};
use super::receiver::Command;
use super::send_path::SwitchLinks;
use super::state::{self, State};
use super::{LinkConfig, LinkTarget, NodeError, Stated};
use gdp_core::cert::{Revocation, Signed};
use gdp_core::crypto;
use gdp_core::name::NameProof;
use gdp_core::peer::{GRACEFUL_RESTART_TIME, Role};
use gdp_link::link::{Link, LinkError, RekeySchedule, Responder};
use gdp_link::port::{Interface, LinkAddr, Port, PortConfig, interface_index};
use gdp_proto::control::{Refusal, RefusalCode, Request, Response};
use gdp_util::backoff::Backoff;

/// How long a switch may take to answer discovery.
const DISCOVERY: Duration = Duration::from_secs(2);

/// Answers to discovery that are tried before it is asked again.
const MAX_CANDIDATES: usize = 8;

/// How long a switch on the same host may take to answer the first frame; any, over UDP, once this
/// machine is in another network, and four round trips.
const ANSWER: Duration = Duration::from_millis(500);

/// The same of a switch on a cable.
const ANSWER_ON_CABLE: Duration = Duration::from_millis(100);

/// How long the node tries to attach again over the link it has; the switch waits a little longer
/// for its answer.
const REATTACH: Duration = Duration::from_secs(4);

/// How often certificates and statements with a lifetime of [`state::LIFETIME`] are renewed.
const RENEWAL: Duration = Duration::from_secs(state::LIFETIME as u64 / 3);

/// Between two echoes, or a round trip if that is longer: on the main link, and on others.
const MAIN_ECHOES: Duration = Duration::from_millis(100);
const OTHER_ECHOES: Duration = Duration::from_millis(500);

/// What the rest of the node tells the supervisor.
pub enum Event {
    /// A publisher or subscription was dropped.
    Withdraw { name: Name, stated: Stated },
    /// The RIB does not know this revocation.
    Revoke { proof: NameProof, revocation: Signed<Revocation> },
}

/// A link whose switch fell silent, in use until then at the latest.
struct Held {
    attachment: Arc<Attachment>,
    until: Instant,
}

impl Held {
    /// Returns when the link is of no use any more, and says why.
    async fn end(&self) -> &'static str {
        match timeout_at(self.until, self.attachment.until_silent()).await {
            Ok(()) => "its data plane does not answer either",
            Err(_) => "its daemon has been silent for too long",
        }
    }
}

/// Keeps the links of a node until `stop` becomes true, or none could be made in the time that each
/// had for its first. Says through `first` what came of that, by the number of the link.
pub async fn run(
    state: Arc<State>,
    links: Vec<LinkConfig>,
    rekey: RekeySchedule,
    patience: Duration,
    events: mpsc::UnboundedReceiver<Event>,
    first: mpsc::UnboundedSender<(u8, Result<(), NodeError>)>,
    mut stop: watch::Receiver<bool>,
) {
    let (ending, mut supervisors) = (watch::Sender::new(false), JoinSet::new());
    let network = Network::open().inspect_err(|error| {
        tracing::warn!(%error, "the kernel does not say when the network changes; links that are lost by that are \
                                made anew after seconds");
    });
    let network = network.ok().map(Arc::new);
    for (lane, config) in (0..).zip(links) {
        let supervisor = Supervisor::new(state.clone(), lane, config, rekey, network.clone());
        supervisors.spawn(supervisor.run(patience, first.clone(), ending.subscribe()));
    }
    drop(first);
    tokio::select! {
        () = handle_all(&state, events) => {}
        () = state.keep() => {}
        _ = stop.wait_for(|stop| *stop) => {}
    }
    state.close();
    state.revoked.save();
    // In this order: the thread is woken through a link.
    state.command(Command::Stop);
    state.send_path.stop();
    state.send_path.shut();
    ending.send_replace(true);
    while supervisors.join_next().await.is_some() {}
}

struct Supervisor {
    state: Arc<State>,
    lane: u8,
    target: LinkTarget,
    pinned: Option<Name>,
    port_config: PortConfig,
    port: Option<Arc<Port>>,
    /// Index of the interface that a UDP port is bound to.
    through: Option<u32>,
    network: Option<Arc<Network>>,
    /// Of the network, since the last attempt began.
    changes: Option<watch::Receiver<()>>,
    /// What the host of a UDP target was resolved to last, unless it was not.
    address: Option<SocketAddr>,
    /// How the switch was reached when that was last looked at.
    way: NetworkPath,
    hurry: ExpediteToken,
}

impl Supervisor {
    fn new(
        state: Arc<State>,
        lane: u8,
        config: LinkConfig,
        rekey: RekeySchedule,
        network: Option<Arc<Network>>,
    ) -> Self {
        let LinkConfig { target, switch: pinned, .. } = config;
        let through = if let LinkTarget::Udp { interface, .. } = &target { interface.clone() } else { None };
        let papers = state.home.shown.clone();
        let port_config = PortConfig { rekey, lane, through, papers, ..PortConfig::endpoint(state.identity.clone()) };
        let changes = network.as_ref().map(|network| network.changes());
        let (port, through, address, way, hurry) = (None, None, None, NetworkPath::Unknown, ExpediteToken::default());
        Self { state, lane, target, pinned, port_config, port, through, network, changes, address, way, hurry }
    }

    fn lane(&self) -> &LinkSlot {
        &self.state.send_path.lanes()[usize::from(self.lane)]
    }

    /// The first link, within `patience`. What waiting cannot mend is an error at once.
    async fn connect(&mut self, patience: Duration) -> Result<Arc<Attachment>, NodeError> {
        let mut backoff = BACKOFF;
        let attempts = async {
            loop {
                match self.attempt(None).await {
                    Err(error) if error.may_pass() => {
                        self.state.still_lost(self.lane(), error.to_string());
                        self.pause(&mut backoff).await;
                    }
                    result => return result,
                }
            }
        };
        let result = tokio::time::timeout(patience, attempts).await;
        result.unwrap_or_else(|_| match self.lane().status() {
            Status::Down(reason) => Err(NodeError::Detached(reason)),
            _ => Err(NodeError::Closed),
        })
    }

    /// Runs until `ending` becomes true. The only link of a node has to be made in time.
    async fn run(
        mut self,
        patience: Duration,
        first: mpsc::UnboundedSender<(u8, Result<(), NodeError>)>,
        mut ending: watch::Receiver<bool>,
    ) {
        tokio::select! {
            () = self.supervise(patience, first) => {}
            _ = ending.wait_for(|ending| *ending) => {}
        }
        if let Some(port) = &self.port {
            port.close("the node was closed").await;
        }
    }

    async fn supervise(&mut self, patience: Duration, first: mpsc::UnboundedSender<(u8, Result<(), NodeError>)>) {
        let connected = self.connect(patience).await;
        if let Err(error) = &connected {
            self.state.still_lost(self.lane(), error.to_string());
        }
        let (told, connected) = match connected {
            Ok(attachment) => (Ok(()), Some(attachment)),
            Err(error) => (Err(error), None),
        };
        let _ = first.send((self.lane, told));
        drop(first);
        let mut attachment = match connected {
            Some(attachment) => attachment,
            None => self.reconnect(None).await,
        };
        loop {
            let reason = self.serve(attachment.clone()).await;
            tracing::warn!(switch = %self.target, %reason, "lost the link to the switch");
            attachment = if attachment.link.fell_silent() {
                self.state.send_path.set_status(self.lane(), Status::Held(attachment.clone(), reason));
                let held = Held { attachment, until: Instant::now() + GRACEFUL_RESTART_TIME };
                self.reconnect_while_held(&held).await
            } else {
                self.state.send_path.set_status(self.lane(), Status::Down(reason));
                self.reconnect(None).await
            };
            tracing::info!(switch = %attachment.link.peer().name, "the link to the switch is back");
        }
    }

    /// A new link. What the application sends in the meantime goes out on the one that is held, as
    /// long as that is of use.
    async fn reconnect_while_held(&mut self, held: &Held) -> Arc<Attachment> {
        let (state, lane) = (self.state.clone(), usize::from(self.lane));
        let hold = async {
            let reason = held.end().await;
            tracing::warn!("nothing is sent to the switch any more: {reason}");
            state.end_hold(&state.send_path.lanes()[lane]);
            std::future::pending().await
        };
        tokio::select! {
            attachment = self.reconnect(Some(held)) => attachment,
            attachment = hold => attachment,
        }
    }

    async fn reconnect(&mut self, held: Option<&Held>) -> Arc<Attachment> {
        let mut backoff = BACKOFF;
        loop {
            self.pause(&mut backoff).await;
            match self.attempt(held).await {
                Ok(attachment) => return attachment,
                Err(error) => {
                    tracing::debug!(switch = %self.target, %error, "no link to the switch");
                    self.state.still_lost(self.lane(), error.to_string());
                }
            }
        }
    }

    /// Waits before the next attempt; not if the switch is reached in another way than at the last
    /// one.
    async fn pause(&mut self, backoff: &mut Backoff) {
        let mut hurry = std::mem::take(&mut self.hurry);
        hurry.pause(backoff, self.news(), self.is_blind()).await;
        self.hurry = hurry;
    }

    /// Whether nobody knows to where there should be a way.
    fn is_blind(&self) -> bool {
        matches!(self.target, LinkTarget::Udp { .. }) && self.address.is_none()
    }

    /// Returns when the network is such that another attempt may do better than the last.
    async fn news(&self) {
        let (Some(network), Some(changes)) = (&self.network, &self.changes) else {
            return std::future::pending().await;
        };
        if !self.is_blind() {
            return until_led(changes.clone(), self.way.clone(), || self.look(network)).await;
        }
        // Whatever it is, it may be the way to who knows the address.
        if changes.clone().changed().await.is_err() {
            std::future::pending().await
        }
    }

    /// How the switch would be reached now.
    async fn look(&self, network: &Network) -> NetworkPath {
        match &self.target {
            LinkTarget::Ethernet { interface, .. } => match interface_index(interface) {
                Ok(ifindex) => network.way(LinkAddr::Ethernet { ifindex, mac: [0; 6] }, None).await,
                Err(_) => NetworkPath::Nowhere,
            },
            LinkTarget::Udp { interface, .. } => match interface.as_deref().map(interface_index).transpose() {
                Ok(through) => match self.address {
                    Some(to) => network.way(LinkAddr::udp(to), through).await,
                    None => NetworkPath::Unknown,
                },
                Err(_) => NetworkPath::Nowhere,
            },
        }
    }

    /// One link's life; returns why it ended.
    async fn serve(&self, attachment: Arc<Attachment>) -> String {
        let others = self.state.send_path.lanes().len() > 1;
        let _watch = others.then(|| AbortOnDrop(tokio::spawn(watch_silence(self.state.clone(), attachment.clone()))));
        let _upkeep = AbortOnDrop(tokio::spawn(keep_stated(self.state.clone(), attachment.clone())));
        let _keys = AbortOnDrop(tokio::spawn(attachment.clone().keep_keys()));
        let moves =
            self.network.clone().zip(self.port.clone()).map(|(network, port)| {
                watch_moves(self.state.clone(), network, port, self.through, attachment.clone())
            });
        let _moves = moves.map(|moves| AbortOnDrop(tokio::spawn(moves)));
        let (watched, state) = (attachment.link.clone(), self.state.clone());
        let _home = AbortOnDrop(tokio::spawn(async move { state.home.watch(&watched).await }));
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

    /// Makes a link and attaches: from then on the switch may send on it, so frames are taken on it
    /// before. Those on the link that is held are taken for as long as the switch may send them.
    async fn attempt(&mut self, held: Option<&Held>) -> Result<Arc<Attachment>, NodeError> {
        self.changes.as_mut().into_iter().for_each(watch::Receiver::mark_unchanged);
        if let Some(network) = self.network.clone() {
            self.way = self.look(&network).await;
        }
        let (port, candidates) = self.locate().await?;
        let held = held.map(|held| (held.attachment.clone(), held.until.into_std()));
        let mut apart = false;
        let attachment = loop {
            let link = self.dial_first(&port, &candidates, apart).await?;
            let attachment = Arc::new(Attachment::new(self.lane, link, self.way.clone(), &port));
            self.state.command(Command::Attach { attachment: attachment.clone(), held: held.clone() });
            if !attachment.link.is_by_pair() || attachment.is_answered(ANSWER).await {
                break attachment;
            }
            tracing::warn!(
                to = %attachment.link.addr(),
                "the switch on this host does not answer where it takes frames (a packet filter?); they go through \
                 its daemon"
            );
            attachment.link.close("frames do not reach the switch by its pair of interfaces");
            apart = true;
        };
        self.state.attach(&attachment).await?;
        self.state.counters.links.add(1);
        self.state.send_path.set_status(self.lane(), Status::Up(attachment.clone()));
        Ok(attachment)
    }

    /// Anybody on the segment can answer discovery in the name of the switch: the first that proves
    /// to be it counts. `apart`: frames are to go through the daemon even of a switch on this host.
    async fn dial_first(
        &mut self,
        port: &Port,
        candidates: &[(LinkAddr, Option<Name>)],
        apart: bool,
    ) -> Result<Link, NodeError> {
        let mut failure = None;
        for (to, expected) in candidates.iter().take(MAX_CANDIDATES) {
            let dialling = async {
                match apart {
                    false => port.dial(*to, *expected).await,
                    true => port.dial_apart(*to, *expected).await,
                }
            };
            let dialled = match self.network.clone() {
                Some(network) => {
                    self.way = network.way(*to, self.through).await;
                    tokio::select! {
                        dialled = dialling => dialled,
                        // What went to the old network is not answered: better begun anew than said
                        // again later.
                        _ = network.until_other(*to, self.through, &self.way) => {
                            // However it is reached by now, that has not been tried: the pause is
                            // to take it for news.
                            self.way = NetworkPath::Nowhere;
                            return Err(NodeError::Detached("the network of this machine has changed".into()));
                        }
                    }
                }
                None => dialling.await,
            };
            match dialled {
                Ok(link) if link.peer().role == Role::Switch => match self.state.home.judge(&link) {
                    Ok(_) => return Ok(link),
                    Err(error) => {
                        link.close(&error.to_string());
                        failure = Some(error.into());
                    }
                },
                Ok(_) => failure = Some(NodeError::NotASwitch(*to)),
                Err(error) => failure = Some(error.into()),
            }
        }
        let discovered = matches!(self.target, LinkTarget::Ethernet { mac: None, .. });
        Err(match failure {
            Some(error) if discovered => NodeError::NoSwitch(Box::new(error)),
            Some(error) => error,
            None => NodeError::Protocol("to discovery"),
        })
    }

    /// A port to dial from, and whom to dial. Opens another port if the interface is not the one it
    /// was.
    async fn locate(&mut self) -> Result<(Arc<Port>, Vec<(LinkAddr, Option<Name>)>), NodeError> {
        match &self.target {
            LinkTarget::Ethernet { interface, mac } => {
                let same = |found: &Interface, port: &Port| {
                    port.interface()
                        .is_some_and(|open| (open.index, open.mac, open.mtu) == (found.index, found.mac, found.mtu))
                };
                let found = Interface::find(interface).map_err(|source| no_interface(interface, source))?;
                let port = match self.port.take().filter(|port| same(&found, port)) {
                    Some(port) => port,
                    None => Arc::new(Port::ethernet(interface, &self.port_config)?),
                };
                self.port = Some(port.clone());
                if let Some(mac) = *mac {
                    return Ok((port, vec![(LinkAddr::Ethernet { ifindex: found.index, mac }, self.pinned)]));
                }
                let answers = port.discover(self.pinned, DISCOVERY).await;
                if answers.is_empty() {
                    let wanted = self.pinned.map_or("a switch".to_owned(), |name| format!("switch {name:#}"));
                    return Err(NodeError::NoAnswer { interface: interface.clone(), wanted });
                }
                Ok((port, answers.into_iter().map(|(to, name)| (to, Some(name))).collect()))
            }
            LinkTarget::Udp { host, port: number, interface } => {
                // Before a port is opened: if it is made anew meanwhile, the next attempt finds
                // out.
                let index = match interface {
                    Some(name) => Some(interface_index(name).map_err(|source| no_interface(name, source))?),
                    None => None,
                };
                let no_address = |source| NodeError::NoAddress { host: host.clone(), source };
                self.address = None;
                let mut found = tokio::net::lookup_host((host.as_str(), *number)).await.map_err(no_address)?;
                let to = found.next().ok_or_else(|| no_address(std::io::ErrorKind::AddrNotAvailable.into()))?;
                self.address = Some(to);
                let same = |port: &Arc<Port>| {
                    self.through == index && port.udp_addr().is_some_and(|open| open.is_ipv4() == to.is_ipv4())
                };
                let port = match self.port.take().filter(same) {
                    Some(port) => port,
                    None => {
                        let any =
                            if to.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
                        Arc::new(Port::udp(SocketAddr::new(any, 0), &self.port_config)?)
                    }
                };
                (self.port, self.through) = (Some(port.clone()), index);
                Ok((port, vec![(LinkAddr::udp(to), self.pinned)]))
            }
        }
    }
}

fn no_interface(name: &str, source: std::io::Error) -> LinkError {
    LinkError::Io { what: format!("interface {name}"), source }
}

/// States what stands, again when something was refused that time may mend or a withdrawal took it
/// along, and in time before it runs out.
async fn keep_stated(state: Arc<State>, attachment: Arc<Attachment>) {
    let mut backoff = BACKOFF;
    let mut renewal = Instant::now() + RENEWAL;
    let (lane, mut preferred) = (state.send_path.lane(&attachment), None);
    loop {
        let turn = {
            let SwitchLinks { main, turn, .. } = *state.send_path.ways().borrow();
            (main == usize::from(attachment.lane)).then_some(turn)
        };
        if turn.is_some() && turn != preferred {
            if !prefer(&state, &attachment).await {
                wait(&mut backoff).await;
                continue;
            }
            preferred = turn;
        }
        if !state.state_all(&attachment).await {
            wait(&mut backoff).await;
            continue;
        }
        backoff = BACKOFF;
        tokio::select! {
            () = lane.unstated.notified() => {}
            () = sleep_until(renewal) => {
                renewal = Instant::now() + RENEWAL;
                if let Err(error) = state.attach(&attachment).await {
                    tracing::warn!(%error, "could not renew the attachment");
                }
            }
        }
    }
}

/// The switch, if another link leads there as well, is to send on this one what is to come on one.
/// Whether it heard that.
async fn prefer(state: &State, attachment: &Attachment) -> bool {
    if state.send_path.lanes().len() == 1 {
        return true;
    }
    let answer = attachment.link.request(&Request::Ready).await;
    answer.inspect_err(|error| tracing::debug!(%error, "the switch did not hear that this is the main link")).is_ok()
}

/// Finds out whether the switch answers, so that another link is used at once when it does not, as
/// long as this one is up.
async fn watch_silence(state: Arc<State>, attachment: Arc<Attachment>) {
    let (send_path, number) = (&state.send_path, usize::from(attachment.lane));
    let (lane, mut pulse) = (send_path.lane(&attachment), Pulse::default());
    loop {
        let cookie = crypto::random().map_or(0, u64::from_le_bytes);
        lane.set_silent(pulse.beat(attachment.answer.load(Ordering::Relaxed), cookie));
        attachment.send(Header::echo(cookie));
        send_path.choose(false);
        let pause = if send_path.ways().borrow().main == number { MAIN_ECHOES } else { OTHER_ECHOES };
        sleep(pause.max(attachment.link.rtt())).await;
    }
}

/// Has other links used once the switch is reached in another way than when the link was made,
/// until it answers again. If it is reached but does not answer, the link ends.
async fn watch_moves(
    state: Arc<State>,
    network: Arc<Network>,
    port: Arc<Port>,
    through: Option<u32>,
    attachment: Arc<Attachment>,
) {
    let (lane, link) = (state.send_path.lane(&attachment), &attachment.link);
    let patience = match link.addr() {
        LinkAddr::Udp(_) => ANSWER,
        LinkAddr::Ethernet { .. } => ANSWER_ON_CABLE,
    };
    let mut way = attachment.way.clone();
    loop {
        way = network.until_other(link.addr(), through, &way).await;
        lane.set_moved(true);
        state.send_path.choose(false);
        let answered = async {
            if way == NetworkPath::Nowhere {
                // Wi-Fi may be back in a moment.
                std::future::pending::<()>().await;
            }
            if let Err(error) = port.show_address() {
                tracing::debug!(%error, "the switch is not shown the new address");
            }
            attachment.is_answered(patience + 4 * link.rtt()).await
        };
        tokio::select! {
            answered = answered => {
                if !answered {
                    return link.close("this machine is in another network, from which the switch does not answer");
                }
                lane.set_moved(false);
                state.send_path.choose(false);
            }
            // From the top, with what is true by then.
            _ = network.until_other(link.addr(), through, &way) => {}
        }
    }
}

/// Answers what the switch asks.
async fn answer(state: Arc<State>, attachment: Arc<Attachment>, request: Request, responder: Responder) {
    let response = match request {
        Request::Peers(push) if push.entity == state.identity.name() => {
            match state.take_peers(push.name, push.role, &push.peers) {
                Some(Ok(())) => Response::Done,
                Some(Err(error)) => Refusal::new(RefusalCode::Malformed, error.to_string()).into(),
                None => Refusal::new(RefusalCode::NotFound, format!("no {} of {} here", push.role, push.name)).into(),
            }
        }
        Request::Costs(costs) => {
            attachment.reported_costs.store(true, Ordering::Relaxed);
            state.set_costs(attachment.lane, costs);
            Response::Done
        }
        // The RIB has forgotten what was stated, as after a restart. Frames go on meanwhile.
        Request::Detach { entity, .. } if entity == state.identity.name() => {
            match tokio::time::timeout(REATTACH, attach_again(&state, &attachment)).await {
                Ok(Ok(())) => Response::Done,
                Ok(Err(error)) => Refusal::new(RefusalCode::NotAttached, error.to_string()).into(),
                Err(_) => Refusal::new(RefusalCode::Unreachable, "the RIB did not answer").into(),
            }
        }
        Request::Papers(papers) => match state.home.take_credentials(&attachment.link, *papers) {
            Ok(()) => Response::Done,
            Err(error) => Refusal::new(RefusalCode::NotEntitled, error.to_string()).into(),
        },
        Request::DomainRevoked { proof, revocation } => match state.home.take_revocation(&proof, &revocation) {
            Ok(news) => {
                news.iter().for_each(|claims| state.domain_revoked(claims));
                Response::Done
            }
            Err(error) => Refusal::new(RefusalCode::ReplayedSerial, error.to_string()).into(),
        },
        _ => Refusal::new(
            RefusalCode::Unsupported,
            "an endpoint is told about its counterparts, its attachment and what paths cost only",
        )
        .into(),
    };
    let _ = responder.respond(response).await;
}

/// Attaches over the link there is, and has everything stated again. The switch may only be about
/// to find its way to the RIB.
async fn attach_again(state: &State, attachment: &Attachment) -> Result<(), NodeError> {
    let mut backoff = BACKOFF;
    while let Err(error) = state.attach(attachment).await {
        if !error.may_pass() || attachment.link.close_reason().is_some() {
            return Err(error);
        }
        wait(&mut backoff).await;
    }
    state.send_path.lane(attachment).unstated.notify_one();
    Ok(())
}

/// Has what the rest of the node says done over the main link, once there is one.
async fn handle_all(state: &Arc<State>, mut events: mpsc::UnboundedReceiver<Event>) {
    while let Some(event) = events.recv().await {
        let attachment = loop {
            match state.attached().await {
                Ok(attachment) => break attachment,
                Err(NodeError::Closed) => return,
                Err(_) => {}
            }
        };
        tokio::spawn(handle(state.clone(), attachment, event));
    }
}

async fn handle(state: Arc<State>, attachment: Arc<Attachment>, event: Event) {
    match event {
        Event::Withdraw { name, stated } => {
            let mut backoff = BACKOFF;
            while let Err(error) = state.state_withdrawal(&attachment, name, stated).await {
                match error {
                    // It went with an attachment that ended.
                    NodeError::Refused(refusal) if refusal.code == RefusalCode::NotFound => return,
                    // What was stated may outlive the link: that is for the next one to tell.
                    NodeError::Detached(_) => return state.withdraw_later(name, stated),
                    _ if attachment.link.close_reason().is_some() => return state.withdraw_later(name, stated),
                    error => tracing::warn!(%name, %error, "could not be withdrawn; trying again"),
                }
                wait(&mut backoff).await;
            }
        }
        Event::Revoke { proof, revocation } => {
            if let Err(error) = state.pass_on(&attachment, proof, revocation).await {
                tracing::warn!(%error, "the RIB does not know a revocation, and does not take it");
            }
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/supervisor.rs"]
mod tests;
