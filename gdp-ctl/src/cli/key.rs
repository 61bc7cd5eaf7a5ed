//! `gdp-ctl key`: private keys of owners and entities.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Subcommand, ValueEnum};
use gdp_core::identity::{Identity, KeyFile};
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
        /// Kind of the entity that uses the key; part of the entity's name, and stated in the file.
        #[arg(long, value_enum)]
        kind: EntityKind,
    },
    /// Show the name of the entity that uses a key. If the file does not state its kind, show the
    /// public key, and the name for each kind.
    Show {
        /// Private key file.
        file: PathBuf,
        /// Only the entity of this kind, whatever the file states.
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

/// Returns the line for people: the kind of an entity, its name, and its key file.
fn labelled(kind: &str, name: Name, file: &Path) -> String {
    format!("{kind} {name} {}", file.display())
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
            let identity = Identity::generate(kind.as_str())?;
            identity.save_new(&file)?;
            let (name, public_key) = (identity.name(), identity.key().verify_key().to_string());
            let output = NewKeyOutput { file, kind: kind.as_str(), name, public_key };
            context.output.print(&output, || [labelled(kind.as_str(), name, &output.file)])
        }
        Command::Show { file, kind } => {
            let KeyFile { key, kind: stated } = KeyFile::load(&file)?;
            let kinds = kind.map_or_else(|| EntityKind::value_variants().to_vec(), |kind| vec![kind]);
            let name = |kind: EntityKind| Identity::new(key.clone(), kind.as_str()).name();
            let names = kinds.iter().map(|kind| (kind.as_str(), name(*kind))).collect();
            let output = KeyOutput { public_key: key.verify_key().to_string(), names, name: kind.map(name) };
            context.output.print(&output, || {
                if let Some(of) = kind.map(EntityKind::as_str).or(stated.as_deref()) {
                    return vec![labelled(of, Identity::new(key.clone(), of).name(), &file)];
                }
                let names = kinds.iter().map(|k| format!("as {:<8} {}", k.as_str(), name(*k)));
                std::iter::once(format!("public key  {}", output.public_key)).chain(names).collect::<Vec<_>>()
            })
        }
    }
}
