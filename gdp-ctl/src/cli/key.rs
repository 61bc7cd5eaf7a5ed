//! `gdp-ctl key`: private keys of owners and entities.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};
use gdp_core::identity::{Identity, SigningKey};
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::context::Context;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Generate a private key (a new file, mode 0600), and print the name of its entity.
    Generate {
        /// Private key file.
        file: PathBuf,
        /// Kind of the entity that uses the key; part of the entity's name.
        #[arg(long, value_enum)]
        kind: EntityKind,
    },
    /// Show the public key of a private key, and the names of its entities.
    Show {
        /// Private key file.
        file: PathBuf,
        /// Only the entity of this kind.
        #[arg(long, value_enum)]
        kind: Option<EntityKind>,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum EntityKind {
    Owner,
    Proxy,
    Switch,
    Tool,
}

impl EntityKind {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Owner => "owner",
            Self::Proxy => "proxy",
            Self::Switch => "switch",
            Self::Tool => "tool",
        }
    }
}

/// Output of `gdp-ctl key generate`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct NewKeyOutput {
    file: PathBuf,
    /// Kind of the entity.
    kind: &'static str,
    /// Name of the entity.
    name: Name,
    /// 66 hex digits.
    public_key: String,
}

/// Output of `gdp-ctl key show`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct KeyOutput {
    /// 66 hex digits.
    public_key: String,
    /// The names of the key's entities, by kind.
    names: BTreeMap<&'static str, Name>,
    /// Name of the entity of the requested kind; only if a kind was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<Name>,
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Generate { file, kind } => {
            let key = SigningKey::generate()?;
            key.save_new(&file)?;
            let public_key = key.verify_key().to_string();
            let name = Identity::new(key, kind.as_str()).name();
            let output = NewKeyOutput { file, kind: kind.as_str(), name, public_key };
            context.output.print(&output, || [name.to_string()])
        }
        Command::Show { file, kind } => {
            let key = SigningKey::load(&file)?;
            let kinds = kind.map_or_else(|| EntityKind::value_variants().to_vec(), |kind| vec![kind]);
            let name = |kind: EntityKind| Identity::new(key.clone(), kind.as_str()).name();
            let names = kinds.iter().map(|kind| (kind.as_str(), name(*kind))).collect();
            let output = KeyOutput { public_key: key.verify_key().to_string(), names, name: kind.map(name) };
            context.output.print(&output, || {
                let names = kinds.iter().map(|k| format!("as {:<8} {}", k.as_str(), name(*k)));
                std::iter::once(format!("public key  {}", output.public_key)).chain(names).collect::<Vec<_>>()
            })
        }
    }
}
