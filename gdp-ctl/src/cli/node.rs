//! Shared parts of the commands that are nodes of the fabric.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use clap::Args;
use gdp::{SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_ros::roster::Dialect;
use gdp_ros::types::Types;
use gdp_util::terminal::note;

use super::entity::{self, DEFAULT_KIND};
use super::key::EntityKind;
use crate::cli::context::Context;
use crate::cli::progress::while_waiting;
use crate::ros::feed::Feed;
use crate::ros::{fabric::Fabric, fabric::local_switch, keyring::Keyring, keyring::called};
use gdp_util::folders;
use gdp_util::unix_time::unix_seconds;

/// Time after which a reader is warned that nobody publishes.
const TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Debug, Args)]
pub struct NodeOptions {
    /// Folder with name cards (*.card), grants (*.grant, *.ad) and the key (id.pem). Default:
    /// ~/.config/gdp.
    #[arg(long, env = "GDP_KEYRING", value_name = "FOLDER")]
    keyring: Option<PathBuf>,
    /// Private key file, instead of id.pem in the keyring.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Kind of the key's entity, if the key's file does not state it. Default: proxy.
    #[arg(long, value_enum)]
    kind: Option<EntityKind>,
    /// Switch to attach to: udp://HOST[:PORT], tls://HOST[:PORT], wss://HOST[:PORT] or
    /// eth://INTERFACE. Default: the switch of this machine's daemon.
    #[arg(long, env = "GDP_SWITCH", value_name = "LINK")]
    switch: Option<LinkTarget>,
}

impl NodeOptions {
    /// Whether the user names a switch, instead of this machine's daemon.
    pub fn names_switch(&self) -> bool {
        self.switch.is_some()
    }

    /// Opens the keyring, and warns about omitted files.
    pub fn keyring(&self) -> anyhow::Result<Keyring> {
        let keyring = Keyring::open(&self.folder()?)?;
        for reason in &keyring.left_out {
            note(format_args!("gdp-ctl: warning: left out: {reason}"));
        }
        Ok(keyring)
    }

    fn folder(&self) -> anyhow::Result<PathBuf> {
        let folder = self.keyring.clone().or_else(folders::keyring);
        folder.context("no place for a keyring: say where it is with --keyring, or set HOME")
    }

    fn identity(&self) -> anyhow::Result<Identity> {
        let file = match &self.key {
            Some(file) => file.clone(),
            None => self.folder()?.join("id.pem"),
        };
        entity::load(&file, self.kind).map_err(|error| match error.is_not_found() {
            true => anyhow!(
                "{error}; make a key with `gdp-ctl key generate {} --kind {}`, or say where it is with --key",
                file.display(),
                self.kind.map_or(DEFAULT_KIND, EntityKind::as_str)
            ),
            false => error.into(),
        })
    }

    /// Attaches, runs `what`, and detaches.
    pub fn with_fabric<T>(
        &self,
        keyring: Keyring,
        context: &Context,
        what: impl AsyncFnOnce(&Fabric) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let identity = self.identity()?;
        let switch = match &self.switch {
            Some(switch) => switch.clone(),
            None => local_switch(&mut context.client()?)?,
        };
        // A worker thread keeps the link alive while the main thread is blocked by a stopped
        // terminal.
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        runtime.block_on(async {
            let attaching = format!("attaching at {switch}");
            let fabric = while_waiting(&attaching, Fabric::join(keyring, identity, switch)).await?;
            let done = what(&fabric).await;
            fabric.node.close().await;
            done
        })
    }
}

/// Runs `what`; returns `None` after ^C.
pub async fn unless_interrupted<T>(what: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<Option<T>> {
    tokio::select! {
        done = what => done.map(Some),
        interrupted = tokio::signal::ctrl_c() => interrupted.map(|()| None).context("cannot wait for ^C"),
    }
}

/// Share folders of ROS 2, for types beyond the common ones.
#[derive(Debug, Args)]
pub struct Definitions {
    /// Share folder of ROS 2, such as /opt/ros/jazzy/share, for types beyond the common interfaces;
    /// repeat for several.
    #[arg(long, value_name = "FOLDER")]
    definitions: Vec<PathBuf>,
}

impl Definitions {
    pub fn load(&self) -> anyhow::Result<Types> {
        let folders = self.definitions.iter().map(|folder| (Dialect::Ros2, Path::new(folder)));
        Ok(Types::load(folders)?)
    }
}

pub async fn subscribe(fabric: &Fabric, card: &NameCard, options: SubscribeOptions) -> anyhow::Result<Subscription> {
    let grant = fabric.keyring.grant(card, fabric.node.name(), unix_seconds())?;
    Ok(fabric.node.subscribe(card.proof(), grant, options).await?)
}

/// Reads a topic, with its publishers' types.
pub async fn listen(fabric: &Fabric, card: &NameCard, options: SubscribeOptions) -> anyhow::Result<Feed> {
    Ok(Feed::new(subscribe(fabric, card, options).await?, card))
}

/// Prints a warning after a short time if nobody publishes; never returns.
pub async fn tell_if_silent<T>(fabric: &Fabric, card: &NameCard) -> anyhow::Result<T> {
    tokio::time::sleep(TIMEOUT).await;
    if fabric.entities(card).await?.writers.is_empty() {
        note(format_args!("WARNING: topic [{}] does not appear to be published yet", called(card)));
    }
    std::future::pending().await
}

/// Parses a number greater than zero.
pub fn parse_positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0);
    value.ok_or_else(|| format!("{text:?} is not a number greater than zero"))
}
