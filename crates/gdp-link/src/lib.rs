//! Links between neighbours: UDP and raw Ethernet sockets, QUIC between authenticated entities, and
//! the keys of data frames.
//!
//! A [`port`] owns the sockets of one interface or address; a [`link`] is one authenticated
//! adjacency on it. A [`tunnel`] carries the datagrams of a link where no UDP passes.
// `print!` and `eprint!` panic when stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod link;
pub mod port;
pub mod tunnel;
#[cfg(test)]
#[path = "../../gdp-core/tests/unit/published_vectors.rs"]
mod vectors;
