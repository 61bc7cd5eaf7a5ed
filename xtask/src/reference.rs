//! `cargo xtask reference`: writes the pages and schemas that are made from the code. Unit tests
//! compare them with the code.

use anyhow::Result;

use crate::setup::{self, Purpose};
use crate::shell;
use crate::workspace::{FEATURES, Profile};

#[derive(clap::Args)]
pub struct Options {}

pub fn run(_: Options) -> Result<()> {
    setup::ensure(Purpose::Unit)?;
    let mut command = shell::cargo();
    // As other commands do, so that cargo compiles nothing twice.
    command.args(["test", "--workspace", "--profile", Profile::Checked.name(), "--features", FEATURES]);
    command.args(["--lib", "--bins", "--", "the_reference_page", "the_published_schema"]).env("GDP_BLESS", "1");
    shell::say_and_run(&mut command)
}
