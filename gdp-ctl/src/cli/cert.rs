//! `gdp-ctl cert`: what owners allow entities.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::{Args, Subcommand, ValueEnum};
use gdp::cert::{AdCert, CertError, Claims, Grantee, Issued, Mode, ReadGrant, RtCert, Signed, issue};
use gdp::identity::SigningKey;
use gdp::name::Name;
use gdp::{NameCard, VerifyKey};
use serde::Serialize;
use serde_json::{Value, json};

use super::{Context, output, serial_now, unix_now, validity};

/// Certificates are text of at most this length; a longer file is something else.
const MAX_FILE: u64 = 16 * 1024;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Allow an entity to publish (or serve) a name.
    Advertise {
        #[command(flatten)]
        grant: Grant,
        #[arg(long, value_enum, default_value = "unicast")]
        mode: DeliveryMode,
        /// A domain that may know the name; repeat for several. Without any: only the domain it is advertised in.
        #[arg(long, value_name = "NAME")]
        scope: Vec<Name>,
    },
    /// Allow an entity to subscribe to (or call) a name.
    Read {
        #[command(flatten)]
        grant: Grant,
    },
    /// Show what a certificate says; with a card, whether the owner of that name signed it and it is valid now.
    Show {
        file: PathBuf,
        #[arg(long)]
        card: Option<PathBuf>,
    },
}

#[derive(Debug, Args)]
pub struct Grant {
    /// The owner's private key file.
    #[arg(long)]
    owner: PathBuf,
    #[arg(long)]
    card: PathBuf,
    /// Whom to allow it: 64 hex digits, as `gdp-ctl key show` prints them.
    #[arg(long, value_name = "NAME")]
    entity: Name,
    #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u64).range(1..=36500))]
    days: u64,
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum DeliveryMode {
    Multicast,
    Anycast,
    Unicast,
}

impl From<DeliveryMode> for Mode {
    fn from(mode: DeliveryMode) -> Self {
        match mode {
            DeliveryMode::Multicast => Self::Multicast,
            DeliveryMode::Anycast => Self::Anycast,
            DeliveryMode::Unicast => Self::Unicast,
        }
    }
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Advertise { grant, mode, scope } => {
            let (owner, name, not_before, not_after) = grant.open()?;
            let (entity, mode, serial) = (grant.entity, mode.into(), serial_now());
            let claims = AdCert { name, entity, mode, scope, serial, not_before, not_after };
            grant.write(&owner, &claims, context)
        }
        Command::Read { grant } => {
            let (owner, name, not_before, not_after) = grant.open()?;
            let to = Grantee::Entity(grant.entity);
            let claims = ReadGrant { name, to, serial: serial_now(), not_before, not_after };
            grant.write(&owner, &claims, context)
        }
        Command::Show { file, card } => show(&file, card.as_deref(), context),
    }
}

impl Grant {
    fn open(&self) -> anyhow::Result<(SigningKey, Name, u64, u64)> {
        let owner = SigningKey::load(&self.owner)?;
        let card = NameCard::load(&self.card)?;
        if owner.verify_key() != *card.owner_key() {
            bail!(
                "{} is not the owner of {} ({}): its public key is {}, the card names {}",
                self.owner.display(),
                card.name(),
                self.card.display(),
                owner.verify_key(),
                card.owner_key()
            );
        }
        let (not_before, not_after) = validity(self.days * 86400);
        Ok((owner, card.name(), not_before, not_after))
    }

    fn write<T: Claims>(&self, owner: &SigningKey, claims: &T, context: &Context) -> anyhow::Result<()> {
        let signed = issue(owner, claims)?;
        output::write_new(&self.output, &signed.to_pem())?;
        let value = json!({"file": self.output, "kind": T::KIND, "claims": claims});
        context.output.print(value, || self.output.display().to_string())
    }
}

fn show(file: &Path, card: Option<&Path>, context: &Context) -> anyhow::Result<()> {
    let text = read(file)?;
    let owner = card.map(NameCard::load).transpose()?;
    let key = owner.as_ref().map(NameCard::owner_key);
    let value = if is::<AdCert>(&text) {
        describe::<AdCert>(&text, key)
    } else if is::<ReadGrant>(&text) {
        describe::<ReadGrant>(&text, key)
    } else if is::<RtCert>(&text) {
        describe::<RtCert>(&text, None)
    } else {
        bail!("{}: not a certificate: no line such as \"-----BEGIN {}-----\"", file.display(), AdCert::LABEL);
    };
    let value = value.with_context(|| file.display().to_string())?;
    if let (Some(card), Some(stated)) = (&owner, value["claims"]["name"].as_str())
        && stated != card.name().to_string()
    {
        bail!("{}: the certificate is for {stated}, not for the card's name {}", file.display(), card.name());
    }
    context.output.print(value.clone(), || {
        let mut text = format!("kind        {}\n", value["kind"].as_str().unwrap_or_default());
        for (key, claim) in value["claims"].as_object().into_iter().flatten() {
            let claim = claim.as_str().map_or_else(|| claim.to_string(), str::to_owned);
            text += &format!("{key:<10}  {claim}\n");
        }
        text + if owner.is_some() {
            "signed by the owner of the name, and valid now"
        } else {
            "not verified: give --card"
        }
    })
}

fn is<T: Claims>(text: &str) -> bool {
    text.contains(&format!("-----BEGIN {}-----", T::LABEL))
}

fn describe<T: Claims + Serialize>(text: &str, key: Option<&VerifyKey>) -> Result<Value, CertError> {
    let signed = Signed::<T>::from_pem(text)?;
    let claims = match key {
        Some(key) => signed.verify(key, unix_now())?,
        None => signed.claims_unverified()?,
    };
    Ok(json!({"kind": T::KIND, "claims": claims, "verified": key.is_some()}))
}

/// Reads a certificate file.
pub fn load(file: &Path) -> anyhow::Result<Issued<AdCert>> {
    Issued::from_pem(&read(file)?).with_context(|| file.display().to_string())
}

fn read(file: &Path) -> anyhow::Result<String> {
    use std::io::Read;
    let mut text = String::new();
    let opened = std::fs::File::open(file).with_context(|| format!("cannot open {}", file.display()))?;
    opened
        .take(MAX_FILE)
        .read_to_string(&mut text)
        .with_context(|| format!("cannot read {} as text", file.display()))?;
    Ok(text)
}
