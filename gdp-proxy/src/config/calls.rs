//! The configuration of one service or action.

pub use crate::config::call_kind::What;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer};

use super::{Graphs, Side};
use crate::ros2::{TopicName, TypeName};

/// One service or action to carry.
#[derive(Clone, Debug, PartialEq)]
pub struct CallConfig {
    pub what: What,
    /// Name in the local ROS graph.
    pub name: TopicName,
    /// Name of the graph, if there are several.
    pub graph: Option<String>,
    /// The type as ROS 2 writes it, in either graph. If absent: the type in the name card, or else
    /// the type that the servers use.
    pub kind: Option<TypeName>,
    /// `out`: remote clients call local servers; `in`: local clients call remote servers.
    pub side: Side,
    /// The name card (`gdp-ctl name create`).
    pub card: PathBuf,
    /// `out`: the owner's certificate for this proxy to serve (`gdp-ctl grant add --publish`).
    pub cert: Option<PathBuf>,
    /// `in`: the owner's grant to call (`gdp-ctl grant add --read`).
    pub grant: Option<PathBuf>,
    /// `in`, services only: the number of servers to which each call goes at once.
    pub replicate: Option<u8>,
}

/// Bounds of `replicate`.
pub const COPIES: RangeInclusive<u8> = 2..=8;

/// Defines an entry of `services` or `actions`. They differ in the key of the name, and in whether
/// the schema has `replicate`.
macro_rules! entry {
    ($Entry:ident, $name:ident, $replicate:meta) => {
        #[derive(Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $Entry {
            /// Name in the local ROS graph.
            $name: TopicName,
            /// Name of the graph, if there are several.
            graph: Option<String>,
            /// The type as ROS 2 writes it, in either graph. If absent: the type in the name card,
            /// or else the type that the servers use.
            #[serde(rename = "type")]
            kind: Option<TypeName>,
            /// `out`: remote clients call local servers; `in`: local clients call remote servers.
            direction: Side,
            /// The name card (`gdp-ctl name create`).
            card: PathBuf,
            /// `out`: the owner's certificate for this proxy to serve (`gdp-ctl grant add
            /// --publish`).
            cert: Option<PathBuf>,
            /// `in`: the owner's grant to call (`gdp-ctl grant add --read`).
            grant: Option<PathBuf>,
            /// `in`: the number of servers, the nearest ones, to which each call goes at once. The
            /// first answer counts. The name card must be of an idempotent service (`gdp-ctl name
            /// create --idempotent`).
            #[$replicate]
            replicate: Option<u8>,
        }

        impl From<$Entry> for CallConfig {
            fn from(entry: $Entry) -> Self {
                let $Entry { $name: name, graph, kind, direction: side, card, cert, grant, replicate } = entry;
                Self { what: What::$Entry, name, graph, kind, side, card, cert, grant, replicate }
            }
        }
    };
}

entry!(Service, service, schemars(range(min = 2, max = 8)));
// The key is read to refuse it with a reason.
entry!(Action, action, schemars(skip));

/// Deserializes a list of entries of one kind.
pub fn list<'de, D: Deserializer<'de>, E: Deserialize<'de> + Into<CallConfig>>(
    deserializer: D,
) -> Result<Vec<CallConfig>, D::Error> {
    Ok(Vec::<E>::deserialize(deserializer)?.into_iter().map(Into::into).collect())
}

impl CallConfig {
    /// Returns an entry of `graph` without files, for a service or action that matches a pattern.
    pub fn without_files(what: What, name: &TopicName, graph: &str, kind: Option<TypeName>, side: Side) -> Self {
        let (name, graph) = (name.clone(), Some(graph.into()));
        Self { what, name, graph, kind, side, card: PathBuf::new(), cert: None, grant: None, replicate: None }
    }

    /// Returns the number of servers to which a call goes.
    pub fn copies(&self) -> usize {
        self.replicate.map_or(1, usize::from)
    }

    /// Returns the key and the path of its certificate file.
    pub fn right(&self) -> (&'static str, Option<&PathBuf>) {
        match self.side {
            Side::Out => ("cert", self.cert.as_ref()),
            Side::In => ("grant", self.grant.as_ref()),
        }
    }

    /// Checks the entry. Errors come with the key inside the entry.
    pub(super) fn check(&self, graphs: &Graphs) -> Result<(), (&'static str, String)> {
        graphs.get(self.graph.as_deref()).map_err(|reason| ("graph", reason))?;
        if let Some(kind) = self.kind.as_ref().filter(|kind| !self.what.fits(kind)) {
            let (what, folder) = (self.what.as_str(), self.what.folder());
            return Err(("type", format!("{kind} is no type of a {what}: write it as package/{folder}/Name")));
        }
        self.check_replicate().map_err(|reason| ("replicate", reason))?;
        let unused = match self.side {
            Side::Out => ("grant", self.grant.is_some()),
            Side::In => ("cert", self.cert.is_some()),
        };
        match (self.side, self.right(), unused) {
            (_, (_, Some(_)), (key, true)) => Err((key, "is for the other direction; remove it".into())),
            (_, (_, Some(_)), _) => Ok(()),
            (Side::Out, (key, None), _) => {
                Err((key, "missing: the owner's permission to serve (gdp-ctl grant add --publish)".into()))
            }
            (Side::In, (key, None), _) => {
                Err((key, "missing: the owner's permission to call (gdp-ctl grant add --read)".into()))
            }
        }
    }

    fn check_replicate(&self) -> Result<(), String> {
        match (self.replicate, self.what, self.side) {
            (None, ..) => Ok(()),
            (Some(_), What::Action, _) => {
                Err("is for services only, because each server would execute the goal; remove it".into())
            }
            (Some(_), _, Side::Out) => Err("is for direction: in, where the clients are; remove it".into()),
            (Some(copies), ..) => check_copies(copies),
        }
    }

    /// Whether both are the same service or action of the same graph.
    pub(super) fn is_same(&self, other: &Self, graphs: &Graphs) -> bool {
        let graph = |of: &Self| graphs.get(of.graph.as_deref()).ok().map(|(name, _)| name.to_owned());
        (self.what, &self.name, graph(self)) == (other.what, &other.name, graph(other))
    }
}

/// Checks the number of servers of `replicate`.
pub(super) fn check_copies(copies: u8) -> Result<(), String> {
    let (least, most) = (COPIES.start(), COPIES.end());
    if COPIES.contains(&copies) {
        return Ok(());
    }
    Err(format!("a call goes to {least} to {most} servers at once, and not to {copies}; leave it out for one server"))
}

#[cfg(test)]
#[path = "../../tests/unit/config/calls.rs"]
mod tests;
