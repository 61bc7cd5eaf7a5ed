//! Shared parts of the commands that are nodes of the fabric.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow};
use clap::Args;
use gdp::unstable::{LinkConfig, Node, SubscribeOptions, Subscription};
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
use crate::ros::{fabric::Fabric, fabric::local_switch};
use gdp::unstable::{called, members};
use gdp::{FindError, Keyring};
use gdp_util::folders;
use gdp_util::unix_time::unix_seconds;

/// The interval between two looks at the clocks of counterparts, and between two lines about one.
const CLOCKS_LOOK: Duration = Duration::from_secs(1);
const CLOCKS_AGAIN: Duration = Duration::from_secs(60);

/// Time after which a reader is warned that nobody publishes.
const TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Debug, Args)]
pub struct NodeOptions {
    /// Folder with name cards (*.card), grants (*.grant, *.ad) and the key (id.pem), or the folder
    /// of a member that joined a domain. Default: ~/.config/gdp, or /etc/gdp if root has joined.
    #[arg(long, env = "GDP_KEYRING", value_name = "FOLDER")]
    keyring: Option<PathBuf>,
    /// Private key file, instead of id.pem in the keyring, or a member's proxy.pem.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Kind of the key's entity, if the key's file does not state it. Default: proxy.
    #[arg(long, value_enum)]
    kind: Option<EntityKind>,
    /// Switch to attach to: udp://HOST[:PORT], tls://HOST[:PORT], wss://HOST[:PORT] or
    /// eth://INTERFACE. Default: the switch of this machine's daemon, or for a member the one it
    /// joined at.
    #[arg(long, env = "GDP_SWITCH", value_name = "LINK")]
    switch: Option<LinkTarget>,
}

impl NodeOptions {
    /// Whether the user names a switch.
    pub fn names_switch(&self) -> bool {
        self.switch.is_some()
    }

    /// Whether to ask a switch elsewhere instead of this machine's daemon: the user names one, or
    /// there is no daemon and this machine has joined a domain.
    pub fn asks_elsewhere(&self, context: &Context) -> bool {
        let has_daemon = || context.socket.is_some() || folders::admin_socket().is_ok_and(|socket| socket.exists());
        let is_joined = || self.folder().is_ok_and(|folder| Keyring::is_joined(&folder));
        self.switch.is_some() || (!has_daemon() && is_joined())
    }

    /// Opens the keyring, and warns about omitted files.
    pub fn keyring(&self) -> anyhow::Result<Keyring> {
        let keyring = Keyring::open(&self.folder()?)?;
        for reason in &keyring.left_out {
            note(format_args!("gdp-ctl: warning: left out: {reason}"));
        }
        Ok(keyring)
    }

    /// The user's keyring, or without one the folder of `gdp-proxy join`.
    fn folder(&self) -> anyhow::Result<PathBuf> {
        Ok(self.keyring.clone().map_or_else(Keyring::default_folder, Ok)?)
    }

    fn identity(&self) -> anyhow::Result<Identity> {
        let file = match &self.key {
            Some(file) => file.clone(),
            None => Keyring::key_file(&self.folder()?),
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

    /// Returns the links to attach by, in order of preference.
    fn links(&self, context: &Context) -> anyhow::Result<Vec<LinkConfig>> {
        if let Some(switch) = &self.switch {
            return Ok(vec![switch.clone().into()]);
        }
        let folder = self.folder()?;
        match Keyring::links(&folder)? {
            Some(links) => Ok(links),
            None => Ok(vec![local_switch(&mut context.client()?)?.into()]),
        }
    }

    /// Attaches, runs `what`, and detaches.
    pub fn with_fabric<T>(
        &self,
        keyring: Keyring,
        context: &Context,
        what: impl AsyncFnOnce(&Fabric) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        self.attached(keyring, context, async |fabric| what(fabric).await)
    }

    /// Finds the card of a topic or service (`kind`): in the keyring, or for a member of a domain
    /// also among what others share with it. Runs `what` with it, attached.
    pub fn with_card<T>(
        &self,
        name: &str,
        kind: &str,
        context: &Context,
        what: impl AsyncFnOnce(&Fabric, &NameCard) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let keyring = self.keyring()?;
        let found = keyring.find(name, kind);
        if !matches!(found, Err(FindError::Unknown { .. })) || !keyring.has_directory() {
            let card = found?;
            return self.with_fabric(keyring, context, async |fabric| what(fabric, &card).await);
        }
        self.attached(keyring, context, async |fabric| {
            let looking = format!("looking for {name} in the directory");
            let shared = while_waiting(&looking, members::find(&fabric.node, &fabric.keyring, name, kind)).await?;
            fabric.keyring.add(&shared.card, shared.grant);
            what(fabric, &shared.card).await
        })
    }

    fn attached<T>(
        &self,
        keyring: Keyring,
        context: &Context,
        what: impl AsyncFnOnce(&mut Fabric) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let (identity, links) = (self.identity()?, self.links(context)?);
        // A worker thread keeps the link alive while the main thread is blocked by a stopped
        // terminal.
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        runtime.block_on(async {
            let attaching = match links.first() {
                Some(link) => format!("attaching at {}", link.target),
                None => "attaching".to_owned(),
            };
            let mut fabric = while_waiting(&attaching, Fabric::join(keyring, identity, links)).await?;
            let clocks = tokio::spawn(show_clocks(fabric.node.clone()));
            let done = what(&mut fabric).await;
            clocks.abort();
            fabric.node.close().await;
            done
        })
    }
}

/// Names the counterparts whose clocks differ, each once a minute.
async fn show_clocks(node: Node) {
    let mut shown = BTreeMap::new();
    loop {
        tokio::time::sleep(CLOCKS_LOOK).await;
        shown.retain(|_, at: &mut Instant| at.elapsed() < CLOCKS_AGAIN);
        for difference in node.clock_differences() {
            if let Entry::Vacant(new) = shown.entry(difference.peer) {
                new.insert(Instant::now());
                note(format_args!("gdp-ctl: {difference}"));
            }
        }
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
