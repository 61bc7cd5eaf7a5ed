//! Metrics in the text formats of OpenMetrics and Prometheus. Each scrape shows the values of one
//! moment. Programs declare their metrics in tables, which the reference page shows too.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use hyper::StatusCode;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder, prometheus_text, text};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Registry;

use crate::access::{Access, AccessToken};
use crate::error::HttpError;
use crate::exchange::{HttpRequest, HttpResponse};
use crate::server::Listener;

/// The path of metrics.
pub const PATH: &str = "/metrics";

/// The content type of OpenMetrics, which Prometheus asks for.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// The maximum number of topics, links or services with series of their own. Others are summed
/// under the label value [`OTHER`].
pub const MAX_SERIES: usize = 200;

/// The label value of everything beyond [`MAX_SERIES`].
pub const OTHER: &str = "other";

/// The kind of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MetricKind {
    /// A number that only rises. Its samples have the suffix `_total`.
    Counter,
    Gauge,
}

/// The declaration of a metric.
#[derive(Debug)]
pub struct Metric {
    /// The name without `_total`. A unit is its last word.
    pub name: &'static str,
    pub kind: MetricKind,
    pub labels: &'static [&'static str],
    /// One sentence, without its full stop.
    pub help: &'static str,
}

impl Metric {
    pub const fn counter(name: &'static str, labels: &'static [&'static str], help: &'static str) -> Self {
        Self { name, kind: MetricKind::Counter, labels, help }
    }

    pub const fn gauge(name: &'static str, labels: &'static [&'static str], help: &'static str) -> Self {
        Self { name, kind: MetricKind::Gauge, labels, help }
    }

    /// Returns the name of the samples.
    pub fn sample_name(&self) -> String {
        match self.kind {
            MetricKind::Counter => format!("{}_total", self.name),
            MetricKind::Gauge => self.name.into(),
        }
    }
}

/// Declares the metrics of a program, and the table of all of them.
#[macro_export]
macro_rules! metrics {
    ($($id:ident: $kind:ident $name:literal [$($label:literal),*] $help:literal;)+) => {
        $(static $id: $crate::metrics::Metric = $crate::metrics::Metric::$kind($name, &[$($label),*], $help);)+

        /// All metrics of this program.
        pub static ALL: &[&$crate::metrics::Metric] = &[$(&$id),+];
    };
}

/// A value of a metric.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Number {
    Whole(u64),
    Real(f64),
}

/// The values of all metrics at one moment.
#[derive(Debug, Default)]
pub struct Exposition(Vec<Family>);

#[derive(Debug)]
struct Family {
    metric: &'static Metric,
    samples: Vec<(Vec<(&'static str, String)>, Number)>,
}

impl Exposition {
    /// Adds a whole number. `labels` are the values of the declared labels, in their order.
    pub fn add<const N: usize>(&mut self, metric: &'static Metric, labels: [&str; N], value: u64) {
        self.push(metric, &labels, Number::Whole(value));
    }

    /// As [`Self::add`], with a real number such as seconds.
    pub fn add_real<const N: usize>(&mut self, metric: &'static Metric, labels: [&str; N], value: f64) {
        self.push(metric, &labels, Number::Real(value));
    }

    fn push(&mut self, metric: &'static Metric, labels: &[&str], value: Number) {
        debug_assert_eq!(metric.labels.len(), labels.len(), "{}", metric.name);
        let labels = metric.labels.iter().copied().zip(labels.iter().map(|value| (*value).to_owned())).collect();
        let at = self.0.iter().position(|family| family.metric.name == metric.name).unwrap_or_else(|| {
            self.0.push(Family { metric, samples: Vec::new() });
            self.0.len() - 1
        });
        self.0[at].samples.push((labels, value));
    }

    /// Returns the response to a scrape, in the format that the client asks for.
    pub fn response(self, request: &HttpRequest) -> HttpResponse {
        let wants_open =
            request.accept.as_deref().is_some_and(|accept| accept.contains("application/openmetrics-text"));
        let mut registry = Registry::default();
        registry.register_collector(Box::new(Arc::new(self)));
        let mut body = String::new();
        let (encoded, content_type) = match wants_open {
            true => (text::encode(&mut body, &registry), OPEN_METRICS),
            false => (prometheus_text::encode(&mut body, &registry), prometheus_text::CONTENT_TYPE),
        };
        match encoded {
            Ok(()) => HttpResponse::ok(content_type, body),
            Err(error) => HttpResponse::text(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
        }
    }
}

impl Collector for Exposition {
    fn encode(&self, mut encoder: DescriptorEncoder) -> std::fmt::Result {
        for Family { metric, samples } in &self.0 {
            let kind = match metric.kind {
                MetricKind::Counter => MetricType::Counter,
                MetricKind::Gauge => MetricType::Gauge,
            };
            let mut encoder = encoder.encode_descriptor(metric.name, metric.help, None, kind)?;
            for (labels, value) in samples {
                encode(metric.kind, &mut encoder.encode_family(labels)?, *value)?;
            }
        }
        Ok(())
    }
}

fn encode(kind: MetricKind, encoder: &mut MetricEncoder, value: Number) -> std::fmt::Result {
    match (kind, value) {
        (MetricKind::Counter, Number::Whole(value)) => {
            encoder.encode_counter::<[(&str, &str); 0], _, f64>(&value, None)
        }
        (MetricKind::Counter, Number::Real(value)) => encoder.encode_counter::<[(&str, &str); 0], _, f64>(&value, None),
        (MetricKind::Gauge, Number::Whole(value)) => encoder.encode_gauge(&value),
        (MetricKind::Gauge, Number::Real(value)) => encoder.encode_gauge(&value),
    }
}

/// Binds the address of metrics. Without a token file it must be on loopback.
///
/// # Errors
///
/// Fails as [`Listener::bind`] and [`AccessToken::from_file`].
pub fn listen(address: SocketAddr, token: Option<&Path>) -> Result<Listener, HttpError> {
    let access = match token {
        Some(path) => Access::token(AccessToken::from_file(path)?),
        None => Access::open_on_loopback(),
    };
    Listener::bind(address, access)
}

#[cfg(test)]
#[path = "../tests/unit/metrics.rs"]
mod tests;
