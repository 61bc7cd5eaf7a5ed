//! `gdp-ctl topic list`, also for services and actions: the cards in the keyring, and the entities
//! of their names.

use clap::Args;
use gdp_core::card::NameCard;
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::node::{NodeOptions, unless_interrupted};
use crate::cli::context::Context;
use crate::cli::progress::while_waiting;
use crate::ros::fabric::{Entities, Fabric};
use gdp::unstable::called;
use gdp::unstable::members;

#[derive(Debug, Args)]
pub struct ListOptions {
    /// Print the types as well.
    #[arg(short = 't', long)]
    show_types: bool,
    /// Print only the number of entries.
    #[arg(short, long)]
    count: bool,
    /// Query the RIB, and print only entries with publishers, subscribers, servers or clients, and
    /// the number of these.
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    node: NodeOptions,
}

/// Output of the `list` commands.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ListOutput {
    Topics(Vec<ListEntry>),
    Services(Vec<ListEntry>),
    Actions(Vec<ListEntry>),
    /// Only the number of cards.
    Count(usize),
}

/// A card of the keyring.
#[derive(Debug, Serialize, JsonSchema)]
pub struct ListEntry {
    /// The ROS name.
    topic: String,
    /// The ROS type.
    r#type: String,
    name: Name,
    /// Present only if the RIB was asked.
    #[serde(flatten)]
    entities: Option<Sides>,
}

/// Entities of a name.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
enum Sides {
    Topic { publishers: Vec<Name>, subscribers: Vec<Name> },
    Service { servers: Vec<Name>, clients: Vec<Name> },
}

impl ListEntry {
    fn new(alias: &str, card: &NameCard, entities: Option<Sides>) -> Self {
        let r#type = card.get("type").unwrap_or_default().to_owned();
        Self { topic: alias.to_owned(), r#type, name: card.name(), entities }
    }
}

/// Lists the cards of `kind`: `topic`, `service` or `action`. For a member of a domain, it also
/// lists what other members share with it.
pub fn list(kind: &str, options: &ListOptions, context: &Context) -> anyhow::Result<()> {
    let keyring = options.node.keyring()?;
    let asks_rib = options.verbose || (context.output.json && !options.count);
    let own = keyring.cards(kind).map(|card| (called(card).to_owned(), card.clone())).collect();
    let entries = if asks_rib || keyring.has_directory() {
        let ask = async |fabric: &Fabric| gather(kind, own, asks_rib, fabric).await;
        let asked = options.node.with_fabric(keyring, context, async |fabric| unless_interrupted(ask(fabric)).await);
        let Some(asked) = asked? else { return Ok(()) };
        asked
    } else {
        sorted(own).iter().map(|(alias, card)| ListEntry::new(alias, card, None)).collect()
    };
    let lines = match options {
        ListOptions { count: true, .. } => vec![entries.len().to_string()],
        ListOptions { verbose: true, .. } => verbose(kind, &entries),
        _ => entries.iter().map(|entry| line(entry, options.show_types)).collect(),
    };
    let output = match kind {
        _ if options.count => ListOutput::Count(entries.len()),
        "topic" => ListOutput::Topics(entries),
        "service" => ListOutput::Services(entries),
        _ => ListOutput::Actions(entries),
    };
    context.output.print(&output, || lines)
}

fn sorted(mut cards: Vec<(String, NameCard)>) -> Vec<(String, NameCard)> {
    cards.sort_by_key(|(alias, card)| (alias.clone(), card.name()));
    cards
}

/// Returns the entries of these cards and of those that members share, with their entities if the
/// RIB is asked.
async fn gather(
    kind: &str,
    mut cards: Vec<(String, NameCard)>,
    asks_rib: bool,
    fabric: &Fabric,
) -> anyhow::Result<Vec<ListEntry>> {
    if fabric.keyring.has_directory() {
        let (shared, unanswered) =
            while_waiting("asking the members of the domain", members::all(&fabric.node, &fabric.keyring, kind))
                .await?;
        cards.extend(shared.into_iter().map(|shared| (shared.alias, shared.card)));
        unanswered.iter().for_each(|why| note(format_args!("gdp-ctl: warning: {why}")));
    }
    let mut entries = Vec::new();
    for (alias, card) in sorted(cards) {
        let sides = match asks_rib {
            true => {
                let Entities { writers, readers } = fabric.entities(&card).await?;
                Some(match kind {
                    "topic" => Sides::Topic { publishers: writers, subscribers: readers },
                    _ => Sides::Service { servers: writers, clients: readers },
                })
            }
            false => None,
        };
        entries.push(ListEntry::new(&alias, &card, sides));
    }
    Ok(entries)
}

fn line(entry: &ListEntry, with_type: bool) -> String {
    if with_type { format!("{} [{}]", entry.topic, entry.r#type) } else { entry.topic.clone() }
}

fn verbose(kind: &str, entries: &[ListEntry]) -> Vec<String> {
    let titles = match kind {
        "topic" => [("Published", "publisher"), ("Subscribed", "subscriber")],
        _ => [("Served", "server"), ("Called", "client")],
    };
    let part = |(heading, what): (&str, &str), side: usize| {
        let lines = entries.iter().filter_map(|entry| {
            let (Sides::Topic { publishers: writers, subscribers: readers }
            | Sides::Service { servers: writers, clients: readers }) = entry.entities.as_ref()?;
            let count = [writers.len(), readers.len()][side];
            let plural = if count == 1 { "" } else { "s" };
            (count > 0).then(|| format!(" * {} [{}] {count} {what}{plural}", entry.topic, entry.r#type))
        });
        std::iter::once(format!("{heading} {kind}s:")).chain(lines).collect::<Vec<_>>()
    };
    [part(titles[0], 0), part(titles[1], 1)].join(&String::new())
}
