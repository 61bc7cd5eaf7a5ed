//! The start of most tests: a robot that publishes a name, and a cloud that reads it.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use gdp::unstable::{Node, NodeCounters, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::identity::Identity;
use gdp_e2e::seal::{Encoding, Message};
use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::time::timeout;

use crate::patient::patient;
use gdp_tests::wait::TIMEOUT;

use super::{Frame, Owner, Switch, dropped, eventually, node};

/// Fields are declared in the order in which they must drop.
pub struct Scene {
    pub publisher: Publisher,
    pub subscription: Subscription,
    pub robot: Node,
    pub cloud: Node,
    pub robot_identity: Identity,
    pub cloud_identity: Identity,
    pub owner: Owner,
    pub switch: Switch,
}

impl Scene {
    /// Builds a scene in which the newest message counts.
    pub async fn best_effort() -> Result<Self> {
        let (publishing, reading) = patient();
        Self::set(publishing, reading).await
    }

    /// Builds a scene in which every message counts.
    pub async fn reliable() -> Result<Self> {
        Self::set(PublishOptions::reliable(), SubscribeOptions::reliable()).await
    }

    /// Builds a scene and waits until one message has arrived.
    pub async fn set(publishing: PublishOptions, reading: SubscribeOptions) -> Result<Self> {
        let (switch, owner) = (Switch::start()?, Owner::new("/chatter")?);
        let (robot_identity, cloud_identity) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
        let (robot, cloud) = (node(&switch, &robot_identity).await?, node(&switch, &cloud_identity).await?);
        let subscription = owner.subscribe(&cloud, reading).await?;
        let publisher = owner.publish(&robot, publishing).await?;
        let mut scene = Self { publisher, subscription, robot, cloud, robot_identity, cloud_identity, owner, switch };
        scene.passes(b"first").await?;
        Ok(scene)
    }

    pub async fn send(&mut self, body: &[u8]) -> Result<()> {
        self.publisher.send(Encoding::Bytes, body).await?;
        Ok(())
    }

    /// Returns the next message that the application receives.
    pub async fn next(&mut self) -> Result<Message> {
        match timeout(TIMEOUT, self.subscription.recv()).await {
            Ok(Some(message)) => Ok(message),
            Ok(None) => bail!("the node is closed"),
            Err(_) => bail!("no message: robot {:?}, cloud {:?}", self.robot.counters(), self.cloud.counters()),
        }
    }

    /// Sends this message; the cloud's next message must be this one.
    pub async fn passes(&mut self, body: &[u8]) -> Result<()> {
        self.send(body).await?;
        let message = self.next().await?;
        assert_eq!(&message.body[..], body, "something else was delivered");
        assert_eq!(message.writer, self.robot_identity.name());
        Ok(())
    }

    /// Returns the delivered messages that the test has not read yet.
    pub async fn delivered(&mut self) -> Vec<Message> {
        let mut messages = Vec::new();
        while let Ok(Some(message)) = timeout(Duration::from_millis(1), self.subscription.recv()).await {
            messages.push(message);
        }
        messages
    }

    /// Waits until the cloud has dropped at least this many for this reason.
    pub fn drops(&self, reason: &str, at_least: u64) -> Result<NodeCounters> {
        drops(&self.cloud, reason, at_least)
    }
}

/// Waits until a node has dropped at least this many for this reason.
pub fn drops(node: &Node, reason: &str, at_least: u64) -> Result<NodeCounters> {
    let enough = || Some(node.counters()).filter(|counters| dropped(counters, reason) >= at_least);
    eventually(&format!("{reason} to reach {at_least}"), enough).with_context(|| format!("{:?}", node.counters()))
}

/// Frames that passed the switch.
#[derive(Clone, Default)]
pub struct Recording(Arc<Mutex<Vec<Frame>>>);

impl Recording {
    pub fn add(&self, frames: &[Frame]) {
        self.0.lock().extend_from_slice(frames);
    }

    pub fn frames(&self) -> Vec<Frame> {
        self.0.lock().clone()
    }

    /// Returns the last frame to this destination.
    pub fn last(&self, destination: Name) -> Option<Frame> {
        let frames = self.0.lock();
        frames.iter().rev().find(|frame| frame.destination == destination).cloned()
    }

    /// Records everything that passes from now on. The recording replaces the switch's previous
    /// tampering.
    pub fn of(switch: &Switch) -> Self {
        let recording = Self::default();
        let adding = recording.clone();
        switch.tamper(move |frames| adding.add(frames));
        recording
    }
}
