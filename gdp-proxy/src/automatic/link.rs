//! A catalog on its way: published for others, or read. Each has a thread, as routes have.

use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use gdp::domain::PaperFiles;
use gdp::node::{Ended, NodeError, Overflow, PublishOptions, Publisher, Reliability, SubscribeOptions, Subscription};
use gdp::{Name, NameCard, Node};
use gdp_ros::catalog::{CATALOG, REFRESH};
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{Interval, MissedTickBehavior};

use super::listed::{Catalogs, Listed};
use crate::config::Side;
use crate::manager::{Failure, Manager, Plan, Work};
use crate::material::{Permission, unix_now};
use crate::renewal::Renewal;

/// Between attempts: doubled from the first to the second.
const RETRY: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));

/// How long one that ends waits for its last word to arrive.
const FLUSH: Duration = Duration::from_secs(3);

const LOOK: Duration = Duration::from_secs(1);

pub type Links = Manager<CatalogPlan>;

/// A catalog that is published or read.
#[derive(Clone)]
pub struct CatalogPlan {
    pub card: NameCard,
    pub right: Permission,
    pub renewal: Renewal,
    pub end: End,
}

/// This end of it.
#[derive(Clone)]
pub enum End {
    /// It is this, in bytes.
    Writes(watch::Receiver<Arc<[u8]>>),
    /// What it lists goes here; the files show this proxy's role.
    Reads(Arc<watch::Sender<Arc<[Listed]>>>, Option<PaperFiles>),
}

/// One catalog, as the statistics file shows it.
#[derive(Serialize)]
pub struct CatalogStats {
    pub name: Name,
    pub direction: Side,
    /// `up`, or what it waits for.
    pub status: String,
}

pub struct CatalogLink {
    plan: CatalogPlan,
    node: Node,
    status: Mutex<String>,
}

pub fn manager(node: Node) -> Links {
    Manager::new(move |plan: &CatalogPlan| CatalogLink {
        plan: plan.clone(),
        node: node.clone(),
        status: Mutex::new("starting".into()),
    })
}

impl CatalogPlan {
    fn side(&self) -> Side {
        match self.end {
            End::Writes(_) => Side::Out,
            End::Reads(..) => Side::In,
        }
    }
}

impl PartialEq for CatalogPlan {
    fn eq(&self, other: &Self) -> bool {
        let same_end = match (&self.end, &other.end) {
            (End::Writes(own), End::Writes(other)) => own.same_channel(other),
            // Another file may have it.
            (End::Reads(list, _), End::Reads(others, _)) => Arc::ptr_eq(list, others) && self.right == other.right,
            _ => false,
        };
        same_end && self.card == other.card
    }
}

impl Plan for CatalogPlan {
    type Place = (Name, Side);
    type Work = CatalogLink;

    fn place(&self) -> Self::Place {
        (self.card.name(), self.side())
    }
}

impl Work for CatalogLink {
    type Stats = CatalogStats;

    fn stats(&self) -> CatalogStats {
        let status = self.status.lock().unwrap_or_else(PoisonError::into_inner).clone();
        CatalogStats { name: self.plan.card.name(), direction: self.plan.side(), status }
    }

    fn failed(&self, why: &str) {
        tracing::warn!(catalog = %self.plan.card.name(), "{why}");
        self.set_status(why);
    }

    async fn run(&self, stop: impl Future<Output = ()>) -> Result<(), Failure> {
        let mut publisher = None;
        let ended = tokio::select! {
            Err(error) = self.carry(&mut publisher) => Err(Failure::Final(error)),
            () = stop => Ok(()),
        };
        if let Some(publisher) = publisher {
            self.close(publisher).await;
        }
        ended
    }
}

impl CatalogLink {
    async fn carry(&self, publisher: &mut Option<Publisher>) -> Result<Infallible, anyhow::Error> {
        let mut renewal = self.plan.renewal.clone();
        let mut right = self.plan.right.clone();
        let mut pause = RETRY.0;
        let mut catalogs = Catalogs::new(*self.plan.card.owner_key(), self.node.name());
        loop {
            let tried = match (&self.plan.end, right.clone()) {
                (End::Writes(catalog), Permission::Publish(cert)) => {
                    match self.node.publish(self.plan.card.proof(), cert, options()).await {
                        Ok(new) => {
                            pause = self.is_up();
                            let new = publisher.insert(new);
                            Ok(self.publish(new, catalog.clone(), &mut renewal, &mut right).await)
                        }
                        Err(error) => Err(error),
                    }
                }
                (End::Reads(listed, files), Permission::Read(grant)) => {
                    let options = SubscribeOptions::reliable();
                    match self.node.subscribe(self.plan.card.proof(), grant, options).await {
                        Ok(mut subscription) => {
                            pause = self.is_up();
                            let to = (&mut catalogs, &**listed, files.as_ref());
                            Ok(self.read(&mut subscription, to, &mut renewal, &mut right).await)
                        }
                        Err(error) => Err(error),
                    }
                }
                _ => return Err(anyhow!("a catalog with the right to the other direction")),
            };
            let why = match tried {
                Ok(Ended::Closed) => return Err(anyhow!("the node is closed")),
                Ok(Ended::Right(error)) => NodeError::from(error).to_string(),
                Err(error) => error.to_string(),
            };
            drop(publisher.take());
            self.failed(&why);
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(RETRY.1);
            // Nothing more is heard of those elsewhere.
            if let End::Reads(listed, _) = &self.plan.end
                && catalogs.poll(Instant::now())
            {
                listed.send_replace(catalogs.all().into());
            }
            if let Some(new) = renewal.changed() {
                right = new;
                renewal.taken();
            }
        }
    }

    async fn publish(
        &self,
        publisher: &mut Publisher,
        mut catalog: watch::Receiver<Arc<[u8]>>,
        renewal: &mut Renewal,
        right: &mut Permission,
    ) -> Ended {
        let (mut ended, mut looks) = (std::pin::pin!(publisher.ended()), ticks(LOOK));
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
                    if let Some(new) = renewal.changed() && let Permission::Publish(cert) = new.clone() {
                        let renewed = publisher.renew(cert).await;
                        self.renewed(renewal, right, new, renewed);
                    }
                }
            }
        }
    }

    async fn read(
        &self,
        subscription: &mut Subscription,
        (catalogs, listed, files): (&mut Catalogs, &watch::Sender<Arc<[Listed]>>, Option<&PaperFiles>),
        renewal: &mut Renewal,
        right: &mut Permission,
    ) -> Ended {
        let mut looks = ticks(LOOK);
        loop {
            let changed = tokio::select! {
                message = subscription.recv() => match message {
                    Some(message) if message.encoding == CATALOG => {
                        let member = || Some(files?.load().ok()?.membership);
                        let taken = catalogs.take(&message, member, Instant::now(), unix_now());
                        taken.unwrap_or_else(|error| {
                            tracing::warn!(catalog = %self.plan.card.name(), writer = %message.writer, "a catalog is not taken: {error}");
                            false
                        })
                    }
                    Some(_) => false,
                    None => return subscription.ended().await,
                },
                _ = looks.tick() => {
                    if let Some(new) = renewal.changed() && let Permission::Read(grant) = new.clone() {
                        let renewed = subscription.renew(grant).await;
                        self.renewed(renewal, right, new, renewed);
                    }
                    catalogs.poll(Instant::now())
                }
            };
            if changed {
                listed.send_replace(catalogs.all().into());
            }
        }
    }

    fn renewed(&self, renewal: &mut Renewal, right: &mut Permission, new: Permission, result: Result<(), NodeError>) {
        match result {
            Ok(()) => {
                renewal.taken();
                *right = new;
            }
            Err(error) => renewal.refused(&error),
        }
    }

    /// Its last word is that nothing is exposed any more.
    async fn close(&self, publisher: Publisher) {
        if let Some(nothing) = gdp_ros::catalog::Catalog::new(vec![]).ok().and_then(|catalog| catalog.to_bytes().ok()) {
            publisher.pin(CATALOG, &nothing);
        }
        if let Err(error) = publisher.close(FLUSH).await {
            tracing::warn!(catalog = %self.plan.card.name(), "left before all readers knew: {error}");
        }
    }

    fn is_up(&self) -> Duration {
        self.set_status("up");
        RETRY.0
    }

    fn set_status(&self, status: &str) {
        *self.status.lock().unwrap_or_else(PoisonError::into_inner) = status.into();
    }
}

/// Every word of it counts, and the last one most.
fn options() -> PublishOptions {
    let reliability = Reliability::Reliable { overflow: Overflow::DropOldest };
    PublishOptions { reliability, history: 16, class: 5, ..PublishOptions::reliable() }
}

fn ticks(period: Duration) -> Interval {
    let mut ticks = tokio::time::interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}
