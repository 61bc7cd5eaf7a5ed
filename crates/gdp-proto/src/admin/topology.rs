//! The switches of a domain and the links between them: `gdp-ctl topology`.

use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What `gdp-ctl topology` shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TopologyReply {
    /// The switch that answers.
    pub own: Name,
    pub domain: Option<Name>,
    /// By name.
    pub switches: Vec<SwitchState>,
}

/// What a switch stated of itself, and the path to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SwitchState {
    pub switch: Name,
    /// Index of its egress bit, once it has one.
    pub bit: Option<u8>,
    /// Of the path from the switch that answers; none if there is no path.
    pub cost: Option<u64>,
    /// The neighbour that leads there.
    pub next: Option<Name>,
    /// Which run of the switch this is.
    pub run: u64,
    /// Of its statement in that run.
    pub number: u64,
    pub neighbours: Vec<Adjacency>,
    /// The domain's RIB is there.
    pub rib: bool,
    /// Links into other domains.
    pub borders: Vec<BorderAdjacency>,
}

/// A link between two switches of a domain, as one of them states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Adjacency {
    pub switch: Name,
    pub cost: u32,
    /// Its daemon does not answer, though its data plane does.
    pub silent: bool,
}

/// A link into another domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BorderAdjacency {
    pub domain: Name,
    /// The border switch over there.
    pub switch: Name,
    pub cost: u32,
    /// That domain lets this one send through it into a third one.
    pub transit: bool,
    /// This domain lets that one do so.
    pub ours_transit: bool,
    /// Its order among the parents of this domain, if it is one.
    pub parent: Option<u8>,
}
