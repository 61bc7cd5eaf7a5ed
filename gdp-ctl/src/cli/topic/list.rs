//! `gdp-ctl topic list`, and likewise of services and actions: what the keyring has cards of, and
//! who is there.

use clap::Args;
use gdp_core::card::NameCard;
use gdp_wire::Name;
use serde_json::{Value, json};

use super::super::node::{NodeOptions, unless_interrupted};
use crate::cli::context::Context;
use crate::ros::keyring::called;
use crate::ros::{fabric::Fabric, fabric::Parties};

#[derive(Debug, Args)]
pub struct ListOptions {
    /// Print the type, too.
    #[arg(short = 't', long)]
    show_types: bool,
    /// Print only how many there are.
    #[arg(short, long)]
    count: bool,
    /// Ask the RIB who is there, and print what has somebody.
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    node: NodeOptions,
}

struct Entry {
    topic: String,
    kind: String,
    name: Name,
    parties: Option<Parties>,
}

impl Entry {
    fn new(card: &NameCard, parties: Option<Parties>) -> Self {
        let kind = card.get("type").unwrap_or_default().to_owned();
        Self { topic: called(card).to_owned(), kind, name: card.name(), parties }
    }

    fn value(&self, [writers, readers]: [&str; 2]) -> Value {
        let mut value = json!({"topic": self.topic, "type": self.kind, "name": self.name});
        if let Some(parties) = &self.parties {
            value[writers] = json!(parties.writers);
            value[readers] = json!(parties.readers);
        }
        value
    }
}

/// `kind`: `topic`, `service` or `action`.
pub fn list(kind: &str, options: &ListOptions, context: &Context) -> anyhow::Result<()> {
    let keyring = options.node.keyring()?;
    let mut cards: Vec<NameCard> = keyring.cards(kind).cloned().collect();
    cards.sort_by_key(|card| (called(card).to_owned(), card.name()));
    let mut entries: Vec<Entry> = cards.iter().map(|card| Entry::new(card, None)).collect();
    if options.verbose || (context.output.json && !options.count) {
        let ask = async |fabric: &Fabric| {
            let mut entries = Vec::new();
            for card in &cards {
                entries.push(Entry::new(card, Some(fabric.parties(card).await?)));
            }
            Ok(entries)
        };
        let asked = options.node.with_fabric(keyring, context, async |fabric| unless_interrupted(ask(fabric)).await);
        let Some(asked) = asked? else { return Ok(()) };
        entries = asked;
    }
    let sides = if kind == "topic" { ["publishers", "subscribers"] } else { ["servers", "clients"] };
    let value = match options.count {
        true => json!({"count": entries.len()}),
        false => json!({format!("{kind}s"): entries.iter().map(|entry| entry.value(sides)).collect::<Vec<_>>()}),
    };
    context.output.print(value, || match options {
        ListOptions { count: true, .. } => vec![entries.len().to_string()],
        ListOptions { verbose: true, .. } => verbose(kind, &entries, sides),
        _ => entries.iter().map(|entry| line(entry, options.show_types)).collect(),
    })
}

fn line(entry: &Entry, with_type: bool) -> String {
    if with_type { format!("{} [{}]", entry.topic, entry.kind) } else { entry.topic.clone() }
}

fn verbose(kind: &str, entries: &[Entry], [writers, readers]: [&str; 2]) -> Vec<String> {
    let heading = if kind == "topic" { ["Published", "Subscribed"] } else { ["Served", "Called"] };
    let part = |heading: &str, what: &str, count: &dyn Fn(&Parties) -> usize| {
        let shown = entries.iter().filter_map(|entry| Some((entry, entry.parties.as_ref().map(count)?)));
        let lines = shown.filter(|(_, count)| *count > 0).map(|(entry, count)| {
            let what = if count == 1 { what.trim_end_matches('s') } else { what };
            format!(" * {} [{}] {count} {what}", entry.topic, entry.kind)
        });
        std::iter::once(format!("{heading} {kind}s:")).chain(lines).collect::<Vec<_>>()
    };
    let published = part(heading[0], writers, &|parties| parties.writers.len());
    [published, part(heading[1], readers, &|parties| parties.readers.len())].join(&String::new())
}
