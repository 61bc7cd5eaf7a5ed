//! Carries a topic from the fabric into a ROS graph. Each remote publisher has a local writer for
//! as long as it exists.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use futures::FutureExt;
use gdp::unstable::{NodeError, Subscription};
use gdp_core::cert::Reading;
use gdp_e2e::seal::Message;
use gdp_wire::Name;
use tokio::time::MissedTickBehavior;

use super::format::Inbound;
use super::local::{Local, Made};
use super::locals::{Locals, Whose};
use super::{Route, Way, direct};
use crate::graph::Graph;
use crate::node_name::local_node;
use crate::peer_proxies::Candidate;
use crate::qos_mapping::subscribe_options;
use crate::ros2::{Qos, TypeName};
use crate::route_status::{RETRY, Right, RouteError, ended_because, ticks};
use crate::stats::{Drop, FabricCounters};
use gdp_ros::roster::{Change, Dialect, Incoming, Kind, Offer, RosterEvent};
use gdp_ros::types::Form;

const NOT_SAID: &str = "its writer does not say of what it is";

/// How often the route checks whether subscribers have matched a new writer.
const LOOK_FOR_SUBSCRIBERS: Duration = Duration::from_millis(20);

/// Bound on the queued messages that the route reads before it checks which publishers fell silent.
const WAITING: usize = 256;

/// The remote publishers and their local writers.
struct In<'a> {
    graph: &'a Graph,
    own: Name,
    candidate: &'a Candidate,
    /// The topic's name in the publishers' graphs, as the name card states it.
    listed: Option<&'a str>,
    /// The type, from the name card or the configuration.
    kind: Option<&'a TypeName>,
    incoming: Incoming,
    locals: Locals,
    /// The incompatible QoS of a local subscriber, if there is one.
    misfit: Option<String>,
    /// Whether the direct path has the current writers.
    is_direct: bool,
}

impl Route {
    pub(super) async fn run_in(&self, way: &Way<'_>, right: &mut Right<Reading>) -> Result<Infallible, RouteError> {
        let Way { graph, node, kind, card, candidate } = *way;
        let (incoming, locals) = (Incoming::default(), Locals::new(Instant::now()));
        let listed = card.get("topic");
        let mut to =
            In { graph, own: node.name(), candidate, listed, kind, incoming, locals, misfit: None, is_direct: false };
        let mut pause = RETRY;
        loop {
            let error = match node.subscribe(card.proof(), right.current(), subscribe_options(&self.config)).await {
                Ok(mut subscription) => {
                    *self.fabric() = FabricCounters::In(subscription.meter());
                    pause = RETRY;
                    self.is_up(candidate);
                    self.carry_in(&mut to, &mut subscription, right).await?
                }
                Err(error) => error,
            };
            // Without a subscription, the remote publishers are unknown.
            let changes = to.incoming.clear();
            self.change(&mut to, changes).await;
            self.pause(error, &mut pause, right, candidate).await;
        }
    }

    /// Carries messages until the right to read ends, and returns the reason.
    async fn carry_in(
        &self,
        to: &mut In<'_>,
        subscription: &mut Subscription,
        right: &mut Right<Reading>,
    ) -> Result<NodeError, RouteError> {
        let mut ticks = ticks();
        let mut looks = tokio::time::interval(LOOK_FOR_SUBSCRIBERS);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        to.is_direct = false;
        loop {
            if !std::mem::replace(&mut to.is_direct, true) {
                subscription.set_sink(Some(self.direct_in(to).into_sink()));
            }
            let is_busy = to.locals.is_busy();
            let received = tokio::select! {
                // Biased, so that arriving messages do not starve the timers.
                biased;
                _ = looks.tick(), if is_busy => {
                    self.look(to).await;
                    continue;
                }
                _ = ticks.tick() => {
                    self.route_status.renew(right, async |new| subscription.renew(new).await).await;
                    // Rosters that wait in the queue are read first: their writers are not silent,
                    // this proxy was late.
                    for _ in 0..WAITING {
                        let next = tokio::task::unconstrained(subscription.recv());
                        let Some(Some(message)) = next.now_or_never() else { break };
                        self.take(to, message).await;
                    }
                    for (whose, local) in to.locals.all() {
                        let written = local.made_mut().and_then(|made| made.last_write());
                        if let (Some((writer, _)), Some(at)) = (whose, written) {
                            to.incoming.refresh(writer, at);
                        }
                    }
                    for event in to.incoming.poll(Instant::now()) {
                        self.on_event(to, event).await;
                    }
                    to.misfit = self.misfit(to);
                    self.look(to).await;
                    continue;
                }
                received = subscription.recv() => received,
            };
            match received {
                Some(message) => self.take(to, message).await,
                None => return ended_because(subscription.ended().await),
            }
        }
    }

    /// Returns the direct path of messages to the present writers.
    fn direct_in(&self, to: &mut In<'_>) -> direct::Inward {
        let In { locals, incoming, .. } = to;
        let direct = locals.all().filter_map(|(whose, local)| {
            let (writer, number) = (*whose)?;
            let session = incoming.session(&writer, number)?;
            Some(((writer, session, number), local.direct(&self.types)?))
        });
        direct::Inward { locals: direct.collect(), siblings: to.candidate.siblings(), counters: self.counters.clone() }
    }

    async fn take(&self, to: &mut In<'_>, message: Message) {
        if message.writer == to.own {
            return self.drop(Drop::Own, "this proxy wrote it");
        }
        if to.candidate.is_twin(Instant::now(), &message.writer) {
            return self.drop(Drop::Own, "another proxy of the same ROS graph wrote it");
        }
        for event in to.incoming.receive(Instant::now(), message) {
            self.on_event(to, event).await;
        }
    }

    async fn on_event(&self, to: &mut In<'_>, event: RosterEvent) {
        match event {
            RosterEvent::Changes(changes) => self.change(to, changes).await,
            RosterEvent::Message(number, message) => self.write(to, Some((message.writer, number)), message).await,
            RosterEvent::Plain(message) => {
                if to.locals.get(&None).is_none() {
                    to.locals.insert(None, plain(to.kind));
                    self.make(to).await;
                }
                self.write(to, None, message).await;
            }
            RosterEvent::Unannounced(messages) => self.drop_all(Drop::Unannounced, messages as u64, NOT_SAID),
            RosterEvent::Malformed(writer, error) => self.drop(Drop::Malformed, format_args!("{writer:#}: {error}")),
        }
    }

    async fn change(&self, to: &mut In<'_>, changes: Vec<Change>) {
        if changes.is_empty() {
            return;
        }
        to.is_direct = false;
        for mut change in changes {
            if let Change::Joined { node, .. } = &mut change {
                *node = local_node(&self.config.topic, to.listed, node).into();
            }
            if !to.locals.change(Instant::now(), change) {
                tracing::warn!(topic = %self.config.topic, "more publishers elsewhere than have a counterpart here");
            }
        }
        self.trim(to);
        self.make(to).await;
        self.show(to);
    }

    /// Does the periodic work: creates due writers, writes messages that need not wait any longer,
    /// and drops writers whose time is over.
    async fn look(&self, to: &mut In<'_>) {
        to.is_direct = false;
        self.make(to).await;
        let now = Instant::now();
        for made in to.locals.made() {
            for (reason, why) in made.look(&self.types, &self.counters, now).await {
                self.drop(reason, why);
            }
        }
        to.locals.sweep(now);
        self.show(to);
    }

    /// Creates the writers that are due.
    async fn make(&self, to: &mut In<'_>) {
        for whose in to.locals.due(Instant::now()) {
            let Some(local) = to.locals.get(&whose) else { continue };
            let made = self.try_to_make(to.graph, to.kind, local).await;
            let history = match made {
                Ok(made) => local.made(made),
                Err(why) => {
                    tracing::warn!(topic = %self.config.topic, "{}", no_counterpart(&whose, &why));
                    local.failed(Instant::now(), why);
                    continue;
                }
            };
            for message in history {
                self.write_to(local, message).await;
            }
            self.trim(to);
        }
    }

    async fn try_to_make(&self, graph: &Graph, stated: Option<&TypeName>, local: &Local) -> Result<Made, String> {
        let Local { kind, definition, offers, .. } = local;
        if kind.name.is_empty() {
            return Err("it does not say of what type its messages are; state it as `type`".into());
        }
        let form = Form { kind, definition: definition.as_deref(), encoding: kind.dialect.native() };
        let found = self.types.counterpart(&form, graph.dialect()).map_err(|error| error.to_string())?;
        let (here, text) = found;
        if let Some(stated) = stated.filter(|stated| graph.kind(stated).name != here.name) {
            return Err(format!("it publishes {}, and the topic is of {stated}", kind.name));
        }
        let (kinds, definitions) = ((kind.clone(), here.clone()), (definition.clone(), text.clone()));
        let format = Inbound::new(&self.types, kinds, definitions, self.config.frame_prefix.clone());
        let format = format.map_err(|error| error.to_string())?;
        let offers = self.config.qos.map_or(*offers, Offer::from);
        let writer = graph.writer(&self.types, &self.config.topic, &here, text.as_deref(), offers);
        let mut writer = writer.await.map_err(|error| error.to_string())?;
        if !local.node.is_empty() {
            writer.assign(&local.node);
        }
        self.route_status.set_kind(&here.name);
        Ok(Made::new(Instant::now(), writer, offers, format))
    }

    async fn write(&self, to: &mut In<'_>, whose: Whose, message: Message) {
        let Some(local) = to.locals.get(&whose) else {
            return self.drop(Drop::NoCounterpart, "there are too many publishers elsewhere");
        };
        local.keep(&message);
        self.write_to(local, message).await;
        if local.bytes() > 0 {
            self.trim(to);
        }
    }

    /// Drops the oldest messages if all publishers together hold too many bytes.
    fn trim(&self, to: &mut In<'_>) {
        let gone = to.locals.trim();
        self.drop_all(
            Drop::Crowded,
            gone,
            "what the topic's publishers latch, or what waits for subscribers, is too much together",
        );
    }

    async fn write_to(&self, local: &mut Local, message: Message) {
        self.counters.arrival.record_since(message.timestamp_ns);
        let result = match local.made_mut() {
            Some(made) => made.take(&self.types, &self.counters, message).await,
            None => Err((Drop::NoCounterpart, "its publisher has no counterpart here".into())),
        };
        if let Err((reason, why)) = result {
            self.drop(reason, why);
        }
    }

    fn misfit(&self, to: &mut In<'_>) -> Option<String> {
        let graph = to.graph;
        to.locals.offers().find_map(|(whose, offers)| {
            let policy = graph.misfit(&self.config.topic, &offers)?;
            Some(format!("incompatible QoS: a subscriber here asks for more in {policy} than {} offers", name(&whose)))
        })
    }

    /// Shows in the status which publishers have no counterpart or an incompatible subscriber.
    /// Announces to the graph's other proxies whether this one can carry the topic.
    fn show(&self, to: &mut In<'_>) {
        self.publishers_elsewhere.store(to.locals.all().count(), Relaxed);
        to.candidate.set_permitted(!to.locals.are_hopeless());
        let mut faults: Vec<_> = to.locals.faults().map(|(whose, why)| no_counterpart(whose, why)).collect();
        faults.extend(to.misfit.clone());
        match &faults[..] {
            [] => self.route_status.set_status("up"),
            [only] => self.route_status.set_status(only),
            [first, rest @ ..] => self.route_status.set_status(&format!("{first}; and {} more", rest.len())),
        }
    }
}

/// Returns the writer for publishers of which only the configuration is known.
fn plain(kind: Option<&TypeName>) -> Local {
    let name = kind.map_or_else(String::new, ToString::to_string);
    let kind = Kind { dialect: Dialect::Ros2, name, hash: vec![] };
    Local::new(kind, None, Arc::default(), Qos::default().into())
}

fn no_counterpart(whose: &Whose, why: &str) -> String {
    format!("{} has no counterpart here: {why}", name(whose))
}

fn name(whose: &Whose) -> String {
    match whose {
        Some((writer, number)) => format!("publisher {number} of {writer:#}"),
        None => "a writer elsewhere".into(),
    }
}
