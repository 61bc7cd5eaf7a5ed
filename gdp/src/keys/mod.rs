//! The keys that messages are read with (DESIGN §8). No sockets, no clocks, nothing of nodes: time and what was received come in.

mod box_key;

pub use box_key::BoxKey;
