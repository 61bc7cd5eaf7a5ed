//! `gdp-wire` file by file, without SipHash: every hop tag is 0 here. The programs around it are
//! the shipped ones. Their comparison with this build measures the cost of the tag. No shipped code
//! therefore has an option to omit the tag. (This build samples no names, because the tag selects
//! them; the shipped programs sample one frame in 64.)
//!
//! Built and loaded by `cargo xtask bench forward` only.
#![no_std]

#[path = "../../crates/gdp-wire/src/counter.rs"]
pub mod counter;
#[path = "../../crates/gdp-wire/src/fetch.rs"]
pub mod fetch;
#[path = "../../crates/gdp-wire/src/flat/mod.rs"]
pub mod flat;
#[path = "../../crates/gdp-wire/src/forward/mod.rs"]
pub mod forward;
#[path = "../../crates/gdp-wire/src/header.rs"]
pub mod header;
#[path = "../../crates/gdp-wire/src/hop.rs"]
pub mod hop;
#[path = "../../crates/gdp-wire/src/losses.rs"]
pub mod losses;
#[path = "../../crates/gdp-wire/src/name.rs"]
mod name;
#[path = "../../crates/gdp-wire/src/packet.rs"]
pub mod packet;
#[path = "../../crates/gdp-wire/src/replay.rs"]
pub mod replay;
#[path = "../../crates/gdp-wire/src/table.rs"]
pub mod table;
#[path = "../../crates/gdp-wire/src/tables.rs"]
pub mod tables;

pub mod siphash {
    //! A constant instead of SipHash as the tag of every header.

    #[inline(always)]
    pub fn siphash24<const N: usize>(_key: [u64; 2], _words: &[u64; N]) -> u64 {
        0
    }
}

pub use counter::*;
pub use header::*;
pub use name::*;
pub use table::*;

/// As in `gdp-wire`.
pub const ETHERTYPE: u16 = 0x88B5;
