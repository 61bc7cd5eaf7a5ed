//! `gdp-ctl approve` and `deny`: decide about machines that asked to join without an invitation of
//! their own.

use std::collections::BTreeMap;
use std::io::{BufRead as _, Read as _};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cbor;
use gdp_core::cert::TopicsOf;
use gdp_core::secret_file;
use gdp_directory::directory::MAX_DIRECTORY;
use gdp_directory::fingerprint;
use gdp_directory::messages::{Application, Approval, Decision};
use gdp_directory::service::Applications;
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::invite::{Terms, check_free, check_pattern};
use super::renewals::RENEWABLE;
use super::{HOUR, Home, HomeOptions, files};
use crate::cli::context::Context;
use crate::cli::issuing::parse_seconds;

/// Maximum length of a typed fingerprint, in bytes.
const MAX_TYPED: u64 = 256;

#[derive(Debug, Args)]
pub struct ApproveOptions {
    /// Label of the application, as `gdp-ctl robots` shows it, or its fingerprint.
    label: String,
    /// Only these of the topics that it asks to expose; repeat or separate by commas.
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    only: Vec<String>,
    /// Time for which the new member stays one. Default: until it is revoked.
    #[arg(long = "for", value_name = "TIME", value_parser = parse_seconds)]
    duration: Option<u32>,
    /// Approve without typing the fingerprint.
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    home: HomeOptions,
}

#[derive(Debug, Args)]
pub struct DenyOptions {
    /// Label of the application, or its fingerprint.
    label: String,
    #[command(flatten)]
    home: HomeOptions,
}

/// Output of `gdp-ctl approve` and `deny`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct DecisionOutput {
    label: String,
    fingerprint: String,
    entity: Name,
    /// `approved` or `denied`.
    decision: &'static str,
}

pub fn approve(options: &ApproveOptions, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    options.only.iter().try_for_each(|pattern| check_pattern(pattern))?;
    let (entity, application) = home.application(&options.label)?;
    let Application { label, expose, import, read, key } = application;
    let shown = fingerprint(entity);
    let of = |rules: &[TopicsOf]| rules.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
    note(format_args!("{label} asks to expose {expose:?}, import {:?}, read {:?}", of(&import), of(&read)));
    note(format_args!("Its fingerprint: {shown}"));
    if !options.yes {
        note("It must be the one that the machine shows. Type it to approve:");
        let mut typed = String::new();
        std::io::stdin().lock().take(MAX_TYPED).read_line(&mut typed).context("cannot read the fingerprint")?;
        if typed.trim() != shown {
            bail!("this is another fingerprint; nothing is approved");
        }
    }
    // They come from the machine.
    let rules = import.iter().chain(&read).flat_map(|of| &of.topics);
    expose.iter().chain(rules).try_for_each(|pattern| check_pattern(pattern))?;
    let expose = if options.only.is_empty() { expose } else { options.only.clone() };
    let (role, duration, within) = ("robot".to_owned(), options.duration.map_or(RENEWABLE, u64::from), 24 * HOUR);
    let terms = Terms { label: label.clone(), role, expose, import, read, duration, within };
    check_free(&label)?;
    let (invite, enrolling, _) = home.sign_invitation(terms, key)?;
    let approval = Approval { invite, enrollment: enrolling.enrollment, call: enrolling.call };
    home.decide(entity, Decision::Approved(Box::new(approval)))?;
    print_decision(label, entity, "approved", context)
}

pub fn deny(options: &DenyOptions, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let (entity, application) = home.application(&options.label)?;
    home.record("deny", &application.label, &[])?;
    home.decide(entity, Decision::Denied)?;
    print_decision(application.label, entity, "denied", context)
}

fn print_decision(label: String, entity: Name, decision: &'static str, context: &Context) -> anyhow::Result<()> {
    let output = DecisionOutput { label, fingerprint: fingerprint(entity), entity, decision };
    context.output.print(&output, || [format!("{} ({}) is {decision}", output.label, output.fingerprint)])
}

impl Home {
    /// Returns the applications that wait.
    pub(super) fn applications(&self) -> anyhow::Result<Applications> {
        Ok(self.stored::<Application>(files::APPLICATIONS)?.into_iter().collect())
    }

    pub(super) fn decisions(&self) -> anyhow::Result<BTreeMap<Name, Decision>> {
        Ok(self.stored::<Decision>(files::DECISIONS)?.into_iter().collect())
    }

    fn stored<T: Serialize + serde::de::DeserializeOwned>(&self, name: &str) -> anyhow::Result<Vec<(Name, T)>> {
        let path = self.path(name);
        match secret_file::read_optional(&path, MAX_DIRECTORY)? {
            Some(bytes) => cbor::decode(&bytes, MAX_DIRECTORY).with_context(|| format!("{}: damaged", path.display())),
            None => Ok(Vec::new()),
        }
    }

    fn application(&self, label: &str) -> anyhow::Result<(Name, Application)> {
        let decided = self.decisions()?;
        let mut found: Vec<_> = self.applications()?.into_iter().collect();
        found.retain(|(entity, application)| {
            !decided.contains_key(entity) && (application.label == label || fingerprint(*entity) == label)
        });
        match found.len() {
            0 => bail!("no machine with the label or fingerprint {label} waits; `gdp-ctl robots` lists those that do"),
            1 => found.pop().context("an application"),
            count => bail!("{count} machines ask for the label {label}; name one by its fingerprint"),
        }
    }

    fn decide(&self, entity: Name, decision: Decision) -> anyhow::Result<()> {
        // Of machines that no longer wait, those that were decided first are forgotten.
        const MAX_DECISIONS: usize = 1024;
        let mut decisions: Vec<_> = self.stored::<Decision>(files::DECISIONS)?;
        decisions.retain(|(other, _)| *other != entity);
        let over = (decisions.len() + 1).saturating_sub(MAX_DECISIONS);
        decisions.drain(..over);
        decisions.push((entity, decision));
        Ok(secret_file::replace(&self.path(files::DECISIONS), &cbor::encode(&decisions)?)?)
    }
}
