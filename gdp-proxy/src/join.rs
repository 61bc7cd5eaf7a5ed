//! `gdp-proxy join`: makes this machine a member of a trust domain by an invitation, and enters it
//! in the domain's directory. `gdp-proxy leave` removes it again. The private keys are made here
//! and stay here.

use std::fs;
use std::io::{BufRead as _, Read as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use gdp::{Client, LinkConfig, Node, NodeConfig, NodeError};
use gdp_core::card::NameCard;
use gdp_core::cert::{Delegation, Enrollment, Issued, Membership, ReadGrant, issue};
use gdp_core::domain::{Credentials, Token};
use gdp_core::identity::{Identity, SigningKey, VerifyKey};
use gdp_core::name::Metadata;
use gdp_core::{cert::Grantee, secret_file};
use gdp_directory::messages::{Join, JoinReply, JoinRequest, OfferedCatalog};
use gdp_directory::{JOIN, join_card};
use gdp_util::escape::escape_json;
use gdp_util::unix_time::{unix_nanos, unix_seconds};

use crate::config::Config;

/// Maximum length of an invitation, in bytes.
const MAX_LINE: u64 = 16 << 10;

/// Time for which the join service is asked.
const PATIENT: Duration = Duration::from_secs(10);

/// Pause before the join service is asked again, because the route to it may not exist yet.
const SOON: Duration = Duration::from_millis(100);

/// Seconds by which a validity begins earlier, because clocks differ.
const BACKDATED: u64 = 300;

/// Files of a member in its folder.
pub struct Home {
    folder: PathBuf,
}

/// What a member has after it joined, for people.
pub struct Joined {
    pub lines: Vec<String>,
    pub config: PathBuf,
}

/// Where the invitation comes from.
pub enum InvitationSource {
    Line(String),
    File(PathBuf),
    Stdin,
}

impl InvitationSource {
    /// Reads the invitation. Errors contain nothing of it.
    pub fn read(self) -> Result<Token> {
        let mut line = String::new();
        let read = match self {
            Self::Line(line) => return Ok(Token::from_line(&line)?),
            Self::File(path) => fs::File::open(&path)
                .and_then(|file| file.take(MAX_LINE).read_to_string(&mut line))
                .with_context(|| format!("{}: cannot be read", path.display())),
            Self::Stdin => std::io::stdin()
                .lock()
                .take(MAX_LINE)
                .read_line(&mut line)
                .context("cannot read the invitation from stdin"),
        };
        read?;
        Ok(Token::from_line(&line)?)
    }
}

impl Home {
    /// Uses this folder, or the machine's.
    pub fn new(folder: Option<PathBuf>) -> Result<Self> {
        let folder = folder.or_else(gdp_util::folders::configuration);
        Ok(Self { folder: folder.context("no place for keys: say where with --dir, or set HOME")? })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Returns the path of the proxy's configuration.
    pub fn config(&self) -> PathBuf {
        self.file("proxy.yaml")
    }

    /// Joins the domain of the invitation. An attempt that failed may be repeated: the keys stay.
    pub async fn join(&self, token: &Token) -> Result<Joined> {
        if self.config().exists() {
            bail!(
                "{} exists: this machine has joined. Start it with `gdp-proxy {0}`, or `gdp-proxy leave` first",
                self.config().display()
            );
        }
        let Some(enrolling) = token.enrolling() else {
            bail!("this invitation admits a member and enrolls no topics: use it with `gdp-ctl domain join`");
        };
        fs::create_dir_all(&self.folder).with_context(|| format!("cannot create {}", self.folder.display()))?;
        let domain_key = token.domain().verify_key()?;
        let enrollment = enrolling.enrollment.verify(&domain_key, unix_seconds())?;
        let identity = Identity::load_or_generate(&self.file("proxy.pem"), "proxy")?;
        let membership = self.membership(token, &identity)?;
        let catalog = Some(self.catalog(&enrollment)?);
        let request = Join { membership: membership.clone(), enrollment: enrolling.enrollment.clone(), catalog };

        let credentials = Credentials { membership, peers: Vec::new() };
        let link = LinkConfig { target: token.at().clone(), switch: token.switch(), budget: None };
        let node = NodeConfig {
            links: vec![link],
            credentials: Some(credentials),
            ..NodeConfig::new(identity.clone(), token.at().clone())
        };
        let node = Node::connect(node).await.with_context(|| {
            format!("no way into the domain at {}; is its switch running, and UDP open on the way?", token.at())
        })?;
        let card = join_card(domain_key)?;
        let call = self.first_call(token, enrolling.call.clone(), &identity, &card)?;
        let reply = ask(&node, &card, call, &JoinRequest::Join(Box::new(request))).await;
        node.close().await;
        match reply? {
            JoinReply::Joined { directory, call } => {
                write(&self.file("directory.grant"), &directory.to_pem())?;
                write(&self.file("join.grant"), &call.to_pem())?;
            }
            JoinReply::Refused(reason) => bail!("the domain does not let this machine join: {reason}"),
            JoinReply::Left => bail!("the join service answers another question"),
        }
        write(&self.file("domain.card"), &domain_card(domain_key)?.to_json())?;
        let config = configuration(token, &enrollment);
        Config::parse(&config, &self.config())?;
        write(&self.config(), &config)?;
        Ok(Joined { lines: self.summary(token, &identity, &enrollment), config: self.config() })
    }

    /// Leaves the domain: removes this machine from the directory and the files of its membership.
    /// The owner's key stays, because the names of its topics are permanent.
    pub async fn leave(&self) -> Result<Vec<String>> {
        let config = Config::load(&self.config())?;
        let domain = NameCard::load(&self.file("domain.card"))?;
        let identity = Identity::new(SigningKey::load(&self.file("proxy.pem"))?, "proxy");
        let membership = fs::read_to_string(self.file("membership")).context("membership")?;
        let call = fs::read_to_string(self.file("join.grant")).context("join.grant")?;
        let credentials = Credentials { membership: Membership::from_pem(&membership)?, peers: Vec::new() };
        let links = config.links.iter().map(LinkConfig::from).collect();
        let first = config.links.first().context("no link")?.to.clone();
        let node = NodeConfig { links, credentials: Some(credentials), ..NodeConfig::new(identity, first) };
        let notified = match Node::connect(node).await {
            Ok(node) => {
                let card = join_card(*domain.owner_key())?;
                let reply = ask(&node, &card, Issued::from_pem(&call)?, &JoinRequest::Leave).await;
                node.close().await;
                reply.map(|_| ())
            }
            Err(error) => Err(error.into()),
        };
        for name in ["proxy.yaml", "membership", "domain.card", "directory.grant", "join.grant", "proxy.pem"] {
            match fs::remove_file(self.file(name)) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(error).with_context(|| format!("{}: cannot be removed", self.file(name).display()));
                }
                _ => {}
            }
        }
        Ok(match notified {
            Ok(()) => vec!["Left. The domain's directory no longer lists this machine.".into()],
            Err(error) => vec![
                "Left, and the files are removed. The domain was not notified:".into(),
                format!("  {error:#}"),
                "Have its administrator revoke this machine by its label.".into(),
            ],
        })
    }

    /// Returns the membership, which an earlier attempt may have made.
    fn membership(&self, token: &Token, identity: &Identity) -> Result<Membership> {
        let path = self.file("membership");
        if let Ok(text) = fs::read_to_string(&path) {
            let known = Membership::from_pem(&text).with_context(|| path.display().to_string())?;
            if known.serial_unverified()? == token.invite()?.serial {
                return Ok(known);
            }
        }
        let membership = token.admit(identity.name(), unix_seconds().saturating_sub(BACKDATED), unix_nanos())?;
        write(&path, &membership.to_pem())?;
        Ok(membership)
    }

    /// Makes the key of the owner of this machine's topics, and their catalog.
    fn catalog(&self, enrollment: &Enrollment) -> Result<OfferedCatalog> {
        let owner = SigningKey::load_or_generate(&self.file("owner.pem"))?;
        let path = self.file("catalog.card");
        let card = match NameCard::load(&path) {
            Ok(card) if *card.owner_key() == owner.verify_key() => card,
            _ => {
                let card =
                    NameCard::create(owner.verify_key(), "catalog", &format!("/{}", enrollment.label), "", None)?;
                write(&path, &card.to_json())?;
                card
            }
        };
        offer(&owner, &card, enrollment)
    }

    /// Lets this entity call the join service once, by the invitation's key.
    fn first_call(
        &self,
        token: &Token,
        delegation: gdp_core::cert::Signed<Delegation>,
        identity: &Identity,
        card: &NameCard,
    ) -> Result<Issued<ReadGrant>> {
        let (name, to) = (card.name(), Grantee::Entity(identity.name()));
        let (serial, now) = (unix_nanos(), unix_seconds());
        let (not_before, not_after) = (now.saturating_sub(BACKDATED), token.invite()?.not_after);
        let cert = issue(token.key(), &ReadGrant { name, to, serial, not_before, not_after })?;
        Ok(Issued { cert, delegation: Some(delegation) })
    }

    fn summary(&self, token: &Token, identity: &Identity, enrollment: &Enrollment) -> Vec<String> {
        let Enrollment { label, expose, import, read, .. } = enrollment;
        let mut lines = vec![format!("Joined as {label} ({:#}) at {}", identity.name(), token.at())];
        if !expose.is_empty() {
            lines.push(format!("Exposes   {}", expose.join(" ")));
        }
        for of in import {
            lines.push(format!("Imports   {} from {}", of.topics.join(" "), of.member));
        }
        for of in read {
            lines.push(format!("Reads     {} of {}", of.topics.join(" "), of.member));
        }
        lines.push(format!("Keys      in {}, made here; they never leave", self.folder.display()));
        lines.push(format!("Change    {}; the proxy reloads it", self.config().display()));
        lines.push("Leave     gdp-proxy leave".to_owned());
        lines
    }
}

/// Lets the join service grant the catalog to members, and nothing else.
pub fn offer(owner: &SigningKey, card: &NameCard, enrollment: &Enrollment) -> Result<OfferedCatalog> {
    let delegation = Delegation {
        name: card.name(),
        delegate: enrollment.join_service,
        publish: false,
        read: true,
        serial: unix_nanos(),
        not_before: unix_seconds().saturating_sub(BACKDATED),
        not_after: enrollment.not_after,
    };
    Ok(OfferedCatalog { name: card.into(), delegation: issue(owner, &delegation)? })
}

/// Returns the card of a domain. All domains have the same metadata.
fn domain_card(key: VerifyKey) -> Result<NameCard> {
    Ok(NameCard::new(key, Metadata::from([("kind".to_owned(), "domain".to_owned())]))?)
}

/// Asks the join service, repeatedly until there is a route to it.
async fn ask(node: &Node, card: &NameCard, call: Issued<ReadGrant>, request: &JoinRequest) -> Result<JoinReply> {
    let asked = async {
        let client = node.client(card.proof(), call.into()).await?;
        let reply = ask_client(&client, &request.to_bytes()?).await?;
        anyhow::Ok(JoinReply::from_bytes(&reply)?)
    };
    match tokio::time::timeout(PATIENT, asked).await {
        Ok(reply) => reply.context("the domain's join service cannot be asked"),
        Err(_) => bail!(
            "the domain's join service did not answer for {} s; is `gdp-ctl up` running on its server? Try again",
            PATIENT.as_secs()
        ),
    }
}

async fn ask_client(client: &Client, request: &[u8]) -> Result<bytes::Bytes, NodeError> {
    loop {
        match tokio::time::timeout(Duration::from_secs(2), client.call(JOIN, request)).await {
            Ok(Ok(reply)) => return Ok(reply.body),
            Ok(Err(NodeError::NoServer(_) | NodeError::NoInstance { .. } | NodeError::InstanceLeft { .. })) => {
                tokio::time::sleep(SOON).await;
            }
            Ok(Err(error)) => return Err(error),
            // The first frames may be lost while the routes are made.
            Err(_) => {}
        }
    }
}

fn configuration(token: &Token, enrollment: &Enrollment) -> String {
    let quoted = |text: &str| escape_json(&serde_json::json!(text).to_string()).into_owned();
    let switch = token.switch().map_or(String::new(), |switch| format!(", switch: {switch}"));
    let to = quoted(&token.at().to_string());
    let topics: Vec<String> = enrollment.expose.iter().map(|pattern| quoted(pattern)).collect();
    let topics = topics.join(", ");
    format!(
        "version: 1\nidentity: proxy.pem\nlinks: [{{to: {to}{switch}}}]\nstate: state\n\
         domain: {{card: domain.card, membership: membership}}\ndirectory: {{grant: directory.grant}}\n\
         expose: {{owner: owner.pem, catalog: catalog.card, topics: [{topics}]}}\n"
    )
}

fn write(path: &Path, content: &str) -> Result<()> {
    Ok(secret_file::replace(path, content.as_bytes())?)
}
