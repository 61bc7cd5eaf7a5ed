//! A setup step: Debian packages, Python wheels, commands, and a check whether the step is done.

use gdp_tests::programs::Program;

use crate::setup::purpose::SetupPart;
use crate::workspace;

/// A requirement that a machine may lack.
pub struct SetupStep {
    pub part: SetupPart,
    pub what: &'static str,
    pub why: &'static str,
    /// External programs that the step installs.
    pub programs: &'static [Program],
    /// Returns whether the step is done, apart from its programs and wheels.
    pub present: fn() -> bool,
    /// Packages of Debian 12, installed without recommended ones.
    pub packages: &'static [&'static str],
    /// Python wheels, as `NAME==VERSION`.
    pub wheels: &'static [&'static str],
    /// The Python environment of the wheels, as a folder in the target folder.
    pub environment: &'static str,
    /// Shell commands that follow the packages and wheels, run as printed.
    pub commands: &'static [&'static str],
    /// Instructions for a system other than Debian 12, which are only printed. Wheels are the same
    /// on every system.
    pub elsewhere: &'static str,
}

impl SetupStep {
    pub fn is_done(&self) -> bool {
        let programs = self.programs.iter().all(|program| program.find().is_some());
        programs && self.marker().is_none_or(|marker| workspace::target().join(marker).is_file()) && (self.present)()
    }

    /// Returns the file that marks the wheels as installed, below the target folder. Setup creates
    /// it last, so that an interrupted installation does not count.
    pub fn marker(&self) -> Option<String> {
        self.wheels.first().map(|wheel| format!("{}/gdp-{}", self.environment, wheel.replace("==", "-")))
    }
}

/// Defaults of all steps.
pub const NOTHING: SetupStep = SetupStep {
    part: SetupPart::Workspace,
    what: "",
    why: "",
    programs: &[],
    present: || true,
    packages: &[],
    wheels: &[],
    environment: "venv",
    commands: &[],
    elsewhere: "",
};
