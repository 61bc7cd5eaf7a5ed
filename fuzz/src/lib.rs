//! What bytes from a wire must never do, as functions of those bytes. Each is run by libFuzzer,
//! guided by coverage (`cargo xtask fuzz TARGET`), and by the tests over the [seeds] and over
//! `corpus/TARGET`: a file there is a case worth keeping, named for what it shows; what a crash
//! leaves goes there under a name of its own.

mod call;
mod cert;
mod control;
mod decide;
mod domains;
mod feedback;
mod key_box;
mod msg;
mod ros1;
mod seeds;
mod segments;

use gdp_tests::frames;
#[path = "../../crates/gdp-wire/tests/tables/mod.rs"]
mod tables;

pub use call::call;
pub use cert::cert;
pub use control::control;
pub use decide::decide;
pub use feedback::feedback;
pub use key_box::key_box;
pub use msg::msg;
pub use ros1::{ros1_header, xmlrpc};
pub use seeds::seeds;
pub use segments::segments;

/// What is fuzzed: a function that panics at what must not be.
pub type Target = fn(&[u8]);

/// All targets, by the names of their executables and corpora.
pub const TARGETS: [(&str, Target); 10] = [
    ("decide", decide),
    ("control", control),
    ("cert", cert),
    ("feedback", feedback),
    ("key_box", key_box),
    ("segments", segments),
    ("msg", msg),
    ("call", call),
    ("xmlrpc", xmlrpc),
    ("ros1_header", ros1_header),
];

/// Names the folder that [`write_seeds`] writes to.
pub const SEED_FOLDER: &str = "GDP_FUZZ_SEEDS";

/// Puts the seeds of a target where the fuzzer is about to look for them.
pub fn write_seeds(target: &str) {
    let Some(folder) = std::env::var_os(SEED_FOLDER).map(std::path::PathBuf::from) else { return };
    for (name, bytes) in seeds(target) {
        let file = folder.join(name.replace('/', " "));
        std::fs::write(&file, bytes).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    }
}
