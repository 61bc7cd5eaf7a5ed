//! From the fabric into a ROS graph: each publisher elsewhere has a writer here, for as long as it is there.

use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use gdp::cert::Reading;
use gdp::node::{NodeError, Subscription};
use gdp::seal::Message;
use gdp::{Name, NameCard, Node};
use gdp_msg::Encoding;

use super::{RETRY, Route, RouteError, ended_because, ticks};
use crate::delivery::subscribe_options;
use crate::graph::{Graph, WriteError, Writer};
use crate::material::Permission;
use crate::renewal::Renewal;
use crate::ros2::{Qos, TypeName};
use crate::stats::{Drop, FabricCounters};
use gdp_ros::roster::{Change, Incoming, Kind, Offer, ROSTER, Taken};
use gdp_ros::types::{Converter, Form, unsealed};

const NOT_SAID: &str = "its writer does not say of what it is";

/// Counterparts of publishers elsewhere, for one topic. More have none.
const MAX_LOCALS: usize = 512;

/// The right to read, and where it came from.
pub struct Right {
    pub grant: Reading,
    pub file: Renewal,
}

/// What stands in the graph for a publisher elsewhere.
struct Local {
    writer: Writer,
    /// Of the publisher, and the same in this graph.
    kinds: (Kind, Kind),
    definitions: (Option<Arc<str>>, Option<String>),
    /// By what messages are in; nearly always one.
    converters: Vec<(Encoding, Converter)>,
}

/// The publishers elsewhere, as far as they are known.
struct In<'a> {
    graph: &'a Graph,
    own: Name,
    /// Of the name's card or the configuration.
    kind: Option<&'a TypeName>,
    incoming: Incoming,
    /// Not there if it cannot be made, which has been said.
    locals: HashMap<(Name, u32), Option<Local>>,
    /// For writers that tell no publishers apart.
    plain: Option<Option<Local>>,
}

impl Route {
    pub(super) async fn run_in(
        &self,
        graph: &Graph,
        node: &Node,
        kind: Option<&TypeName>,
        card: &NameCard,
        mut right: Right,
    ) -> Result<Infallible, RouteError> {
        let (incoming, locals, plain) = (Incoming::default(), HashMap::new(), None);
        let mut to = In { graph, own: node.name(), kind, incoming, locals, plain };
        let mut pause = RETRY.0;
        loop {
            let error = match node.subscribe(card.proof(), right.grant.clone(), subscribe_options(&self.config)).await {
                Ok(mut subscription) => {
                    self.progress().fabric = FabricCounters::In(subscription.meter());
                    pause = RETRY.0;
                    self.is_up();
                    self.carry_in(&mut to, &mut subscription, &mut right).await?
                }
                Err(error) => error,
            };
            // Nothing more is heard of those elsewhere.
            let changes = to.incoming.clear();
            self.change(&mut to, changes).await;
            self.pause_after(error, &mut pause).await;
            if let Some(new) = right.file.changed().and_then(Permission::read) {
                right.grant = new;
                right.file.taken();
            }
        }
    }

    /// Returns when the right to read has ended, with the reason.
    async fn carry_in(
        &self,
        to: &mut In<'_>,
        subscription: &mut Subscription,
        right: &mut Right,
    ) -> Result<NodeError, RouteError> {
        let mut ticks = ticks();
        loop {
            let received = tokio::select! {
                received = subscription.recv() => received,
                _ = ticks.tick() => {
                    if let Some(new) = right.file.changed().and_then(Permission::read)
                        && self.renewed(&mut right.file, subscription.renew(new.clone()).await)
                    {
                        right.grant = new;
                    }
                    let (changes, forgotten) = to.incoming.poll(Instant::now());
                    self.change(to, changes).await;
                    self.drop_all(Drop::Unannounced, forgotten as u64, NOT_SAID);
                    continue;
                }
            };
            match received {
                Some(message) => self.take(to, message).await,
                None => return ended_because(subscription.ended().await),
            }
        }
    }

    async fn take(&self, to: &mut In<'_>, message: Message) {
        if message.writer == to.own {
            return self.drop(Drop::Own, "this proxy wrote it");
        }
        if message.encoding == ROSTER {
            match to.incoming.roster(Instant::now(), &message) {
                Ok((changes, released)) => {
                    self.change(to, changes).await;
                    for message in released {
                        self.sort(to, message).await;
                    }
                }
                Err(error) => self.drop(Drop::Malformed, format_args!("{:#}: {error}", message.writer)),
            }
            return;
        }
        self.sort(to, message).await;
    }

    async fn sort(&self, to: &mut In<'_>, message: Message) {
        match to.incoming.message(Instant::now(), message) {
            Taken::From(number, message) => {
                let local = to.locals.get_mut(&(message.writer, number)).and_then(Option::as_mut);
                self.write(local, message).await;
            }
            Taken::Plain(message) => {
                if to.plain.is_none() {
                    to.plain = Some(self.plain(to).await);
                }
                self.write(to.plain.as_mut().and_then(Option::as_mut), message).await;
            }
            Taken::Held => {}
            Taken::Crowded(gone) => self.drop_all(Drop::Unannounced, gone as u64, NOT_SAID),
        }
    }

    async fn change(&self, to: &mut In<'_>, changes: Vec<Change>) {
        for change in changes {
            match change {
                Change::Left { writer, number } => {
                    to.locals.remove(&(writer, number));
                }
                Change::Joined { writer, number, kind, definition, offers } => {
                    // The one before goes first: subscribers need not see both.
                    to.locals.remove(&(writer, number));
                    if to.locals.len() >= MAX_LOCALS {
                        tracing::warn!(topic = %self.config.topic, "more than {MAX_LOCALS} publishers elsewhere: one has no counterpart here");
                        continue;
                    }
                    let local = self.local(to, kind, definition, offers).await;
                    to.locals.insert((writer, number), local);
                }
            }
        }
    }

    /// For those of whom nothing is known but what the configuration says.
    async fn plain(&self, to: &In<'_>) -> Option<Local> {
        let Some(kind) = to.kind else {
            tracing::warn!(topic = %self.config.topic, "a writer does not say of what type its messages are; state it as `type`");
            return None;
        };
        let kind = Kind { dialect: gdp_ros::roster::Dialect::Ros2, name: kind.to_string(), hash: vec![] };
        self.local(to, kind, None, Qos::default().into()).await
    }

    async fn local(&self, to: &In<'_>, kind: Kind, definition: Option<Arc<str>>, offers: Offer) -> Option<Local> {
        let made = self.try_local(to, kind, definition, offers).await;
        made.inspect_err(|error| {
            tracing::warn!(topic = %self.config.topic, "a publisher elsewhere has no counterpart here: {error}");
            self.set_status(error);
        })
        .ok()
    }

    async fn try_local(
        &self,
        to: &In<'_>,
        kind: Kind,
        definition: Option<Arc<str>>,
        offers: Offer,
    ) -> Result<Local, String> {
        let form = Form { kind: &kind, definition: definition.as_deref(), encoding: kind.dialect.native() };
        let found = self.types.counterpart(&form, to.graph.dialect()).map_err(|error| error.to_string())?;
        let (here, text) = found;
        if let Some(stated) = to.kind.filter(|stated| to.graph.kind(stated).name != here.name) {
            return Err(format!("it publishes {}, and the topic is of {stated}", kind.name));
        }
        let offers = self.config.qos.map_or(offers, Offer::from);
        let writer = to.graph.writer(&self.types, &self.config.topic, &here, text.as_deref(), offers);
        let writer = writer.await.map_err(|error| error.to_string())?;
        self.progress().kind = Some(here.name.clone());
        Ok(Local { writer, kinds: (kind, here), definitions: (definition, text), converters: vec![] })
    }

    async fn write(&self, local: Option<&mut Local>, message: Message) {
        let Some(local) = local else {
            return self.drop(Drop::Unconvertible, "its publisher has no counterpart here");
        };
        self.counters.arrival.record_since(message.timestamp_ns);
        let (timestamp_ns, began) = (message.timestamp_ns, Instant::now());
        let bytes = match self.convert(local, message) {
            Ok(bytes) => bytes,
            Err(error) => return self.drop(Drop::Unconvertible, error),
        };
        let length = bytes.len();
        match local.writer.write(bytes, timestamp_ns).await {
            Ok(()) => {
                self.counters.handling.record(began.elapsed());
                self.counters.passed(length);
            }
            Err(error @ WriteError::Malformed) => self.drop(Drop::Malformed, error),
            Err(error @ WriteError::Stalled) => self.drop(Drop::Stalled, error),
            Err(error @ WriteError::Failed(_)) => self.drop(Drop::WriteFailed, error),
        }
    }

    fn convert(&self, local: &mut Local, message: Message) -> Result<Bytes, String> {
        let encoding = unsealed(message.encoding).map_err(|error| error.to_string())?;
        let Local { kinds, definitions, converters, .. } = local;
        let at = match converters.iter().position(|(of, _)| *of == encoding) {
            Some(at) => at,
            None => {
                let from = Form { kind: &kinds.0, definition: definitions.0.as_deref(), encoding };
                let native = kinds.1.dialect.native();
                let to = Form { kind: &kinds.1, definition: definitions.1.as_deref(), encoding: native };
                let converter = self.types.converter(&from, &to).map_err(|error| error.to_string())?;
                converters.push((encoding, converter));
                converters.len() - 1
            }
        };
        converters[at].1.convert(message.body).map_err(|error| error.to_string())
    }
}
