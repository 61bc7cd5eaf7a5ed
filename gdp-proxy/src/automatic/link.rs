//! Publishes or reads a catalog. Each catalog is a task of its own, as routes are.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp::unstable::{Ended, Node, Overflow, PublishOptions, Publisher, Reliability, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Issued, Reading};
use gdp_core::domain::CredentialFiles;
use gdp_ros::catalog::{CATALOG, LEASE, REFRESH};
use gdp_wire::Name;
use serde::Serialize;
use tokio::sync::watch;

use super::listed::{Catalogs, Listed};
use crate::config::Side;
use crate::manager::{Failure, Manager, Plan, Work};
use crate::offload::run_blocking_if_large;
use crate::renewal::Renewal;
use crate::route_status::{RETRY, Right, RouteError, RouteStatus, ended_because, ticks};
use gdp_util::unix_time::unix_seconds;

/// Time for which an ending catalog waits for the delivery of its last version.
const FLUSH: Duration = Duration::from_secs(3);

pub type Links = Manager<CatalogPlan>;

/// A catalog to publish or read.
#[derive(Clone)]
pub struct CatalogPlan {
    pub card: NameCard,
    pub renewal: Renewal,
    pub end: End,
}

/// This proxy's end of a catalog.
#[derive(Clone)]
pub enum End {
    /// The certificate to publish, and the encoded catalog.
    Writes(Issued<AdCert>, watch::Receiver<Arc<[u8]>>),
    /// The grant to read, the receiver of the entries, and the files that prove this proxy's role.
    Reads(Reading, Arc<watch::Sender<Arc<[Listed]>>>, Option<CredentialFiles>),
}

/// The statistics of one catalog, as the statistics file shows them.
#[derive(Serialize)]
pub struct CatalogStats {
    pub name: Name,
    pub direction: Side,
    /// `up`, or what the catalog waits for.
    pub status: String,
}

pub struct CatalogLink {
    plan: CatalogPlan,
    node: Node,
    route_status: RouteStatus,
}

pub fn manager(node: Node) -> Links {
    Manager::new(move |plan: &CatalogPlan| CatalogLink {
        plan: plan.clone(),
        node: node.clone(),
        route_status: RouteStatus::new("catalog".into(), plan.card.name(), None, None),
    })
}

impl CatalogPlan {
    fn side(&self) -> Side {
        match self.end {
            End::Writes(..) => Side::Out,
            End::Reads(..) => Side::In,
        }
    }
}

impl PartialEq for CatalogPlan {
    fn eq(&self, other: &Self) -> bool {
        let same_end = match (&self.end, &other.end) {
            (End::Writes(_, own), End::Writes(_, other)) => own.same_channel(other),
            // The grant is compared, because the configuration may name another file with another
            // grant.
            (End::Reads(grant, list, _), End::Reads(other, others, _)) => Arc::ptr_eq(list, others) && grant == other,
            _ => false,
        };
        same_end && self.card == other.card
    }
}

impl Plan for CatalogPlan {
    type Key = (Name, Side);
    type Work = CatalogLink;

    fn key(&self) -> Self::Key {
        (self.card.name(), self.side())
    }
}

impl Work for CatalogLink {
    type Stats = CatalogStats;

    fn stats(&self) -> CatalogStats {
        CatalogStats { name: self.plan.card.name(), direction: self.plan.side(), status: self.route_status.status() }
    }

    fn failed(&self, why: &str) {
        self.route_status.failed(why);
    }

    async fn run(&self, stop: impl Future<Output = ()> + Send) -> Result<(), Failure> {
        let mut publisher = None;
        let ended = tokio::select! {
            Err(error) = self.carry(&mut publisher) => Err(self.route_status.ended(error)),
            () = stop => Ok(()),
        };
        if let Some(publisher) = publisher {
            self.close(publisher).await;
        }
        ended
    }
}

impl CatalogLink {
    async fn carry(&self, publisher: &mut Option<Publisher>) -> Result<Infallible, RouteError> {
        let CatalogPlan { renewal, end, .. } = self.plan.clone();
        match end {
            End::Writes(cert, catalog) => self.write(&mut Right::publish(cert, renewal), catalog, publisher).await,
            End::Reads(grant, listed, files) => {
                self.read(&mut Right::read(grant, renewal), &listed, files.as_ref()).await
            }
        }
    }

    async fn write(
        &self,
        right: &mut Right<Issued<AdCert>>,
        mut catalog: watch::Receiver<Arc<[u8]>>,
        publisher: &mut Option<Publisher>,
    ) -> Result<Infallible, RouteError> {
        let mut pause = RETRY;
        loop {
            let error = match self.node.publish(self.plan.card.proof(), right.current(), options()).await {
                Ok(new) => {
                    pause = RETRY;
                    self.route_status.is_up();
                    ended_because(self.publish(publisher.insert(new), &mut catalog, right).await)?
                }
                Err(error) => error,
            };
            drop(publisher.take());
            self.route_status.pause(error, &mut pause, right).await;
        }
    }

    async fn publish(
        &self,
        publisher: &mut Publisher,
        catalog: &mut watch::Receiver<Arc<[u8]>>,
        right: &mut Right<Issued<AdCert>>,
    ) -> Ended {
        let (mut ended, mut looks) = (std::pin::pin!(publisher.ended()), ticks());
        let mut due = Instant::now() + REFRESH;
        publisher.pin(CATALOG, &catalog.borrow_and_update().clone());
        loop {
            tokio::select! {
                why = &mut ended => return why,
                Ok(()) = catalog.changed() => {
                    publisher.pin(CATALOG, &catalog.borrow_and_update().clone());
                    due = Instant::now() + REFRESH;
                }
                _ = looks.tick() => {
                    if Instant::now() >= due {
                        publisher.mention(CATALOG, &catalog.borrow().clone());
                        due = Instant::now() + REFRESH;
                    }
                    self.route_status.renew(right, async |new| publisher.renew(new).await).await;
                }
            }
        }
    }

    async fn read(
        &self,
        right: &mut Right<Reading>,
        listed: &watch::Sender<Arc<[Listed]>>,
        files: Option<&CredentialFiles>,
    ) -> Result<Infallible, RouteError> {
        let mut pause = RETRY;
        let mut catalogs = Catalogs::new(*self.plan.card.owner_key(), self.node.name());
        loop {
            let options = SubscribeOptions::reliable();
            let error = match self.node.subscribe(self.plan.card.proof(), right.current(), options).await {
                Ok(mut subscription) => {
                    pause = RETRY;
                    self.route_status.is_up();
                    let to = (&mut catalogs, listed, files);
                    ended_because(self.take(&mut subscription, to, right).await)?
                }
                Err(error) => error,
            };
            self.route_status.pause(error, &mut pause, right).await;
            // Without a subscription, silent writers are forgotten.
            if catalogs.poll(Instant::now()) {
                listed.send_replace(catalogs.all().into());
            }
        }
    }

    async fn take(
        &self,
        subscription: &mut Subscription,
        (catalogs, listed, files): (&mut Catalogs, &watch::Sender<Arc<[Listed]>>, Option<&CredentialFiles>),
        right: &mut Right<Reading>,
    ) -> Ended {
        let mut looks = ticks();
        let begun = Instant::now();
        loop {
            let changed = tokio::select! {
                message = subscription.recv() => match message {
                    Some(message) if message.encoding == CATALOG => {
                        let member = || Some(files?.load().ok()?.membership);
                        let take = || catalogs.take(&message, member, Instant::now(), unix_seconds());
                        // Each name in the catalog has signatures to verify.
                        let taken = run_blocking_if_large(message.body.len(), take);
                        taken.unwrap_or_else(|error| {
                            tracing::warn!(catalog = %self.plan.card.name(), writer = %message.writer, "a catalog is not taken: {error}");
                            false
                        })
                    }
                    Some(_) => false,
                    None => return subscription.ended().await,
                },
                _ = looks.tick() => {
                    self.route_status.renew(right, async |new| subscription.renew(new).await).await;
                    // A list that an earlier subscription left ends if nobody publishes it now.
                    let is_left = begun.elapsed() > LEASE && catalogs.all().is_empty() && !listed.borrow().is_empty();
                    catalogs.poll(Instant::now()) || is_left
                }
            };
            if changed {
                listed.send_replace(catalogs.all().into());
            }
        }
    }

    /// Publishes an empty catalog as the last version, and closes the publisher.
    async fn close(&self, publisher: Publisher) {
        if let Some(nothing) = gdp_ros::catalog::Catalog::new(vec![]).ok().and_then(|catalog| catalog.to_bytes().ok()) {
            publisher.pin(CATALOG, &nothing);
        }
        if let Err(error) = publisher.close(FLUSH).await {
            tracing::warn!(catalog = %self.plan.card.name(), "left before all readers knew: {error}");
        }
    }
}

/// Versions of the catalog that readers may request again.
const HISTORY: usize = 16;

/// Reliable delivery with a high traffic class: no version may be lost, least of all the last one.
fn options() -> PublishOptions {
    let reliability = Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: HISTORY } };
    PublishOptions { reliability, history: HISTORY, class: 5, ..PublishOptions::reliable() }
}
