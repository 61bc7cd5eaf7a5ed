//! `gdp-proxy join`: makes this machine a member of a trust domain by an invitation, and enters it
//! in the domain's directory. `gdp-proxy leave` removes it again. The private keys are made here
//! and stay here.

use std::fs;
use std::io::{BufRead as _, Read as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, bail};
use gdp::unstable::{Client, LinkConfig, Node, NodeConfig, NodeError};
use gdp_core::card::NameCard;
use gdp_core::cert::domain::roles;
use gdp_core::cert::enrollment::split_kind;
use gdp_core::cert::{
    AdCert, BACKDATED, Claims as _, Delegation, Enrollment, Grantee, Issued, Membership, ReadGrant, Signed, TopicsOf,
    issue,
};
use gdp_core::domain::{Credentials, Enrolling, Token};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_core::secret_file;
use gdp_directory::messages::{Application, Approval, Join, JoinReply, JoinRequest, OfferedCatalog};
use gdp_directory::{JOIN, SERVER, directory_card, fingerprint, join_card};
use gdp_util::escape::escape_json;
use gdp_util::unix_time::{unix_nanos, unix_seconds};
use gdp_util::{folders, ownership};
use gdp_wire::Name;

use crate::config::Config;

/// Maximum length of an invitation, in bytes.
const MAX_LINE: u64 = 16 << 10;

/// Time for which the join service is asked.
const PATIENT: Duration = Duration::from_secs(10);

/// Pause between two questions whether the machine is approved.
const APPLY_AGAIN: Duration = Duration::from_secs(2);

/// Pause before the join service is asked again, because the route to it may not exist yet.
const SOON: Duration = Duration::from_millis(100);

/// Files that end with the membership.
const MEMBER_FILES: [&str; 8] = [
    "proxy.yaml",
    "membership",
    "domain.card",
    "directory.card",
    "directory.grant",
    "join.grant",
    "proxy.pem",
    "application.pem",
];

/// Files of a member in its folder.
pub struct Home {
    folder: PathBuf,
}

/// What a member has after it joined, for people.
pub struct Joined {
    pub lines: Vec<String>,
    pub config: PathBuf,
}

/// What a machine asks for, if its invitation does not say it.
#[derive(Clone, Debug)]
pub struct Wishes {
    pub label: String,
    pub expose: Vec<String>,
    pub import: Vec<TopicsOf>,
    pub read: Vec<TopicsOf>,
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
        let folder = folder.or_else(folders::configuration);
        Ok(Self { folder: folder.context("no place for keys: say where with --dir, or set HOME")? })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the path of the proxy's configuration.
    pub fn config(&self) -> PathBuf {
        self.file("proxy.yaml")
    }

    /// Joins the domain of the invitation. An attempt that failed may be repeated: the keys stay.
    /// With an invitation for applicants, it first waits for approval. `say` shows a line.
    pub async fn join(&self, token: &Token, wishes: Wishes, say: impl Fn(String)) -> Result<Joined> {
        if token.invite()?.role != roles::APPLICANT {
            return self.enroll(token).await;
        }
        self.check_new()?;
        let approved = self.apply(token, wishes, say).await?;
        self.enroll(&approved).await
    }

    fn check_new(&self) -> Result<()> {
        if self.config().exists() {
            bail!(
                "{} exists: this machine has joined. Start it with `gdp-proxy {0}`, or `gdp-proxy leave` first",
                self.config().display()
            );
        }
        ownership::create(&self.folder).with_context(|| format!("cannot create {}", self.folder.display()))
    }

    /// Asks to join until a person has decided, and returns the invitation.
    async fn apply(&self, token: &Token, wishes: Wishes, say: impl Fn(String)) -> Result<Token> {
        let enrolling = token.enrolling().context("the invitation enrolls nobody")?;
        let identity = Identity::load_or_generate(&self.file("proxy.pem"), "proxy")?;
        let key = SigningKey::load_or_generate(&self.file("application.pem"))?;
        let Wishes { label, expose, import, read } = wishes;
        let application = Application { key: key.verify_key(), label, expose, import, read };
        let membership = token.admit(identity.name(), unix_seconds().saturating_sub(BACKDATED), unix_nanos())?;
        let node = connect(token, &identity, membership).await?;
        say(format!("Asks to join as {}. Fingerprint: {}", application.label, fingerprint(identity.name())));
        say("Waits for approval: `gdp-ctl robots` on the domain's server shows the same fingerprint.".into());
        let service = enrolling.enrollment.claims_unverified()?.join_service;
        let card = join_card(service)?;
        let request = JoinRequest::Apply(Box::new(application));
        let approval = loop {
            let call = self.first_call(token, enrolling.call.clone(), &identity, &card)?;
            match ask(&node, &card, call, &request).await {
                Ok(JoinReply::Approved(approval)) => break *approval,
                Ok(JoinReply::Refused(reason)) => bail!("the domain does not let this machine join: {reason}"),
                // The server may be away for a while.
                Ok(_) | Err(_) => tokio::time::sleep(APPLY_AGAIN).await,
            }
        };
        node.close().await;
        let Approval { invite, enrollment, call } = approval;
        let approved = Token::new(*token.domain(), invite, key, token.at().clone(), token.switch())?;
        let approved = approved.also(token.addresses().skip(1).cloned().collect());
        Ok(approved.with_successor(token.successor()).enroll(Enrolling { enrollment, call })?)
    }

    /// Joins with an invitation of this machine's own.
    async fn enroll(&self, token: &Token) -> Result<Joined> {
        self.check_new()?;
        let Some(enrolling) = token.enrolling() else {
            bail!("this invitation admits a member and enrolls no topics: use it with `gdp-ctl domain join`");
        };
        let enrollment = enrolling.enrollment.verify_for_name(token.domain())?;
        enrollment.check_time(unix_seconds())?;
        let identity = Identity::load_or_generate(&self.file("proxy.pem"), "proxy")?;
        let membership = self.membership(token, &identity)?;
        let catalog = Some(self.catalog(identity.name(), &enrollment)?);
        let request = Join { membership: membership.clone(), enrollment: enrolling.enrollment.clone(), catalog };

        let node = connect(token, &identity, membership).await?;
        let card = join_card(enrollment.join_service)?;
        let call = self.first_call(token, enrolling.call.clone(), &identity, &card)?;
        let reply = ask(&node, &card, call, &JoinRequest::Join(Box::new(request))).await;
        let used = node.links().into_iter().find(|link| link.main).map(|link| link.target);
        node.close().await;
        match reply? {
            JoinReply::Joined { directory, call } => {
                write(&self.file("directory.grant"), &directory.to_pem())?;
                write(&self.file("join.grant"), &call.to_pem())?;
            }
            JoinReply::Refused(reason) => bail!("the domain does not let this machine join: {reason}"),
            _ => bail!("the join service answers another question"),
        }
        write(&self.file("domain.card"), &token.domain_card()?.to_json())?;
        write(&self.file("directory.card"), &directory_card(enrollment.join_service)?.to_json())?;
        let config = configuration(token, &enrollment);
        Config::parse(&config, &self.config())?;
        write(&self.config(), &config)?;
        let at = used.unwrap_or_else(|| token.at().to_string());
        Ok(Joined { lines: self.summary(&at, &identity, &enrollment), config: self.config() })
    }

    /// Leaves the domain: removes this machine from the directory and the files of its membership.
    /// The owner's key stays, because the names of its topics are permanent. Without `force`, the
    /// files stay if the domain does not confirm it.
    pub async fn leave(&self, force: bool) -> Result<Vec<String>> {
        let notified = self.notify_leave().await;
        match (notified, force) {
            (Err(error), false) => {
                let stays = "the domain does not know that this machine leaves, so its files stay. If the proxy runs, \
                             stop it first; `--force` leaves without the domain";
                Err(error.context(stays))
            }
            (notified, _) => {
                for name in MEMBER_FILES {
                    match fs::remove_file(self.file(name)) {
                        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                            return Err(error).with_context(|| format!("{} stays", self.file(name).display()));
                        }
                        _ => {}
                    }
                }
                Ok(vec![match notified {
                    Ok(()) => "Left. The domain's directory no longer lists this machine.".into(),
                    Err(_) => "Left. Have the domain's administrator revoke this machine by its label.".into(),
                }])
            }
        }
    }

    /// Removes this machine from the domain's directory.
    async fn notify_leave(&self) -> Result<()> {
        let config = Config::load(&self.config())?;
        let directory = NameCard::load(&self.file("directory.card"))?;
        let identity = Identity::new(SigningKey::load(&self.file("proxy.pem"))?, "proxy");
        let membership = fs::read_to_string(self.file("membership")).context("membership")?;
        let call = fs::read_to_string(self.file("join.grant")).context("join.grant")?;
        let credentials = Credentials { membership: Membership::from_pem(&membership)?, peers: Vec::new() };
        let links = config.links.iter().map(LinkConfig::from).collect();
        let first = config.links.first().context("no link")?.to.clone();
        let node = NodeConfig { links, credentials: Some(credentials), ..NodeConfig::new(identity, first) };
        let node = Node::connect(node).await?;
        let reply =
            ask(&node, &join_card(*directory.owner_key())?, Issued::from_pem(&call)?, &JoinRequest::Leave).await;
        node.close().await;
        match reply? {
            JoinReply::Left => Ok(()),
            JoinReply::Refused(reason) => Err(anyhow!(reason)),
            _ => Err(anyhow!("the join service answers another question")),
        }
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
    fn catalog(&self, entity: Name, enrollment: &Enrollment) -> Result<OfferedCatalog> {
        let owner = Identity::load_or_generate(&self.file("owner.pem"), "owner")?.key().clone();
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
        offer(&owner, &card, entity, enrollment)
    }

    /// Lets this entity call the join service once, by the invitation's key.
    fn first_call(
        &self,
        token: &Token,
        delegation: Signed<Delegation>,
        identity: &Identity,
        card: &NameCard,
    ) -> Result<Issued<ReadGrant>> {
        let (name, to) = (card.name(), Grantee::Entity(identity.name()));
        let (serial, now) = (unix_nanos(), unix_seconds());
        let (not_before, not_after) = (now.saturating_sub(BACKDATED), token.invite()?.not_after);
        let cert = issue(token.key(), &ReadGrant { name, to, serial, not_before, not_after })?;
        Ok(Issued { cert, delegation: Some(delegation) })
    }

    /// `at`: the address by which this machine joined.
    fn summary(&self, at: &str, identity: &Identity, enrollment: &Enrollment) -> Vec<String> {
        let Enrollment { label, expose, import, read, .. } = enrollment;
        let mut lines = vec![format!("Joined as {label} ({:#}) at {at}", identity.name())];
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

/// Lets the join service grant the catalog of `entity` to members, and nothing else.
fn offer(owner: &SigningKey, card: &NameCard, entity: Name, enrollment: &Enrollment) -> Result<OfferedCatalog> {
    let (name, delegate, serial) = (card.name(), enrollment.join_service, unix_nanos());
    let (not_before, not_after) = (unix_seconds().saturating_sub(BACKDATED), enrollment.not_after);
    let right = AdCert { name, entity, scope: vec![], serial, not_before, not_after };
    let delegation = Delegation { name, delegate, publish: false, read: true, serial, not_before, not_after };
    Ok(OfferedCatalog { name: card.into(), right: issue(owner, &right)?, delegation: issue(owner, &delegation)? })
}

/// Attaches at the switch that the invitation names.
async fn connect(token: &Token, identity: &Identity, membership: Membership) -> Result<Node> {
    let credentials = Some(Credentials { membership, peers: Vec::new() });
    let link = |target: &LinkTarget| LinkConfig { target: target.clone(), switch: token.switch(), budget: None };
    let links = token.addresses().map(link).collect();
    let config = NodeConfig { links, credentials, ..NodeConfig::new(identity.clone(), token.at().clone()) };
    Node::connect(config).await.with_context(|| {
        let addresses: Vec<_> = token.addresses().map(ToString::to_string).collect();
        let tls = if addresses.len() > 1 { "" } else { " Where no UDP passes, the server needs `gdp-ctl up --tls`" };
        format!("no path to the domain at {}; is its switch running, and the port open?{tls}", addresses.join(" or "))
    })
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
    let link = |to: &LinkTarget| format!("{{to: {}{switch}}}", quoted(&to.to_string()));
    let links = token.addresses().map(link).collect::<Vec<_>>().join(", ");
    let list = |wanted: &str| {
        let of_kind = enrollment.expose.iter().map(|pattern| split_kind(pattern)).filter(|(kind, _)| *kind == wanted);
        of_kind.map(|(_, pattern)| quoted(pattern)).collect::<Vec<_>>().join(", ")
    };
    let calls = [("services", list("service:")), ("actions", list("action:"))];
    let calls = calls.into_iter().filter(|(_, list)| !list.is_empty());
    let (topics, calls) = (list(""), calls.map(|(key, list)| format!(", {key}: [{list}]")).collect::<String>());
    let export = if enrollment.label == SERVER { ", export: true" } else { "" };
    format!(
        "version: 1\nidentity: proxy.pem\nlinks: [{links}]\nstate: state\n\
         domain: {{card: domain.card, membership: membership}}\n\
         directory: {{card: directory.card, grant: directory.grant{export}}}\n\
         expose: {{owner: owner.pem, catalog: catalog.card, topics: [{topics}]{calls}}}\n"
    )
}

fn write(path: &Path, content: &str) -> Result<()> {
    Ok(secret_file::replace(path, content.as_bytes())?)
}
