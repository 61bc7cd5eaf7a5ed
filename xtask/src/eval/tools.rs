//! What the evaluation needs: its programs, this tree's executables, and zenoh's bridge.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};
use gdp_tests::netns::{self, Namespace};
use gdp_tests::programs::own;
use gdp_tests::{Tools, wait};

use crate::build::{self, Executables, Features};
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};
use crate::{peers, shell};

pub struct EvalTools {
    pub tools: Tools,
    /// The zenoh bridge, if it was built.
    pub bridge: Option<PathBuf>,
}

impl EvalTools {
    /// Installs and builds what is missing, renders what the workloads read, and removes namespaces
    /// of earlier runs. `zenoh`: also builds the bridge.
    pub fn prepare(profile: Profile, zenoh: bool) -> Result<Self> {
        if !workspace::is_root() {
            bail!("network namespaces need root");
        }
        setup::ensure(Purpose::Eval)?;
        if zenoh {
            setup::ensure(Purpose::Bench)?;
        }
        build::executables(Executables::All, profile, Features::default())?;
        let bridge = zenoh.then(peers::build_zenoh).transpose()?;
        let mut render = own(python());
        // Stdout has the results.
        render.stdout(std::io::stderr());
        shell::say_and_run(render.arg(program("prepare.py")).arg("--data").arg(data()))?;
        wait::catch_interrupts();
        netns::sweep()?;
        Ok(Self { tools: workspace::tools(profile), bridge })
    }

    /// Returns the command of a program of `eval/` in a namespace.
    pub fn workload(&self, at: &Namespace, file: &str, workload: &str) -> Result<Command> {
        let mut command = at.command(python())?;
        command.arg(program(file)).arg(workload).arg("--data").arg(data());
        Ok(command)
    }
}

/// The Python that has the workloads' libraries.
fn python() -> PathBuf {
    workspace::target().join(setup::EVAL_ENVIRONMENT).join("bin/python")
}

fn program(file: &str) -> PathBuf {
    workspace::root().join("eval").join(file)
}

/// The rendered images and the vocabulary.
fn data() -> PathBuf {
    workspace::target().join("eval/data")
}
