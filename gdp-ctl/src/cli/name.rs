//! `gdp-ctl name`: name cards, and the names they derive.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::{Subcommand, ValueEnum};
use gdp_core::card::NameCard;
use gdp_core::identity::VerifyKey;
use gdp_core::name;
use gdp_core::name::{Metadata, Name};
use gdp_ros::names::{check_topic, check_type};
use gdp_ros::services::IDEMPOTENT;
use gdp_util::escape::is_control;
use gdp_util::terminal::note;
use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::context::Context;
use crate::cli::entity::parse_public_key;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Create a name card: a new file for everyone that must be able to derive the name.
    Create {
        /// Private key file of the owner, or the owner's public key (66 hex digits).
        #[arg(long, value_name = "KEY", value_parser = parse_public_key)]
        owner: VerifyKey,
        /// ROS name with a leading slash, such as /chatter. For a catalog: any label, such as the
        /// robot's name, for logs.
        #[arg(long, value_name = "NAME")]
        topic: String,
        /// ROS type, such as std_msgs/msg/String, std_srvs/srv/SetBool or nav2_msgs/action/Spin. A
        /// catalog has none.
        #[arg(long = "type", value_name = "TYPE")]
        type_name: Option<String>,
        /// Kind of the name. A catalog lists what a gdp-proxy exposes automatically (`expose` in
        /// its configuration).
        #[arg(long, value_enum, default_value = "topic")]
        kind: CardKind,
        /// Nonce of your choice, instead of 128 random bits. With a memorable nonce, others may
        /// guess what the name refers to.
        #[arg(long)]
        nonce: Option<String>,
        /// Mark the service as idempotent: several servers may execute the same call. Proxies may
        /// then send each call to several servers at once (`replicate` in their configuration).
        #[arg(long)]
        idempotent: bool,
        /// Additional metadata of the card; repeat for more. Different metadata yields a different
        /// name.
        #[arg(long, value_name = "KEY=VALUE")]
        meta: Vec<String>,
        /// New file for the card.
        #[arg(short, long, value_name = "CARD")]
        output: PathBuf,
    },
    /// Print the name that derives from a card, or from an owner's key and metadata.
    Derive {
        /// Name card.
        #[arg(conflicts_with_all = ["owner", "meta"], required_unless_present = "owner")]
        card: Option<PathBuf>,
        /// Private key file of the owner, or the owner's public key (66 hex digits).
        #[arg(long, value_name = "KEY", requires = "meta", value_parser = parse_public_key)]
        owner: Option<VerifyKey>,
        /// Metadata entry; repeat for each entry.
        #[arg(long, value_name = "KEY=VALUE")]
        meta: Vec<String>,
    },
    /// Show the contents of a name card.
    Show {
        /// File of the name card.
        card: PathBuf,
    },
}

/// Kind of a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CardKind {
    Topic,
    Service,
    Action,
    Catalog,
}

impl CardKind {
    fn as_str(self) -> &'static str {
        match self {
            Self::Topic => "topic",
            Self::Service => "service",
            Self::Action => "action",
            Self::Catalog => "catalog",
        }
    }

    /// Returns the middle part of ROS type names, and an example.
    fn types(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Topic => Some(("msg", "std_msgs/msg/String")),
            Self::Service => Some(("srv", "std_srvs/srv/SetBool")),
            Self::Action => Some(("action", "nav2_msgs/action/Spin")),
            Self::Catalog => None,
        }
    }

    /// Returns the type for the card; empty for a catalog.
    ///
    /// # Errors
    /// If no ROS graph can have this name, or the type is of another kind.
    fn check<'t>(self, topic: &str, type_name: Option<&'t str>) -> anyhow::Result<&'t str> {
        let kind = self.as_str();
        let Some((folder, example)) = self.types() else {
            if topic.is_empty() || topic.contains(is_control) {
                bail!("--topic: the label of a catalog is printable text, such as robot1");
            }
            return match type_name {
                Some(_) => bail!("--type: a catalog has no type; leave --type out"),
                None => Ok(""),
            };
        };
        check_topic(topic).context("--topic")?;
        let Some(type_name) = type_name else { bail!("a {kind} has a type: add --type, such as --type {example}") };
        match check_type(type_name) {
            Ok(of) if of == folder => Ok(type_name),
            _ => bail!(
                "--type: `{type_name}` is not the type of a {kind}: write it as package/{folder}/Name, such as \
                 {example}"
            ),
        }
    }
}

/// Output of the commands on name cards.
#[derive(Debug, Serialize, JsonSchema)]
pub struct CardOutput {
    name: Name,
    /// 66 hex digits.
    owner_key: String,
    /// Digest of the metadata: 64 hex digits.
    digest: String,
    metadata: Metadata,
    /// File of a new card.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<PathBuf>,
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Create { owner, topic, type_name, kind, nonce, idempotent, mut meta, output } => {
            if nonce.is_some() {
                note("gdp-ctl: warning: with a nonce that can be guessed, so can the topic behind the name");
            }
            let type_name = kind.check(&topic, type_name.as_deref())?;
            if idempotent {
                if kind != CardKind::Service {
                    bail!(
                        "--idempotent: only a service can be idempotent, and this is a {}; leave it out",
                        kind.as_str()
                    );
                }
                meta.push(format!("{IDEMPOTENT}=true"));
            }
            if let Some(entry) = meta.iter().find(|entry| entry.contains(is_control)) {
                bail!("--meta {entry}: a card has no control characters; leave them out");
            }
            let card = NameCard::create(owner, kind.as_str(), &topic, type_name, nonce)?;
            let card = NameCard::new(*card.owner_key(), with_meta(card.metadata().clone(), &meta)?)?;
            card.save_new(&output)?;
            let shown = CardOutput { file: Some(output), ..CardOutput::new(&card) };
            context.output.print(&shown, || [card.name().to_string()])
        }
        Command::Derive { card: Some(path), .. } => {
            let card = NameCard::load(&path)?;
            context.output.print(&CardOutput::new(&card), || [card.name().to_string()])
        }
        Command::Derive { card: None, owner, meta } => {
            let owner = owner.context("derive a name of a CARD, or of --owner and --meta")?;
            let card = NameCard::new(owner, with_meta(Metadata::new(), &meta)?)?;
            context.output.print(&CardOutput::new(&card), || [card.name().to_string()])
        }
        Command::Show { card } => {
            let card = NameCard::load(&card)?;
            context.output.print(&CardOutput::new(&card), || {
                let own = [format!("name        {}", card.name()), format!("owner key   {}", card.owner_key())];
                let metadata = card.metadata().iter().map(|(key, value)| format!("{key:<10}  {value}"));
                own.into_iter().chain(metadata).collect::<Vec<_>>()
            })
        }
    }
}

fn with_meta(mut metadata: Metadata, meta: &[String]) -> anyhow::Result<Metadata> {
    for entry in meta {
        let (key, value) = entry.split_once('=').with_context(|| format!("--meta {entry}: not KEY=VALUE"))?;
        if metadata.insert(key.to_owned(), value.to_owned()).is_some() {
            bail!("--meta {key}: the key is set already, by an option of its own or an earlier --meta; leave one out");
        }
    }
    Ok(metadata)
}

impl CardOutput {
    fn new(card: &NameCard) -> Self {
        Self {
            name: card.name(),
            owner_key: card.owner_key().to_string(),
            digest: hex::encode(name::inner_digest(card.metadata())),
            metadata: card.metadata().clone(),
            file: None,
        }
    }
}
