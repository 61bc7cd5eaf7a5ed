//! Publishes the proxy's status to ROS tools on `/diagnostics`: one status for each topic and
//! direction.

use std::collections::HashMap;
use std::time::Duration;

use gdp::unstable::ClockDifference;
use gdp_util::unix_time::unix_time;

use gdp_msg::Encoding;
use gdp_util::ticks::Ticks;
use gdp_wire::Name;
use serde::Serialize;

use crate::config::{Config, Side};
use crate::graph::{All, Graph, GraphError, Writer};
use crate::ros2::{NameError, Qos, TopicName};
use crate::route_status::STANDING_BY;
use crate::stats::RouteStats;
use crate::waiting::Waiting;
use gdp_ros::roster::{Dialect, Kind};
use gdp_ros::types::{Converter, Form, TypeError, Types};

const PERIOD: Duration = Duration::from_secs(1);
const TOPIC: &str = "/diagnostics";
const KIND: &str = "diagnostic_msgs/msg/DiagnosticArray";

/// The levels of `diagnostic_msgs/DiagnosticStatus`, with its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Ok = 0,
    Warn = 1,
    Error = 2,
    /// The route has had nothing to do yet.
    Stale = 3,
}

/// Errors that prevent diagnostics.
#[derive(Debug, thiserror::Error)]
pub enum DiagnosticsError {
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error(transparent)]
    Type(#[from] TypeError),
    #[error(transparent)]
    Name(#[from] NameError),
}

/// The publishers of `/diagnostics` in all graphs of the proxy.
pub struct Diagnostics {
    entity: Name,
    outlets: Vec<(Writer, Converter)>,
    /// Graphs that have no publisher yet, because their Zenoh router is not reached.
    pending: Vec<String>,
    ticks: Ticks,
    before: Before,
}

/// Messages and drops of each route at the last report. Merged routes have one topic.
type Before = HashMap<(Name, String, Side), (u64, u64)>;

#[derive(Serialize)]
struct Array {
    header: DiagnosticHeader,
    status: Vec<DiagnosticStatus>,
}

#[derive(Serialize)]
struct DiagnosticHeader {
    stamp: Stamp,
    frame_id: &'static str,
}

#[derive(Serialize)]
struct Stamp {
    sec: u64,
    nanosec: u32,
}

#[derive(Serialize)]
struct DiagnosticStatus {
    level: u8,
    name: String,
    message: String,
    hardware_id: String,
    values: Vec<Value>,
}

#[derive(Serialize)]
struct Value {
    key: String,
    value: String,
}

impl Diagnostics {
    async fn new(entity: Name, graphs: &All, types: &Types) -> Result<Self, DiagnosticsError> {
        let ticks = Ticks::new(PERIOD);
        let pending = graphs.keys().cloned().collect();
        let mut new = Self { entity, outlets: vec![], pending, ticks, before: HashMap::new() };
        new.open(graphs, types).await?;
        Ok(new)
    }

    /// Creates the publishers that are missing.
    async fn open(&mut self, graphs: &All, types: &Types) -> Result<(), DiagnosticsError> {
        for name in std::mem::take(&mut self.pending) {
            let Some(graph) = graphs.get(&name) else { continue };
            match publisher(graph, types).await {
                Ok(publisher) => self.outlets.push(publisher),
                Err(DiagnosticsError::Graph(GraphError::Zenoh(_))) => self.pending.push(name),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Creates the publishers, if the configuration enables them. An error is logged and disables
    /// them: topics matter more than their diagnostics.
    pub async fn wanted(config: &Config, entity: Name, graphs: &All, types: &Types) -> Option<Self> {
        if !config.diagnostics {
            return None;
        }
        let new = Self::new(entity, graphs, types).await;
        new.inspect_err(|error| tracing::warn!("no diagnostics: {error}")).ok()
    }

    /// Publishes the status of all routes. It is called once a second.
    pub async fn tell(&mut self, routes: &[RouteStats], clocks: &[ClockDifference], graphs: &All, types: &Types) {
        let now = unix_time();
        if let Err(error) = self.open(graphs, types).await {
            tracing::warn!("no diagnostics in a graph: {error}");
        }
        if let Err(error) = self.tell_once(now, routes, clocks).await {
            tracing::warn!("no diagnostics: {error}");
        }
    }

    /// `now` is the time since the Unix epoch.
    async fn tell_once(
        &mut self,
        now: Duration,
        routes: &[RouteStats],
        clocks: &[ClockDifference],
    ) -> Result<(), Box<dyn std::error::Error>> {
        let before = std::mem::take(&mut self.before);
        let of_routes = routes.iter().map(|route| self.status(route, &before)).collect::<Vec<_>>();
        let status = clocks.iter().map(|clock| of_clock(clock, self.entity)).chain(of_routes).collect();
        let stamp = Stamp { sec: now.as_secs(), nanosec: now.subsec_nanos() };
        let json = serde_json::to_vec(&Array { header: DiagnosticHeader { stamp, frame_id: "" }, status })?;
        for (writer, converter) in &mut self.outlets {
            let bytes = converter.convert(json.clone().into())?;
            writer.write(bytes, u64::try_from(now.as_nanos())?).await?;
        }
        Ok(())
    }

    fn status(&mut self, route: &RouteStats, before: &Before) -> DiagnosticStatus {
        let RouteStats { topic, graph, status, direction, name, counted, kind, waiting_for, .. } = route;
        let drops = counted.drops.values().sum();
        let key = (*name, graph.clone(), *direction);
        let (messages_before, drops_before) = before.get(&key).copied().unwrap_or_default();
        self.before.insert(key, (counted.messages, drops));
        let level = level(status, *waiting_for, drops > drops_before);
        let message = match waiting_for {
            // The status then only says that the route is ready.
            Some(waiting) if status == "up" => waiting.as_str().into(),
            _ => status.clone(),
        };
        let direction = match direction {
            Side::Out => "out",
            Side::In => "in",
        };
        let value = |key: &str, value: String| Value { key: key.into(), value };
        let mut values = vec![
            value("name", name.to_string()),
            value("graph", graph.clone()),
            value("direction", direction.into()),
            value("type", kind.clone().unwrap_or_default()),
            value("rate (Hz)", counted.messages.saturating_sub(messages_before).to_string()),
            value("messages", counted.messages.to_string()),
        ];
        values.extend(
            waiting_for.map(|waiting| value("waiting for", waiting.as_str().trim_start_matches("waiting for ").into())),
        );
        let dropped = counted.drops.iter().filter(|(_, count)| **count > 0);
        values.extend(dropped.map(|(reason, count)| value(&format!("dropped: {reason}"), count.to_string())));
        DiagnosticStatus {
            level: level as u8,
            name: format!("gdp_proxy: {topic} {direction}"),
            message,
            hardware_id: format!("{:#}", self.entity),
            values,
        }
    }
}

/// Returns the status of a counterpart whose clock differs.
fn of_clock(clock: &ClockDifference, entity: Name) -> DiagnosticStatus {
    let value = |key: &str, value: String| Value { key: key.into(), value };
    DiagnosticStatus {
        level: Level::Error as u8,
        name: format!("gdp_proxy: clock of {:#}", clock.peer),
        message: clock.to_string(),
        hardware_id: format!("{entity:#}"),
        values: vec![value("name", clock.peer.to_string()), value("ahead (ms)", clock.ahead_ms.to_string())],
    }
}

async fn publisher(graph: &Graph, types: &Types) -> Result<(Writer, Converter), DiagnosticsError> {
    let (topic, ros2) = (TopicName::parse(TOPIC)?, Kind { dialect: Dialect::Ros2, name: KIND.into(), hash: vec![] });
    let told = Form { kind: &ros2, definition: None, encoding: Encoding::Json };
    let (kind, _) = types.counterpart(&told, graph.dialect())?;
    let definition = types.definition(&kind);
    let written = Form { kind: &kind, definition: None, encoding: kind.dialect.native() };
    let converter = types.converter(&told, &written)?;
    let writer = graph.writer(types, &topic, &kind, definition.as_deref(), Qos::default().into()).await?;
    Ok((writer, converter))
}

/// Waits for the next second, or forever if there are no diagnostics. Safe to cancel.
pub async fn due(diagnostics: &mut Option<Diagnostics>) {
    match diagnostics {
        Some(diagnostics) => _ = diagnostics.ticks.tick().await,
        None => std::future::pending().await,
    }
}

/// Returns the level of a route from its status text, what it waits for, and whether it dropped
/// messages since the last report.
fn level(status: &str, waiting_for: Option<Waiting>, drops: bool) -> Level {
    match (status, waiting_for) {
        (standing_by, _) if standing_by.starts_with(STANDING_BY) => Level::Ok,
        (_, Some(Waiting::Permission)) => Level::Error,
        (_, Some(_)) => Level::Warn,
        ("up", None) if drops => Level::Warn,
        ("up", None) => Level::Ok,
        ("starting", None) => Level::Stale,
        (waiting, None) if waiting == Waiting::LocalPublisher.as_str() => Level::Stale,
        _ => Level::Error,
    }
}

#[cfg(test)]
#[path = "../tests/unit/diagnostics.rs"]
mod tests;
