//! `cargo xtask demo`: a robot roams between two trust domains while its ROS 2 topic flows to the
//! cloud, as in the paper's Figure 4. With `--chain` it shows the simplest network.
//!
//! The demo runs the real programs in separate network namespaces, and removes everything when it
//! ends, even by Ctrl-C.

mod chain;
mod federation;
mod options;
mod route;
mod story;

pub use crate::demo::options::Options;
use anyhow::{Result, bail, ensure};
use gdp_tests::{netns, wait};
use serde::Serialize;

use self::story::Story;
use crate::build::{self, Executables, Features};
use crate::peers as peer_programs;
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

pub fn run(options: Options) -> Result<()> {
    ensure!(options.seconds > 0 && options.rate > 0.0, "--seconds and --rate must be above zero");
    if !workspace::is_root() {
        bail!("the demo builds network namespaces and loads XDP programs, which needs root");
    }
    setup::ensure(Purpose::Demo)?;
    build::executables(Executables::All, Profile::Release, Features::default())?;
    peer_programs::build_dds()?;
    wait::catch_interrupts();
    netns::sweep()?;
    let story = Story { silent: options.json };
    match options.chain {
        true => print(&options, &chain::play(&options, &story)?),
        false => print(&options, &federation::play(&options, &story)?),
    }
}

fn print(options: &Options, outcome: &impl Serialize) -> Result<()> {
    if options.json {
        println!("{}", serde_json::to_string(outcome)?);
    }
    Ok(())
}
