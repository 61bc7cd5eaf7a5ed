//! `gdp-ctl name`: name cards, and the names they derive.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::Subcommand;
use gdp_core::card::NameCard;
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_core::name;
use gdp_core::name::Metadata;
use gdp_util::terminal::note;
use serde_json::{Value, json};

use crate::cli::context::Context;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a name card: a new file for those who should be able to derive the name.
    Create {
        /// The owner's private key file, or its public key (66 hex digits).
        #[arg(long)]
        owner: String,
        #[arg(long)]
        topic: String,
        /// Such as std_msgs/msg/String.
        #[arg(long = "type")]
        type_name: String,
        #[arg(long, default_value = "topic")]
        kind: String,
        /// A nonce to remember, instead of 128 random bits. Others may then guess what the name stands for.
        #[arg(long)]
        nonce: Option<String>,
        /// What else the card says; repeat for more. Other metadata makes another name.
        #[arg(long, value_name = "KEY=VALUE")]
        meta: Vec<String>,
        #[arg(short, long, value_name = "CARD")]
        output: PathBuf,
    },
    /// Print the name that a card, or an owner key and metadata, derive.
    Derive {
        #[arg(conflicts_with_all = ["owner", "meta"], required_unless_present = "owner")]
        card: Option<PathBuf>,
        /// The owner's private key file, or its public key (66 hex digits).
        #[arg(long, requires = "meta")]
        owner: Option<String>,
        /// One metadata entry; repeat for all of them.
        #[arg(long, value_name = "KEY=VALUE")]
        meta: Vec<String>,
    },
    /// Show what is in a name card.
    Show { card: PathBuf },
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Create { owner, topic, type_name, kind, nonce, meta, output } => {
            if nonce.is_some() {
                note("gdp-ctl: warning: with a nonce that can be guessed, so can the topic behind the name");
            }
            let card = NameCard::create(public_key(&owner)?, &kind, &topic, &type_name, nonce)?;
            let card = NameCard::new(*card.owner_key(), with_meta(card.metadata().clone(), &meta)?)?;
            card.save_new(&output)?;
            let mut value = describe(&card);
            value["file"] = json!(output);
            context.output.print(value, || card.name().to_string())
        }
        Command::Derive { card: Some(path), .. } => {
            let card = NameCard::load(&path)?;
            context.output.print(describe(&card), || card.name().to_string())
        }
        Command::Derive { card: None, owner, meta } => {
            let owner = public_key(&owner.unwrap_or_default())?;
            let card = NameCard::new(owner, with_meta(Metadata::new(), &meta)?)?;
            context.output.print(describe(&card), || card.name().to_string())
        }
        Command::Show { card } => {
            let card = NameCard::load(&card)?;
            context.output.print(describe(&card), || {
                let metadata = card.metadata().iter().map(|(key, value)| format!("{key:<10}  {value}\n"));
                format!(
                    "name        {}\nowner key   {}\n{}",
                    card.name(),
                    card.owner_key(),
                    metadata.collect::<String>()
                )
            })
        }
    }
}

fn with_meta(mut metadata: Metadata, meta: &[String]) -> anyhow::Result<Metadata> {
    for entry in meta {
        let (key, value) = entry.split_once('=').with_context(|| format!("--meta {entry}: not KEY=VALUE"))?;
        if metadata.insert(key.to_owned(), value.to_owned()).is_some() {
            bail!("--meta {key} is given twice");
        }
    }
    Ok(metadata)
}

fn describe(card: &NameCard) -> Value {
    json!({
        "name": card.name(),
        "owner_key": card.owner_key(),
        "digest": hex::encode(name::inner_digest(card.metadata())),
        "metadata": card.metadata(),
    })
}

/// A public key in hex, or that of a private key file.
fn public_key(owner: &str) -> anyhow::Result<VerifyKey> {
    match owner.parse() {
        Ok(key) => Ok(key),
        Err(_) => Ok(SigningKey::load(owner.as_ref())?.verify_key()),
    }
}
