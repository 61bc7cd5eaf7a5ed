//! Name arguments of `trace` and `ping`, and the paths to them: in the view of the local daemon, or
//! of the switch to which the user's key attaches.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use gdp::Reading;
use gdp::unstable::{Client as ServiceClient, NodeError, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::name::NamePrefix;
use gdp_proto::admin::Request;
use gdp_proto::admin::trace::{BeyondReply, DomainHop, EchoReply, LocateReply, PathEnd, ProbeReply};
use gdp_proto::control::{Inspected, Inspection, NameLocation, ProbeEnd, RefusalCode};
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;

use crate::cli::context::Context;
use crate::cli::node::NodeOptions;
use crate::client::Client;
use crate::ros::fabric::Fabric;
use gdp::FindError;
use gdp::unstable::called;
use gdp::unstable::members;

/// Maximum number of publishers or servers to which a reader or caller traces.
const MAX_COUNTERPARTS: usize = 8;

/// Attempts, and the pause between them, while the switch answers that there were too many
/// questions.
const ATTEMPTS: usize = 30;
const PAUSE: Duration = Duration::from_millis(100);

/// The located names, and who answers about their paths.
pub struct Paths<'a> {
    view: Vantage<'a>,
    /// One location. A reader has one for each publisher.
    pub locations: Vec<LocateReply>,
    /// Round-trip time from this command to the first switch; 0 for that of this machine.
    pub first_us: u64,
}

enum Vantage<'a> {
    Daemon(Client),
    /// The registration is what entitles this command to answers.
    Switch {
        fabric: &'a Fabric,
        _registration: Option<Registration>,
    },
}

/// A registration for the time of the command. Dropping it withdraws it.
#[expect(dead_code, reason = "the handles are kept for their drop")]
enum Registration {
    Publisher(Box<Publisher>),
    Subscription(Box<Subscription>),
    Client(Box<ServiceClient>),
}

/// Locates a name by card file, whole name or unique prefix, and runs `what` with its paths. The
/// names are those that the daemon's switch knows; with `--switch`, those of the keyring.
pub fn with_paths<T>(
    name: &str,
    node: &NodeOptions,
    context: &Context,
    what: impl AsyncFnOnce(&mut Paths<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    if node.asks_elsewhere(context) {
        let by_node = async |fabric: &Fabric| what(&mut Paths::of_switch(name, fabric).await?).await;
        return node.with_fabric(node.keyring()?, context, by_node);
    }
    with_daemon_paths(&prefix(name)?, context.client()?, what)
}

/// Locates a name that the daemon's switch knows, and runs `what` with its paths.
pub fn with_daemon_paths<T>(
    name: &NamePrefix,
    mut client: Client,
    what: impl AsyncFnOnce(&mut Paths<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let location = client.ask(&Request::Locate { what: name.clone() })?;
    let mut paths = Paths { view: Vantage::Daemon(client), locations: vec![location], first_us: 0 };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(what(&mut paths))
}

fn prefix(what: &str) -> anyhow::Result<NamePrefix> {
    let path = Path::new(what);
    if path.is_file() {
        return Ok(NameCard::load(path)?.name().into());
    }
    what.parse().with_context(|| format!("{what} is neither a file nor the beginning of a name"))
}

impl<'a> Paths<'a> {
    async fn of_switch(what: &str, fabric: &'a Fabric) -> anyhow::Result<Self> {
        let own = fabric.node.switch()?;
        let begun = Instant::now();
        locate(fabric, own, own).await?;
        let first_us = begun.elapsed().as_micros() as u64;
        let (names, registration) = match find(what, own, fabric) {
            Ok(Target::Name(name)) => (vec![name], None),
            Ok(Target::Card(card)) => register(&card, fabric, None).await?,
            Err(_) if what.starts_with('/') && fabric.keyring.has_directory() => {
                let shared = members::find(&fabric.node, &fabric.keyring, what, "topic").await?;
                register(&shared.card, fabric, Some(shared.grant)).await?
            }
            Err(error) => return Err(error),
        };
        let mut locations = Vec::new();
        for name in names {
            let located = locate(fabric, own, name).await;
            match located {
                // A name without receivers has no route.
                Err(error) if registration.is_some() && is_unknown(&error) => {}
                located => locations.push(located?),
            }
        }
        if locations.iter().all(|location| location.egress.is_empty()) {
            bail!("nobody receives {what} now, so no path leads there");
        }
        Ok(Self { view: Vantage::Switch { fabric, _registration: registration }, locations, first_us })
    }

    /// Returns the round-trip time of an echo to a neighbour of the daemon's switch.
    pub fn echo(&mut self, peer: Name) -> anyhow::Result<EchoReply> {
        match &mut self.view {
            Vantage::Daemon(client) => Ok(client.ask(&Request::Echo { peer })?),
            Vantage::Switch { .. } => Ok(EchoReply { rtt_us: None }),
        }
    }

    /// Sends a probe at most `hops` switches far. With `--switch`, the time includes the link to
    /// the switch.
    pub async fn probe(&mut self, location: &LocateReply, switch: Name, hops: u8) -> anyhow::Result<ProbeReply> {
        match &mut self.view {
            Vantage::Daemon(_) if switch == location.own => {
                Ok(ProbeReply { switch: Some(switch), rtt_us: Some(0), end: Some(location.end.clone()) })
            }
            Vantage::Daemon(client) => Ok(client.ask(&Request::Probe { name: location.name, switch, hops })?),
            Vantage::Switch { fabric, .. } => {
                let inspection = Inspection::Probe { name: location.name, egress: switch, hops };
                let (Inspected::Probe(ProbeEnd { switch, links }), time) = inspect(fabric, inspection).await? else {
                    bail!("the switch answered another question");
                };
                let end = links.map(|links| PathEnd { links, beyond: Vec::new() });
                Ok(ProbeReply { rtt_us: switch.map(|_| time.as_micros() as u64), switch, end })
            }
        }
    }

    /// Returns the domains behind a border. An endpoint is not shown any.
    pub fn beyond(&mut self, name: Name, border: Name, end: &PathEnd) -> anyhow::Result<Vec<DomainHop>> {
        let mut domains = Vec::new();
        if let Vantage::Daemon(client) = &mut self.view {
            for beyond in &end.beyond {
                let request = Request::Beyond { name, border, domain: beyond.domain, peer: beyond.switch };
                domains.extend(client.ask::<BeyondReply>(&request)?.domains);
            }
        }
        Ok(domains)
    }
}

/// Returns whether the switch answers that there is no such name for this entity.
fn is_unknown(error: &anyhow::Error) -> bool {
    match error.downcast_ref() {
        Some(NodeError::Refused(refusal)) => refusal.code == RefusalCode::NotFound,
        _ => false,
    }
}

/// What the user names, with `--switch`.
enum Target {
    Card(Box<NameCard>),
    Name(Name),
}

fn find(what: &str, own: Name, fabric: &Fabric) -> anyhow::Result<Target> {
    let mut unknown = None;
    for kind in ["topic", "service"] {
        match fabric.keyring.find(what, kind) {
            Ok(card) => return Ok(Target::Card(Box::new(card))),
            Err(error @ FindError::Ambiguous { .. }) => return Err(error.into()),
            Err(error) => unknown.get_or_insert(error),
        };
    }
    match what.parse::<NamePrefix>().ok() {
        Some(prefix) if prefix.matches(&own) => Ok(Target::Name(own)),
        Some(prefix) if prefix.full().is_some() => Ok(Target::Name(prefix.full().unwrap_or(own))),
        _ => {
            let error = unknown.map(anyhow::Error::from).unwrap_or_else(|| anyhow::anyhow!("{what} is not a name"));
            Err(error.context(format!("with --switch, {what} must be in the keyring, or be the switch {own:#}")))
        }
    }
}

/// Registers with the right to the name that the keyring has, or with this grant. Returns the names
/// to which this entity may then send.
async fn register(
    card: &NameCard,
    fabric: &Fabric,
    grant: Option<Reading>,
) -> anyhow::Result<(Vec<Name>, Option<Registration>)> {
    let (node, now) = (&fabric.node, unix_seconds());
    let is_service = card.get("kind") == Some("service");
    if !is_service
        && grant.is_none()
        && let Ok(right) = fabric.keyring.ad(card, node.name(), now)
    {
        let publisher = node.publish(card.proof(), right, PublishOptions::best_effort()).await?;
        return Ok((vec![card.name()], Some(Registration::Publisher(Box::new(publisher)))));
    }
    let grant = match grant {
        Some(grant) => grant,
        None => fabric.keyring.grant(card, node.name(), now)?,
    };
    let registration = match is_service {
        true => Registration::Client(Box::new(node.client(card.proof(), grant).await?)),
        false => {
            let subscription = node.subscribe(card.proof(), grant, SubscribeOptions::as_offered()).await?;
            Registration::Subscription(Box::new(subscription))
        }
    };
    let mut names = fabric.entities(card).await?.writers;
    names.truncate(MAX_COUNTERPARTS);
    if names.is_empty() {
        bail!("nobody {} {} now", if is_service { "serves" } else { "publishes" }, called(card));
    }
    Ok((names, Some(registration)))
}

async fn locate(fabric: &Fabric, own: Name, name: Name) -> anyhow::Result<LocateReply> {
    let (Inspected::Location(NameLocation { egress, links }), _) = inspect(fabric, Inspection::Locate { name }).await?
    else {
        bail!("the switch answered another question");
    };
    let end = PathEnd { links, beyond: Vec::new() };
    Ok(LocateReply { name, own, near: false, egress, end })
}

/// Asks the switch; waits while it answers that there were too many questions. Returns the answer
/// and its round-trip time.
async fn inspect(fabric: &Fabric, inspection: Inspection) -> anyhow::Result<(Inspected, Duration)> {
    for _ in 0..ATTEMPTS {
        let begun = Instant::now();
        match fabric.node.inspect(inspection.clone()).await {
            Err(NodeError::Refused(refusal)) if refusal.code == RefusalCode::Limit => {
                tokio::time::sleep(PAUSE).await;
            }
            answer => return Ok((answer?, begun.elapsed())),
        }
    }
    bail!("the switch answers too many questions; try again later")
}

/// Formats a time in microseconds as milliseconds.
pub fn millis(micros: u64) -> String {
    format!("{}.{:03} ms", micros / 1000, micros % 1000)
}
