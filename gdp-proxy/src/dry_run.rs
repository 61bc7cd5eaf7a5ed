//! What would be exposed: the ROS graphs are looked at for a while, the fabric is not touched.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

use anyhow::Result;
use futures::future::join_all;
use gdp::Name;
use serde::Serialize;

use crate::automatic::{card_of, choose, judge};
use crate::config::Side;
use crate::graph::{self, Onlooker, Published, Topics};
use crate::reload::Loaded;
use crate::ros2::{ShownQos, TopicName, TypeName};

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

/// A topic in one direction, or one that does not cross, or publishers of it that do not because they use another type.
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
pub async fn run(loaded: &Loaded, patience: Duration) -> Result<Report> {
    let mut graphs = graph::All::new();
    graph::join(&mut graphs, &loaded.config.graphs, &format!("{}dry_run_{}", graph::NODE, std::process::id())).await?;
    let looked = graphs.iter().map(|(label, graph)| look(label, Onlooker::of(graph), patience));
    let found: BTreeMap<String, Topics> = join_all(looked).await.into_iter().collect();
    graph::leave(graphs).await;
    report(loaded, &found)
}

/// What would cross of what there is in the graphs, by their names in the configuration.
fn report(Loaded { config, material }: &Loaded, found: &BTreeMap<String, Topics>) -> Result<Report> {
    let none = Topics::new();
    let topics_of = |label: &str| found.get(label).unwrap_or(&none);
    let (mut rows, mut explicit) = (vec![], BTreeSet::new());
    for (at, route) in &material.routes {
        let topic = &config.topics[*at];
        let Ok((label, _)) = config.graphs.get(topic.graph.as_deref()) else { continue };
        let published = topics_of(label).get(&topic.topic).map_or(&[][..], Vec::as_slice);
        let kind = route.kind.as_ref().or_else(|| Some(&published.first()?.kind));
        let row = |kind: Option<&TypeName>| Row::new(label, &topic.topic, kind, published);
        rows.push(Row {
            direction: Some(route.permission.side()),
            name: Some(route.card.name()),
            called: route.card.get("topic").map(str::to_owned),
            because: format!("topics[{at}]"),
            ..row(kind)
        });
        if route.permission.side() == Side::Out {
            explicit.insert((label.to_owned(), topic.topic.clone()));
            let others = kinds(published).into_iter().filter(|other| Some(*other) != kind);
            rows.extend(others.map(|other| Row { because: another_type(kind), ..row(Some(other)) }));
        }
    }
    for (label, topics) in found {
        let here = |(topic, _): &(&TopicName, _)| !explicit.contains(&(label.clone(), (*topic).clone()));
        let of_graph = |graph: &Option<String>| config.graphs.get(graph.as_deref()).is_ok_and(|(it, _)| it == label);
        let expose = config.expose.as_ref().zip(material.expose.as_ref());
        let expose = expose.filter(|(expose, _)| of_graph(&expose.graph));
        for (topic, published) in topics.iter().filter(here) {
            let chosen = expose.and_then(|(expose, _)| choose(expose, topic, published));
            for kind in kinds(published) {
                let row = Row::new(label, topic, Some(kind), published);
                rows.push(match (expose, &chosen) {
                    (None, _) => row,
                    (Some((_, material)), Some((chosen, exposed))) if chosen == kind => Row {
                        direction: Some(Side::Out),
                        name: Some(card_of(&material.owner, kind, exposed)?.name()),
                        called: Some(exposed.name.to_string()),
                        because: "expose".into(),
                        ..row
                    },
                    (Some((expose, _)), chosen) => match judge(expose, topic, kind) {
                        Err(why) => Row { because: why.to_string(), ..row },
                        Ok(_) => Row { because: another_type(chosen.as_ref().map(|(chosen, _)| chosen)), ..row },
                    },
                });
            }
        }
    }
    let imports = material.imports.iter().map(|import| import.catalog.name()).collect();
    Ok(Report { version: VERSION, entity: material.identity.name(), topics: rows, imports })
}

/// All that a topic is published as, each once, in the order in which they are published.
fn kinds(published: &[Published]) -> Vec<&TypeName> {
    let mut kinds = Vec::new();
    for Published { kind, .. } in published {
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    kinds
}

fn another_type(chosen: Option<&TypeName>) -> String {
    let chosen = chosen.map_or_else(|| "another type".into(), ToString::to_string);
    format!("the topic crosses as {chosen}, and a topic is of one type: that of whom the proxy sees first")
}

impl Row {
    /// Of a topic that is published so, as far as it is of this type: it does not cross.
    fn new(graph: &str, topic: &TopicName, kind: Option<&TypeName>, published: &[Published]) -> Self {
        let of_kind = published.iter().filter(|it| Some(&it.kind) == kind);
        Self {
            graph: graph.into(),
            topic: topic.to_string(),
            kind: kind.map(ToString::to_string),
            qos: qos(of_kind),
            direction: None,
            name: None,
            called: None,
            because: "not under topics".into(),
        }
    }
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
fn qos<'a>(published: impl Iterator<Item = &'a Published>) -> Option<String> {
    let shown = |qos: ShownQos| format!("{:?}, {:?}", qos.reliability, qos.durability);
    let all: BTreeSet<String> = published.filter_map(|it| it.qos.map(shown)).collect();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ExposeConfig;
    use crate::material::Material;
    use crate::material::tests::Files;

    #[test]
    fn of_publishers_of_several_types_it_is_shown_who_crosses_and_why_others_do_not() {
        let files = Files::new();
        files.owner.save_new(&files.path("owner.pem")).unwrap();
        let mut config = files.config("");
        let expose = "{owner: owner.pem, catalog: t.card, topics: [/**], deny: [/d], types: [a/msg/B, a/msg/C]}";
        let mut expose: ExposeConfig = serde_saphyr::from_str(expose).unwrap();
        (expose.owner, expose.catalog) = (files.path("owner.pem"), files.path("other.card"));
        let catalog = gdp::NameCard::create(files.owner.verify_key(), "catalog", "/robot", "", None).unwrap();
        catalog.save_new(&expose.catalog).unwrap();
        config.expose = Some(expose);
        let loaded = Loaded { material: Material::load(&config).unwrap(), config };

        let published = |kinds: &str| {
            let kind = |kind| Published { kind: TypeName::parse(kind).unwrap(), qos: None };
            kinds.split(' ').map(kind).collect::<Vec<_>>()
        };
        let topic = |name: &str| TopicName::parse(name).unwrap();
        let string = "std_msgs/msg/String";
        let topics = Topics::from([
            (topic("/a"), published("a/msg/A a/msg/B a/msg/C a/msg/B")),
            (topic("/chatter"), published("a/msg/A std_msgs/msg/String")),
            (topic("/d"), published("a/msg/B a/msg/C")),
        ]);
        let report = report(&loaded, &BTreeMap::from([("ros2".into(), topics)])).unwrap();
        let shown = |topic: &str| {
            let rows = report.topics.iter().filter(|row| row.topic == topic);
            rows.map(|row| (row.kind.as_deref().unwrap(), row.direction, row.because.as_str())).collect::<Vec<_>>()
        };
        let crosses_as = |kind| another_type(Some(&TypeName::parse(kind).unwrap()));
        assert_eq!(
            shown("/a"),
            [
                ("a/msg/A", None, "its type is not one of types"),
                ("a/msg/B", Some(Side::Out), "expose"),
                ("a/msg/C", None, &crosses_as("a/msg/B")),
            ]
        );
        assert_eq!(shown("/chatter"), [(string, Some(Side::Out), "topics[0]"), ("a/msg/A", None, &crosses_as(string))]);
        assert_eq!(shown("/d"), [("a/msg/B", None, "deny has /d"), ("a/msg/C", None, "deny has /d")]);
    }
}
