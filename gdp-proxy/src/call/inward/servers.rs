//! Tracks the remote servers of a name, and which of them can be called.

use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp::unstable::Client;
use gdp_ros::call::{Description, Epoch};
use gdp_ros::roster::Dialect;
use gdp_ros::services::service_name;
use gdp_wire::Name;
use parking_lot::Mutex;

use super::super::LAST_WORDS;
use super::super::asking::{Changed, Described, Known, describe, events};
use super::super::outbox::Outbox;
use super::super::stand::Stands;
use super::Route;
use crate::call::inward::events::{Doing, Done, Remote};
use crate::call::inward::state::In;
use crate::config::What;
use crate::graph::GraphError;
use crate::node_name::local_node;
use crate::route_status::RouteError;
use crate::waiting::Waiting;

/// Bound on the remote servers of a name; only the nearest are used.
const MAX_SERVERS: usize = 64;

/// Pause before an unusable server is asked again.
const ASK_AGAIN: Duration = Duration::from_secs(5);

impl Route {
    /// Compares the attached servers with the known ones, and asks new ones for their description.
    pub(super) fn look<'a>(&'a self, to: &mut In<'a>, doing: &Doing<'a>) {
        let now = Instant::now();
        // Local clients reach the servers of other proxies of this graph without this proxy.
        let instances = to.client.instances().into_iter().filter(|one| !to.way.candidate.is_twin(now, &one.name));
        let attached: Vec<Name> = instances.take(MAX_SERVERS).map(|one| one.name).collect();
        let gone: Vec<Name> = to.remotes.keys().filter(|name| !attached.contains(name)).copied().collect();
        for name in gone {
            to.remotes.remove(&name);
            // Clients that wait for results are informed when their calls fail.
            to.lose_goals(now, name);
        }
        for name in attached {
            let ask = match to.remotes.get(&name) {
                None => true,
                Some(Remote::Unfit(until)) => *until <= now,
                Some(Remote::Asked | Remote::Known(_)) => false,
            };
            if ask {
                ask_for_description(to, name, doing);
            }
        }
        self.withdraw_if_alone(to, doing);
    }

    fn withdraw_if_alone<'a>(&'a self, to: &mut In<'a>, doing: &Doing<'a>) {
        let known = to.remotes.values().filter(|remote| matches!(remote, Remote::Known(_))).count();
        let is_unfit = to.remotes.values().any(|remote| matches!(remote, Remote::Unfit(_)));
        // Another proxy of the graph may know more types. The pause avoids constant requests if it
        // does not.
        let now = Instant::now();
        if is_unfit {
            *self.unfit_until.lock() = Some(now + ASK_AGAIN);
        }
        to.way.candidate.set_permitted(known > 0 || !self.leaves_to_others(now));
        self.counters.servers(known);
        if known > 0 {
            return;
        }
        if let Some((local, _)) = to.local.take() {
            tracing::info!(service = %self.config.name, "no server elsewhere is left, so it is not announced here \
                                                         any more");
            self.route_status.set_status(Waiting::RemoteServer.as_str());
            to.outbox = Outbox::default();
            let message = to.board.message();
            doing.push(Box::pin(async move { Done::Withdrawn(withdraw(local, message).await) }));
        }
    }

    /// Handles a changed server, unless the change is known already.
    pub(super) fn changed<'a>(
        &'a self,
        to: &mut In<'a>,
        changed: Changed,
        doing: &Doing<'a>,
    ) -> Result<(), RouteError> {
        let Changed { known, now } = changed;
        if !to.knows(&known) {
            return Ok(());
        }
        to.lose_goals(Instant::now(), known.instance);
        let Some(now) = now else {
            ask_for_description(to, known.instance, doing);
            return Ok(());
        };
        let is_same = now.as_ref().is_ok_and(|(epoch, _)| *epoch == known.epoch);
        let now = if is_same { Err("it says that it is another, and that it is the same".into()) } else { now };
        self.described(to, known.instance, now, doing)
    }

    pub(super) fn described<'a>(
        &'a self,
        to: &mut In<'a>,
        name: Name,
        described: Described,
        doing: &Doing<'a>,
    ) -> Result<(), RouteError> {
        let fit = match described {
            Ok((epoch, there)) => self.fit(to, name, epoch, there)?,
            Err(error) => Err(error),
        };
        match fit {
            Ok(known) => {
                to.remotes.insert(name, Remote::Known(known.clone()));
                if self.config.what == What::Action {
                    doing.push(ask_for_events(to.client, known, 0, false));
                }
            }
            Err(error) => {
                // The server is asked again and again.
                if self.route_status.status() != error {
                    tracing::warn!(service = %self.config.name, server = %name, "not called: {error}");
                }
                if to.local.is_none() {
                    self.route_status.set_status(&error);
                }
                to.remotes.insert(name, Remote::Unfit(Instant::now() + ASK_AGAIN));
            }
        }
        self.withdraw_if_alone(to, doing);
        Ok(())
    }

    /// Checks that the server's type fits, and creates the local server if it is the first one. The
    /// outer error is the graph's.
    fn fit(
        &self,
        to: &mut In<'_>,
        instance: Name,
        epoch: Epoch,
        there: Description,
    ) -> Result<Result<Arc<Known>, String>, RouteError> {
        let dialect = to.way.graph.dialect();
        let here = match (self.config.what, there.kind.dialect) {
            (What::Service, _) => self.types.service_counterpart(&there, dialect),
            // The proxies at ROS 1 masters convert.
            (What::Action, Dialect::Ros2) => Ok(there.clone()),
            (What::Action, Dialect::Ros1) => return Ok(Err("it is not described in the terms of ROS 2".into())),
        };
        let here = match here {
            Ok(here) => here,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let wanted = to.way.kind.map(|kind| match self.config.what {
            What::Service => service_name(kind.as_str(), dialect).unwrap_or_default(),
            What::Action => kind.to_string(),
        });
        if let Some(wanted) = wanted.filter(|wanted| *wanted != here.kind.name) {
            return Ok(Err(format!("it is of {}, and the name is of {wanted}", here.kind.name)));
        }
        // A proxy at a ROS 1 master converts by the announced definitions, and not by its own.
        let converts = self.config.what == What::Action && dialect == Dialect::Ros1 && there.definitions.is_some();
        let own = if converts { None } else { self.own_hash(&here) };
        if let Some(own) = own.filter(|own| !there.kind.hash.is_empty() && *own != here.kind.hash) {
            let own = hex::encode(own);
            return Ok(Err(format!("its {} is another than the one known here, of hash {own}", here.kind.name)));
        }
        if let Some((_, route_status)) =
            to.local.as_ref().filter(|(_, route_status)| !route_status.kind.agrees(&here.kind))
        {
            return Ok(Err(format!("it is of another type than the {} of another server", route_status.kind.name)));
        }
        let converters = match self.types.service_converters(&here, &there) {
            Ok(converters) => Mutex::new(converters),
            Err(error) => return Ok(Err(error.to_string())),
        };
        if to.local.is_none() {
            let name = here.kind.name.clone();
            match Stands::new(to.way.graph, &self.types, &self.config.name, self.config.what, &here) {
                Ok(stands) => {
                    let listed = to.way.card.get("topic");
                    stands.assign(&local_node(&self.config.name, listed, &here.node));
                    to.local = Some((Arc::new(stands), here));
                }
                Err(error @ GraphError::Left) => return Err(error.into()),
                // An earlier local server may still be answering.
                Err(error) => return Ok(Err(error.to_string())),
            }
            self.is_up(&name);
        }
        Ok(Ok(Arc::new(Known { instance, epoch, there, converters })))
    }

    /// Returns the hash of the type as this proxy knows it.
    fn own_hash(&self, here: &Description) -> Option<Vec<u8>> {
        let kind = gdp_ros::roster::Kind { hash: vec![], ..here.kind.clone() };
        let hash = match self.config.what {
            What::Service => self.types.describe_service(kind).kind.hash,
            What::Action => self.types.describe_action(kind.name).kind.hash,
        };
        Some(hash).filter(|hash| !hash.is_empty())
    }
}

/// Publishes the last status of the goals and removes the local server, within [`LAST_WORDS`].
pub(super) async fn withdraw(local: Arc<Stands>, statuses: Bytes) -> Result<(), String> {
    let said = async {
        local.publish_status(statuses).await?;
        local.settle().await;
        Ok(())
    };
    tokio::time::timeout(LAST_WORDS, said).await.unwrap_or(Ok(()))
}

fn ask_for_description<'a>(to: &mut In<'a>, name: Name, doing: &Doing<'a>) {
    to.remotes.insert(name, Remote::Asked);
    let client = to.client;
    doing.push(Box::pin(async move { Done::Description(name, describe(client, name).await) }));
}

pub(super) fn ask_for_events(
    client: &Client,
    known: Arc<Known>,
    after: u64,
    has_failed: bool,
) -> Pin<Box<dyn Future<Output = Done> + Send + '_>> {
    Box::pin(async move {
        let news = events(client, &known, after, has_failed).await;
        Done::News(known, after, news)
    })
}
