//! Prints what would be exposed. The proxy observes the ROS graphs for a while and does not attach
//! to the fabric.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

use anyhow::Result;
use futures::future::join_all;
use gdp_wire::Name;
use serde::Serialize;

use crate::automatic::{card_of, check_exposed, choose};
use crate::config::{Config, ExposeConfig, Side, Thing, What, is_hidden};
use crate::graph::{self, Found, GraphObserver, Offered};
use crate::material::{ExposeMaterial, Material};
use crate::reload::Loaded;
use crate::ros2::{DisplayedQos, TopicName, TypeName};
use crate::route_material::RouteMaterial;

/// Version of the JSON form. It changes whenever a key is removed or changes its meaning.
const VERSION: u32 = 1;

/// The topics, services and actions of the ROS graphs, and whether they cross.
#[derive(Serialize)]
pub struct Report {
    version: u32,
    /// The proxy's own name.
    entity: Name,
    topics: Vec<Row>,
    /// Services and actions. Those that every node has are included only if they cross.
    calls: Vec<Row>,
    /// Imported catalogs. Only the fabric shows what they list.
    imports: Vec<Name>,
}

/// One direction of a topic, service or action; or one that does not cross, for example because it
/// is offered with another type.
#[derive(Serialize)]
struct Row {
    graph: String,
    #[serde(flatten)]
    of: Of,
    /// The ROS type as ROS 2 writes it; null while it is unknown.
    #[serde(rename = "type")]
    kind: Option<String>,
    /// The QoS of the local publishers, if they announce it.
    qos: Option<String>,
    /// Null if it does not cross.
    direction: Option<Side>,
    name: Option<Name>,
    /// Its name in other graphs.
    called: Option<String>,
    /// The key of the configuration that lets it cross, or the reason why it does not cross.
    because: String,
}

/// The kinds, with the keys of the statistics file.
#[derive(Serialize)]
#[serde(untagged)]
enum Of {
    Topic { topic: String },
    Call { what: What, service: String },
}

/// Observes the graphs for `patience` and reports what would cross. It joins the graphs under a
/// node name of its own, so a running proxy is not disturbed.
pub async fn run(loaded: &Loaded, patience: Duration) -> Result<Report> {
    let mut graphs = graph::All::new();
    graph::join(&mut graphs, &loaded.config.graphs, &format!("{}dry_run_{}", graph::NODE, std::process::id())).await?;
    let looked = graphs.iter().map(|(label, graph)| look(label, GraphObserver::of(graph), patience));
    let found: BTreeMap<String, Found> = join_all(looked).await.into_iter().collect();
    graph::leave(graphs).await;
    report(loaded, &found)
}

/// Reports what would cross, from what was found in each graph. `found` has the graphs' names in
/// the configuration.
fn report(Loaded { config, material }: &Loaded, found: &BTreeMap<String, Found>) -> Result<Report> {
    let mut rows = Rows::default();
    for listed in listed(config, material) {
        rows.of_listed(found, listed);
    }
    for (label, found) in found {
        let expose = config.expose.as_ref().zip(material.expose.as_ref());
        let is_here = |graph: &Option<String>| config.graphs.get(graph.as_deref()).is_ok_and(|(it, _)| it == label);
        let expose = expose.filter(|(expose, _)| is_here(&expose.graph));
        for ((thing, name), offered) in found {
            rows.of_found(label, *thing, name, offered, expose)?;
        }
    }
    let imports = material.imports.iter().map(|import| import.catalog.name()).collect();
    let (topics, calls) = rows.rows.into_iter().partition(|row| matches!(row.of, Of::Topic { .. }));
    Ok(Report { version: VERSION, entity: material.identity.name(), topics, calls, imports })
}

/// One direction of a topic, service or action that the configuration lists.
struct ListedEntity<'a> {
    key: String,
    graph: &'a str,
    thing: Thing,
    name: &'a TopicName,
    material: &'a RouteMaterial,
}

fn listed<'a>(config: &'a Config, material: &'a Material) -> impl Iterator<Item = ListedEntity<'a>> {
    let graph = |label: &'a Option<String>| Some(config.graphs.get(label.as_deref()).ok()?.0);
    let topics = material.routes.iter().filter_map(move |(at, material)| {
        let topic = &config.topics[*at];
        let (key, graph) = (format!("topics[{at}]"), graph(&topic.graph)?);
        Some(ListedEntity { key, graph, thing: Thing::Topic, name: &topic.topic, material })
    });
    let calls = config.calls().zip(&material.calls).filter_map(move |((key, call), (_, material))| {
        Some(ListedEntity {
            key,
            graph: graph(&call.graph)?,
            thing: Thing::Call(call.what),
            name: &call.name,
            material,
        })
    });
    topics.chain(calls)
}

#[derive(Default)]
struct Rows {
    rows: Vec<Row>,
    /// Listed entities that go out. They are not exposed by pattern as well.
    explicit: BTreeSet<(String, Thing, TopicName)>,
}

impl Rows {
    fn of_listed(&mut self, found: &BTreeMap<String, Found>, listed: ListedEntity<'_>) {
        let ListedEntity { key, graph, thing, name, material } = listed;
        let offered =
            found.get(graph).and_then(|found| found.get(&(thing, name.clone()))).map_or(&[][..], Vec::as_slice);
        let kind = material.kind.as_ref().or_else(|| offered.first()?.kind.as_ref());
        let row = |kind: Option<&TypeName>| Row::new(graph, thing, name, kind, offered);
        self.rows.push(Row {
            direction: Some(material.permission.side()),
            name: Some(material.card.name()),
            called: material.card.get("topic").map(str::to_owned),
            because: key,
            ..row(kind)
        });
        if material.permission.side() == Side::Out {
            self.explicit.insert((graph.to_owned(), thing, name.clone()));
            let others = kinds(offered).into_iter().flatten().filter(|other| Some(*other) != kind);
            self.rows.extend(others.map(|other| Row { because: another_type(kind), ..row(Some(other)) }));
        }
    }

    fn of_found(
        &mut self,
        graph: &str,
        thing: Thing,
        name: &TopicName,
        offered: &[Offered],
        expose: Option<(&ExposeConfig, &ExposeMaterial)>,
    ) -> Result<()> {
        if self.explicit.contains(&(graph.to_owned(), thing, name.clone())) {
            return Ok(());
        }
        let chosen = expose.and_then(|(expose, _)| choose(expose, thing, name, offered));
        if thing != Thing::Topic && chosen.is_none() && is_hidden(thing, name) {
            return Ok(());
        }
        for kind in kinds(offered) {
            let row = Row::new(graph, thing, name, kind, offered);
            self.rows.push(match (expose, &chosen) {
                (None, _) => row,
                (Some((_, material)), Some((chosen, exposed))) if chosen.as_ref() == kind => Row {
                    direction: Some(Side::Out),
                    name: Some(card_of(&material.owner, thing, kind, exposed)?.name()),
                    called: Some(exposed.name.to_string()),
                    because: "expose".into(),
                    ..row
                },
                (Some((expose, _)), chosen) => match check_exposed(expose, thing, name, kind) {
                    Err(why) => Row { because: why.to_string(), ..row },
                    Ok(_) => {
                        Row { because: another_type(chosen.as_ref().and_then(|(chosen, _)| chosen.as_ref())), ..row }
                    }
                },
            });
        }
        Ok(())
    }
}

/// Returns each type with which something is offered once, in order of appearance.
fn kinds(offered: &[Offered]) -> Vec<Option<&TypeName>> {
    let mut kinds = Vec::new();
    for Offered { kind, .. } in offered {
        if !kinds.contains(&kind.as_ref()) {
            kinds.push(kind.as_ref());
        }
    }
    kinds
}

fn another_type(chosen: Option<&TypeName>) -> String {
    let chosen = chosen.map_or_else(|| "another type".into(), ToString::to_string);
    format!("it crosses as {chosen}, and a name is of one type: that of whom the proxy sees first")
}

impl Row {
    /// Describes something that does not cross, with the QoS of those that offer it with this type.
    fn new(graph: &str, thing: Thing, name: &TopicName, kind: Option<&TypeName>, offered: &[Offered]) -> Self {
        let of_kind = offered.iter().filter(|it| it.kind.as_ref() == kind);
        Self {
            graph: graph.into(),
            of: match thing {
                Thing::Topic => Of::Topic { topic: name.to_string() },
                Thing::Call(what) => Of::Call { what, service: name.to_string() },
            },
            kind: kind.map(ToString::to_string),
            qos: qos(of_kind),
            direction: None,
            name: None,
            called: None,
            because: format!("not under {}", thing.list()),
        }
    }
}

async fn look(label: &str, mut graph_observer: GraphObserver, patience: Duration) -> (String, Found) {
    let forever = async {
        loop {
            graph_observer.changed().await;
        }
    };
    _ = tokio::time::timeout(patience, forever).await;
    (label.to_owned(), graph_observer.found())
}

/// Returns the QoS as text, such as `reliable, volatile`, with all differing values.
fn qos<'a>(offered: impl Iterator<Item = &'a Offered>) -> Option<String> {
    let shown = |qos: DisplayedQos| format!("{:?}, {:?}", qos.reliability, qos.durability);
    let all: BTreeSet<String> = offered.filter_map(|it| it.qos.map(shown)).collect();
    (!all.is_empty()).then(|| all.into_iter().collect::<Vec<_>>().join("; "))
}

impl Of {
    fn name(&self) -> &str {
        match self {
            Self::Topic { topic: name } | Self::Call { service: name, .. } => name,
        }
    }
}

impl Report {
    /// Returns the report as lines of text for people.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let rows = self.topics.iter().chain(&self.calls).map(Row::to_string);
        rows.chain(self.imports.iter().map(|name| format!("in  what the catalog {name} lists and matches")))
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let sign = match self.direction {
            Some(Side::Out) => "out",
            Some(Side::In) => "in",
            None => "-",
        };
        let Self { graph, of, kind, qos, name, called, because, .. } = self;
        write!(f, "{sign:3} ")?;
        if let Of::Call { what, .. } = of {
            write!(f, "{} ", what.as_str())?;
        }
        write!(f, "{} [{}] in {graph}", of.name(), kind.as_deref().unwrap_or("type not known"))?;
        if let Some(qos) = qos {
            write!(f, " ({qos})")?;
        }
        match (name, called) {
            (Some(name), Some(called)) if called != of.name() => write!(f, ": {name} as {called}, {because}"),
            (Some(name), _) => write!(f, ": {name}, {because}"),
            (None, _) => write!(f, ": {because}"),
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/dry_run.rs"]
mod tests;
