//! `gdp-ctl topic info`: a topic's type, its publishers with their offered QoS, and its readers.

use std::time::{Duration, Instant};

use clap::Args;
use gdp::unstable::SubscribeOptions;
use gdp_core::card::NameCard;
use gdp_ros::roster::{Dialect, Kind, Offer};
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::node::{NodeOptions, listen, unless_interrupted};
use crate::cli::context::Context;
use crate::cli::progress::while_waiting;
use crate::ros::{fabric::Entities, fabric::Fabric, feed::Feed, feed::RemotePublisher};
use gdp::unstable::called;

/// Time to wait for the writers' rosters.
const TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Debug, Args)]
pub struct Options {
    /// Topic: a ROS name, a name, the first digits of a name, or a name card.
    #[arg(value_name = "TOPIC")]
    what: String,
    /// Show each publisher with its offered QoS.
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    node: NodeOptions,
}

/// Output of `gdp-ctl topic info`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct InfoOutput {
    /// The ROS name.
    topic: String,
    name: Name,
    /// The ROS type; if publishers differ, a list of all.
    r#type: String,
    publishers: Vec<PublisherOutput>,
    writers: Vec<Name>,
    /// Writers that send no roster of ROS publishers.
    writers_without_publishers: Vec<Name>,
    subscribers: Vec<Name>,
}

/// A ROS publisher behind a writer, and its offered QoS. Times of 0 are infinite.
#[derive(Debug, Serialize, JsonSchema)]
struct PublisherOutput {
    writer: Name,
    /// Number of the publisher at its writer.
    number: u32,
    /// The full name of the publisher's node, or an empty text.
    node: String,
    r#type: String,
    type_hash: String,
    #[schemars(with = "String")]
    dialect: Dialect,
    reliability: &'static str,
    durability: &'static str,
    history: &'static str,
    depth: u32,
    deadline_ns: u64,
    lifespan_ns: u64,
    liveliness_lease_ns: u64,
    liveliness: &'static str,
}

/// Known state of a topic.
struct Info {
    entities: Entities,
    /// ROS publishers behind the writers, each with its writer and its number.
    publishers: Vec<((Name, u32), RemotePublisher)>,
    /// Writers that send no roster.
    silent: Vec<Name>,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let gather = async |fabric: &Fabric, card: &NameCard| {
        let asking = format!("asking the publishers of {}", called(card));
        let info = while_waiting(&asking, unless_interrupted(gather(fabric, card))).await?;
        Ok(info.map(|info| (card.clone(), info)))
    };
    let asked = options.node.with_card(&options.what, "topic", context, gather)?;
    let Some((card, info)) = asked else { return Ok(()) };
    context.output.print(&InfoOutput::new(&card, &info), || lines(&card, &info, options.verbose))
}

async fn gather(fabric: &Fabric, card: &NameCard) -> anyhow::Result<Info> {
    let mut feed = listen(fabric, card, SubscribeOptions::best_effort()).await?;
    let (entities, deadline) = (fabric.entities(card).await?, Instant::now() + TIMEOUT);
    let heard = |feed: &Feed| feed.publishers().keys().map(|(writer, _)| *writer).collect::<Vec<_>>();
    while entities.writers.iter().any(|writer| !heard(&feed).contains(writer)) {
        let step = tokio::time::timeout(deadline.saturating_duration_since(Instant::now()), feed.step()).await;
        if !matches!(step, Ok(Some(()))) {
            break;
        }
    }
    let heard = heard(&feed);
    let silent = entities.writers.iter().filter(|writer| !heard.contains(writer)).copied().collect();
    let publishers = feed.publishers().iter().map(|(key, publisher)| (*key, publisher.clone())).collect();
    Ok(Info { entities, publishers, silent })
}

fn kind(card: &NameCard, info: &Info) -> String {
    let mut kinds: Vec<&str> = info.publishers.iter().map(|(_, publisher)| &*publisher.kind.name).collect();
    kinds.sort_unstable();
    kinds.dedup();
    match kinds[..] {
        [] => card.get("type").unwrap_or_default().to_owned(),
        [one] => one.to_owned(),
        // Python list notation.
        _ => format!("{kinds:?}").replace('"', "'"),
    }
}

impl InfoOutput {
    fn new(card: &NameCard, info: &Info) -> Self {
        Self {
            topic: called(card).to_owned(),
            name: card.name(),
            r#type: kind(card, info),
            publishers: info.publishers.iter().map(PublisherOutput::new).collect(),
            writers: info.entities.writers.clone(),
            writers_without_publishers: info.silent.clone(),
            subscribers: info.entities.readers.clone(),
        }
    }
}

impl PublisherOutput {
    fn new(((writer, number), publisher): &((Name, u32), RemotePublisher)) -> Self {
        let Offer { reliable, transient_local, depth, deadline_ns, lifespan_ns, liveliness_ns, manual_liveliness } =
            publisher.offers;
        Self {
            writer: *writer,
            number: *number,
            node: publisher.node.to_string(),
            r#type: publisher.kind.name.clone(),
            type_hash: hash(&publisher.kind),
            dialect: publisher.kind.dialect,
            reliability: if reliable { "reliable" } else { "best_effort" },
            durability: if transient_local { "transient_local" } else { "volatile" },
            history: if depth == 0 { "keep_all" } else { "keep_last" },
            depth,
            deadline_ns,
            lifespan_ns,
            liveliness_lease_ns: liveliness_ns,
            liveliness: if manual_liveliness { "manual_by_topic" } else { "automatic" },
        }
    }
}

/// Formats the output as ros2cli does. The GID is the writer's name followed by the
/// publisher's number at the writer.
fn lines(card: &NameCard, info: &Info, verbose: bool) -> Vec<String> {
    let mut publishers = Vec::new();
    for ((writer, number), publisher) in &info.publishers {
        let gid: Vec<u8> = [&writer.as_bytes()[..], &number.to_be_bytes()].concat();
        publishers.push(endpoint("PUBLISHER", &gid, Some(publisher), card));
    }
    publishers.extend(info.silent.iter().map(|writer| endpoint("PUBLISHER", writer.as_bytes(), None, card)));
    let readers = info.entities.readers.iter();
    let subscriptions: Vec<_> = readers.map(|reader| endpoint("SUBSCRIPTION", reader.as_bytes(), None, card)).collect();

    let mut parts = vec![vec![format!("Type: {}", kind(card, info))]];
    for (what, endpoints) in [("Publisher", publishers), ("Subscription", subscriptions)] {
        parts.push(vec![format!("{what} count: {}", endpoints.len())]);
        if verbose {
            parts.extend(endpoints);
        }
    }
    if verbose { parts.join(&String::new()) } else { parts.concat() }
}

fn endpoint(what: &str, gid: &[u8], publisher: Option<&RemotePublisher>, card: &NameCard) -> Vec<String> {
    let gid = gid.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(".");
    let (kind, hash) = match publisher {
        Some(publisher) => (publisher.kind.name.clone(), hash(&publisher.kind)),
        None => (card.get("type").unwrap_or_default().to_owned(), "INVALID".into()),
    };
    let node = publisher.and_then(|publisher| publisher.node.rsplit_once('/'));
    let (namespace, node) = match node {
        Some(("", node)) => ("/", node),
        Some(full) => full,
        None => ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_"),
    };
    let mut lines = vec![
        format!("Node name: {node}"),
        format!("Node namespace: {namespace}"),
        format!("Topic type: {kind}"),
        format!("Topic type hash: {hash}"),
        format!("Endpoint type: {what}"),
        format!("GID: {gid}"),
    ];
    if let Some(publisher) = publisher {
        lines.push("QoS profile:".to_owned());
        lines.extend(qos(&publisher.offers));
    }
    lines
}

fn qos(offers: &Offer) -> [String; 7] {
    let time = |nanos: u64| if nanos == 0 { "Infinite".to_owned() } else { format!("{nanos} nanoseconds") };
    let history = match offers.depth {
        0 => "KEEP_ALL".to_owned(),
        depth => format!("KEEP_LAST ({depth})"),
    };
    [
        format!("  Reliability: {}", if offers.reliable { "RELIABLE" } else { "BEST_EFFORT" }),
        format!("  History (Depth): {history}"),
        format!("  Durability: {}", if offers.transient_local { "TRANSIENT_LOCAL" } else { "VOLATILE" }),
        format!("  Lifespan: {}", time(offers.lifespan_ns)),
        format!("  Deadline: {}", time(offers.deadline_ns)),
        format!("  Liveliness: {}", if offers.manual_liveliness { "MANUAL_BY_TOPIC" } else { "AUTOMATIC" }),
        format!("  Liveliness lease duration: {}", time(offers.liveliness_ns)),
    ]
}

fn hash(kind: &Kind) -> String {
    match kind.dialect {
        _ if kind.hash.is_empty() => "INVALID".into(),
        Dialect::Ros1 => hex::encode(&kind.hash),
        Dialect::Ros2 => format!("RIHS01_{}", hex::encode(&kind.hash)),
    }
}
