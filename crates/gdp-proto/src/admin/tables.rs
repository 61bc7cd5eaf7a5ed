//! Pages of the FIB and the RIB: `gdp-ctl fib dump`, `rib dump`.

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::topology::Adjacency;
use crate::control::Record;

/// A page of the data plane's routes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FibReply {
    /// By name.
    pub routes: Vec<FibRoute>,
    pub more: bool,
}

/// How the switch forwards frames for a name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FibRoute {
    pub name: Name,
    /// The egress switches, as a hexadecimal number.
    pub egress_bits: String,
    /// This switch is one of them.
    pub own: bool,
    /// Neighbours that lead to the others.
    pub toward: Vec<Name>,
    /// Local endpoints that receive it.
    pub readers: Vec<Name>,
    /// Local endpoints that may send to it.
    pub writers: Vec<Name>,
    /// Of links that the kernel copies to.
    pub group: u32,
}

/// A page of the RIB's records, and all switches that it knows.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RibReply {
    /// In the order of their keys.
    pub records: Vec<Record>,
    pub switches: Vec<RibSwitch>,
    pub more: bool,
}

/// A switch that reports to the RIB.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RibSwitch {
    pub switch: Name,
    /// Index of its egress bit.
    pub bit: u8,
    pub neighbours: Vec<Adjacency>,
    /// Entities.
    pub attached: Vec<Name>,
}
