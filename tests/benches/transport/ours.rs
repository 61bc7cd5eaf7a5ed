//! This SDK: a node at each end, a name for each lane. No other file of the benchmark depends on
//! the SDK's transport.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use gdp::unstable::{Node, NodeConfig, PublishOptions, Publisher, SETTLING, SubscribeOptions, Subscription, Wants};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_e2e::seal::Encoding;
use tokio::sync::oneshot;

use crate::lane::{Lane, Sender};
use crate::run::Carrier;
use crate::site::{End, Ends};

pub const BEST_EFFORT: &str = "gdp, best effort";
pub const RELIABLE: &str = "gdp, reliable";
pub const ETHERNET: &str = "gdp, reliable, Ethernet";

/// Interval between messages that probe the path.
const PROBES: Duration = Duration::from_millis(5);

/// Margin beyond [`SETTLING`]: the links do not come up at the same time.
const MARGIN: Duration = Duration::from_millis(200);

/// The medium of frames to the switch and from it.
#[derive(Clone, Copy)]
enum Over {
    /// UDP, like the other contenders.
    Udp,
    Ethernet,
}

pub fn best_effort(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, Over::Udp, PublishOptions::best_effort(), SubscribeOptions::best_effort())
}

pub fn reliable(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, Over::Udp, PublishOptions::reliable(), SubscribeOptions::reliable())
}

pub fn best_effort_on_ethernet(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, Over::Ethernet, PublishOptions::best_effort(), SubscribeOptions::best_effort())
}

pub fn reliable_on_ethernet(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, Over::Ethernet, PublishOptions::reliable(), SubscribeOptions::reliable())
}

/// Opens the lanes. The first lane has a higher class than the others.
fn open(
    ends: &Ends,
    lanes: &[Arc<Lane>],
    over: Over,
    publish: PublishOptions,
    subscribe: SubscribeOptions,
) -> Result<Carrier> {
    let owner = SigningKey::generate()?;
    let identities = [Identity::generate("proxy")?, Identity::generate("proxy")?];
    let (writer, reader) = (identities[0].name(), identities[1].name());
    let [robot, cloud] = identities;
    let (robot, cloud) = (connect(&ends.robot, over, robot)?, connect(&ends.cloud, over, cloud)?);
    if let Over::Udp = over {
        std::thread::sleep(SETTLING + MARGIN);
    }
    for (index, lane) in lanes.iter().enumerate() {
        let card = NameCard::create(owner.verify_key(), "topic", &format!("/lane/{index}"), "bytes", None)?;
        let (name, serial, not_before, not_after) = (card.name(), 1, 0, 4_000_000_000);
        let grant = ReadGrant { name, to: Grantee::Entity(reader), serial, not_before, not_after };
        let grant = issue(&owner, &grant)?.into();
        let cert = AdCert { name, entity: writer, scope: vec![], serial, not_before, not_after };
        let cert = issue(&owner, &cert)?.into();

        let (node, proof) = (cloud.clone(), card.proof());
        let subscribed = async move { node.subscribe(proof, grant, subscribe).await };
        let subscription = ends.cloud.inside.run(subscribed)??;
        let options = PublishOptions { class: if index == 0 { publish.class + 1 } else { publish.class }, ..publish };
        let (node, proof) = (robot.clone(), card.proof());
        let publisher = ends.robot.inside.run(async move { node.publish(proof, cert, options).await })??;
        let (first, there) = oneshot::channel();
        ends.cloud.inside.runtime.spawn(receive(lane.clone(), subscription, first));
        let sender = Ours { publisher, reliable: subscribe.wants == Wants::Every };
        ends.robot.inside.runtime.spawn(send(lane.clone(), sender, there));
    }
    let counted = cloud.clone();
    Ok(Carrier {
        drops: Box::new(move || counted.counters().drops),
        close: Box::pin(async move {
            robot.close().await;
            cloud.close().await;
        }),
    })
}

fn connect(end: &End, over: Over, identity: Identity) -> Result<Node> {
    let switch = match over {
        Over::Udp => format!("udp://{}", end.switch),
        Over::Ethernet => format!("eth://{}", end.interface),
    };
    let config = NodeConfig::new(identity, switch.parse()?);
    Ok(end.inside.run(Node::connect(config))??)
}

async fn receive(lane: Arc<Lane>, mut subscription: Subscription, first: oneshot::Sender<()>) {
    if subscription.recv().await.is_some() {
        // The task that waits for this signal outlives this one.
        let _ = first.send(());
    }
    while let Some(message) = subscription.recv().await {
        lane.arrived(&message.body);
    }
}

/// Sends probes until one arrives, then the lane's messages.
async fn send(lane: Arc<Lane>, mut sender: Ours, mut there: oneshot::Receiver<()>) {
    loop {
        lane.note(sender.send(b"?").await);
        if tokio::time::timeout(PROBES, &mut there).await.is_ok() {
            break;
        }
    }
    lane.feed(sender).await;
}

struct Ours {
    publisher: Publisher,
    reliable: bool,
}

impl Sender for Ours {
    async fn send(&mut self, body: &[u8]) -> Result<()> {
        // A reliable publisher waits for room by itself. A best-effort one would replace messages
        // that have not left yet.
        if !self.reliable {
            self.publisher.ready().await?;
        }
        Ok(self.publisher.send(Encoding::Bytes, body).await.map(drop)?)
    }
}
