//! What would be exposed: the ROS graphs are looked at for a while, the fabric is not touched.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

use anyhow::Result;
use futures::future::join_all;
use gdp::Name;
use serde::Serialize;

use crate::automatic::{card_of, judge};
use crate::config::{Direction, Side};
use crate::graph::{self, Onlooker, Published, Topics};
use crate::reload::Loaded;
use crate::ros2::{ShownQos, TopicName};

/// Of the JSON form: another one whenever a key goes, or means something else.
const VERSION: u32 = 1;

/// What crosses, and what does not.
#[derive(Serialize)]
pub struct Report {
    version: u32,
    /// The proxy's own name.
    entity: Name,
    topics: Vec<Row>,
    /// Catalogs of which the topics that match come in; what they list shows only in the fabric.
    imports: Vec<Name>,
}

/// A topic in one direction, or one that does not cross.
#[derive(Serialize)]
struct Row {
    graph: String,
    topic: String,
    /// As ROS 2 writes it; null if nobody says it yet.
    #[serde(rename = "type")]
    kind: Option<String>,
    /// Of the publishers here, if they show it.
    qos: Option<String>,
    /// Null if it does not cross.
    direction: Option<Side>,
    name: Option<Name>,
    /// What it is called elsewhere.
    called: Option<String>,
    /// Under which key of the configuration it crosses, or why it does not.
    because: String,
}

/// Looks for so long. The graphs are joined under a name of their own, so a proxy that runs is not disturbed.
pub async fn run(Loaded { config, material }: &Loaded, patience: Duration) -> Result<Report> {
    let mut graphs = graph::All::new();
    graph::join(&mut graphs, &config.graphs, &format!("{}dry_run_{}", graph::NODE, std::process::id())).await?;
    let looked = graphs.iter().map(|(label, graph)| look(label, Onlooker::of(graph), patience));
    let found: BTreeMap<String, Topics> = join_all(looked).await.into_iter().collect();
    graph::leave(graphs).await;

    let none = Topics::new();
    let topics_of = |label: &str| found.get(label).unwrap_or(&none);
    let (mut rows, mut explicit) = (vec![], BTreeSet::new());
    for (at, route) in &material.routes {
        let topic = &config.topics[*at];
        let Ok((label, _)) = config.graphs.get(topic.graph.as_deref()) else { continue };
        let published = topics_of(label).get(&topic.topic);
        let kind = route.kind.as_ref().or_else(|| Some(&published?.first()?.kind));
        if topic.direction != Direction::In {
            explicit.insert((label.to_owned(), topic.topic.clone()));
        }
        rows.push(Row {
            graph: label.into(),
            topic: topic.topic.to_string(),
            kind: kind.map(ToString::to_string),
            qos: qos(published.map(Vec::as_slice)),
            direction: Some(route.permission.side()),
            name: Some(route.card.name()),
            called: route.card.get("topic").map(str::to_owned),
            because: format!("topics[{at}]"),
        });
    }
    for (label, topics) in &found {
        let here = |(topic, _): &(&TopicName, _)| !explicit.contains(&(label.clone(), (*topic).clone()));
        for (topic, published) in topics.iter().filter(here) {
            let Some(first) = published.first() else { continue };
            let row = Row {
                graph: label.clone(),
                topic: topic.to_string(),
                kind: Some(first.kind.to_string()),
                qos: qos(Some(published)),
                direction: None,
                name: None,
                called: None,
                because: "not under topics".into(),
            };
            let expose = config.expose.as_ref().zip(material.expose.as_ref());
            let of_graph =
                |graph: &Option<String>| config.graphs.get(graph.as_deref()).is_ok_and(|(it, _)| it == label);
            rows.push(match expose.filter(|(expose, _)| of_graph(&expose.graph)) {
                None => row,
                Some((expose, material)) => match judge(expose, topic, &first.kind) {
                    Err(why) => Row { because: why.to_string(), ..row },
                    Ok(exposed) => {
                        let name = Some(card_of(&material.owner, &first.kind, &exposed)?.name());
                        let (direction, called) = (Some(Side::Out), Some(exposed.name.to_string()));
                        Row { direction, name, called, because: "expose".into(), ..row }
                    }
                },
            });
        }
    }
    let imports = material.imports.iter().map(|import| import.catalog.name()).collect();
    Ok(Report { version: VERSION, entity: material.identity.name(), topics: rows, imports })
}

async fn look(label: &str, mut onlooker: Onlooker, patience: Duration) -> (String, Topics) {
    let forever = async {
        loop {
            onlooker.changed().await;
        }
    };
    _ = tokio::time::timeout(patience, forever).await;
    (label.to_owned(), onlooker.topics())
}

/// `reliable, volatile`; of several, all that differ.
fn qos(published: Option<&[Published]>) -> Option<String> {
    let shown = |qos: ShownQos| format!("{:?}, {:?}", qos.reliability, qos.durability);
    let all: BTreeSet<String> = published?.iter().filter_map(|it| it.qos.map(shown)).collect();
    (!all.is_empty()).then(|| all.into_iter().collect::<Vec<_>>().join("; "))
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for row in &self.topics {
            let sign = match row.direction {
                Some(Side::Out) => "out",
                Some(Side::In) => "in",
                None => "-",
            };
            let Row { graph, topic, kind, qos, name, called, because, .. } = row;
            write!(f, "{sign:3} {topic} [{}] in {graph}", kind.as_deref().unwrap_or("type not known"))?;
            if let Some(qos) = qos {
                write!(f, " ({qos})")?;
            }
            match (name, called) {
                (Some(name), Some(called)) if called != topic => writeln!(f, ": {name} as {called}, {because}")?,
                (Some(name), _) => writeln!(f, ": {name}, {because}")?,
                (None, _) => writeln!(f, ": {because}")?,
            }
        }
        for name in &self.imports {
            writeln!(f, "in  what the catalog {name} lists and matches")?;
        }
        Ok(())
    }
}
