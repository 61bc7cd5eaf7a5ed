//! What bytes from a wire must never do, as functions of those bytes. Each is run by libFuzzer, guided by coverage
//! (`cargo xtask fuzz TARGET`), and over `corpus/TARGET` by the tests: a file there is a case worth keeping, named for what it
//! shows; what a crash leaves goes there under a name of its own.

mod cert;
mod control;
mod decide;

use gdp_tests::frames;
#[path = "../../gdp-wire/tests/tables/mod.rs"]
mod tables;

pub use cert::cert;
pub use control::control;
pub use decide::decide;

/// What is fuzzed: a function that panics at what must not be.
pub type Target = fn(&[u8]);

/// All targets, by the names of their executables and corpora.
pub const TARGETS: [(&str, Target); 3] = [("decide", decide), ("control", control), ("cert", cert)];
