//! `gdp-ctl key`: private keys of owners and entities.

use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};
use gdp_core::identity::{Identity, SigningKey};
use serde_json::{Map, json};

use crate::cli::context::Context;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a private key (a new file, mode 0600) and print the name of the entity it makes.
    Generate {
        file: PathBuf,
        /// What the key is for; part of the entity's name.
        #[arg(long, value_enum)]
        kind: Kind,
    },
    /// Show the public key of a private key, and the names of the entities it makes.
    Show {
        file: PathBuf,
        /// Only the entity of this kind.
        #[arg(long, value_enum)]
        kind: Option<Kind>,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    Owner,
    Proxy,
    Switch,
    Tool,
}

impl Kind {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Owner => "owner",
            Self::Proxy => "proxy",
            Self::Switch => "switch",
            Self::Tool => "tool",
        }
    }
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Generate { file, kind } => {
            let key = SigningKey::generate()?;
            key.save_new(&file)?;
            let public_key = key.verify_key().to_string();
            let name = Identity::new(key, kind.as_str()).name();
            let value = json!({"file": file, "kind": kind.as_str(), "name": name, "public_key": public_key});
            context.output.print(value, || [name.to_string()])
        }
        Command::Show { file, kind } => {
            let key = SigningKey::load(&file)?;
            let kinds = kind.map_or_else(|| Kind::value_variants().to_vec(), |kind| vec![kind]);
            let name = |kind: Kind| Identity::new(key.clone(), kind.as_str()).name();
            let names: Map<_, _> = kinds.iter().map(|k| (k.as_str().into(), name(*k).to_string().into())).collect();
            let public_key = key.verify_key().to_string();
            let mut value = json!({"public_key": public_key, "names": names});
            if let Some(kind) = kind {
                value["name"] = name(kind).to_string().into();
            }
            context.output.print(value, || {
                let names = kinds.iter().map(|k| format!("as {:<8} {}", k.as_str(), name(*k)));
                std::iter::once(format!("public key  {public_key}")).chain(names).collect::<Vec<_>>()
            })
        }
    }
}
