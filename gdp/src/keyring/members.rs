//! Topics and services of the other members of a domain, found by `/LABEL/NAME`: the directory of
//! the domain lists the members, and the catalog of each lists what this key may read.

use std::time::Duration;

use gdp_core::card::NameCard;
use gdp_core::cert::Reading;
use gdp_directory::DIRECTORY;
use gdp_directory::catalog::{CATALOG, Catalog, CatalogError, right_of};
use gdp_directory::directory::{Directory, DirectoryError, Member};
use gdp_e2e::seal::Encoding;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;

use super::{DirectoryRight, Keyring, RightError, called};
use crate::node::{Node, NodeError, SubscribeOptions};

/// Why a name of another member is not found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MembersError {
    /// It is not written as the name of a member.
    #[error("{what} is not in the keyring, and not a {kind} of a member, which is written /LABEL/{}", kind.to_uppercase())]
    NoMembersName {
        /// What was searched for.
        what: String,
        /// `topic` or `service`.
        kind: String,
    },
    /// The directory lists no such member.
    #[error("no member has the label {label}; the directory of the domain lists {labels}")]
    NoMember {
        /// What was searched for.
        label: String,
        /// Some of the labels that there are.
        labels: String,
    },
    /// The member shares nothing with this entity.
    #[error("{label} shares nothing with this machine, which is {me}; {remedy}")]
    NothingShared {
        /// The member.
        label: String,
        /// The label of this entity.
        me: String,
        /// What to do.
        remedy: String,
    },
    /// The member does not share this name with this entity.
    #[error("{label} lists no {kind} {name} for {me}, but {names}; if it is published there, {remedy}")]
    NotShared {
        /// The member.
        label: String,
        /// `topic` or `service`.
        kind: String,
        /// The name at the member.
        name: String,
        /// The label of this entity.
        me: String,
        /// Some of the names that the member shares.
        names: String,
        /// What to do.
        remedy: String,
    },
    /// The keyring is not that of a member.
    #[error("the keyring has no grant to read a directory; join the domain with a line of `gdp-ctl invite`")]
    NoDirectory,
    /// The grant for the directory does not hold.
    #[error(transparent)]
    Right(#[from] RightError),
    /// The directory did not arrive.
    #[error("the directory of the domain did not arrive in {} s; is `gdp-ctl up` running on the domain's server?",
            TIMEOUT.as_secs())]
    DirectorySilent,
    /// The catalog of a member did not arrive.
    #[error("the list of topics of {label} did not arrive in {} s; is its proxy running?", TIMEOUT.as_secs())]
    CatalogSilent {
        /// The member.
        label: String,
    },
    /// This entity is no member any more.
    #[error("{0:#} is not in the directory of the domain: it has left or was revoked; join with another line")]
    NotListed(Name),
    /// What arrived is no directory.
    #[error(transparent)]
    Directory(#[from] DirectoryError),
    /// What arrived is no catalog.
    #[error(transparent)]
    Catalog(#[from] CatalogError),
    /// The fabric refused.
    #[error(transparent)]
    Node(#[from] NodeError),
}

/// Time to wait for the directory or a catalog. Their publishers repeat them to new readers.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of names in an error.
const MAX_NAMES: usize = 16;

/// A name of another member that this key may read or call.
#[derive(Debug)]
pub struct SharedName {
    /// The name here: `/LABEL` and the name at the member.
    pub alias: String,
    /// The card of the name.
    pub card: NameCard,
    /// The right to read or call it.
    pub grant: Reading,
}

/// Finds the topic or service `/LABEL/NAME` (`kind`).
pub async fn find(node: &Node, keyring: &Keyring, what: &str, kind: &str) -> Result<SharedName, MembersError> {
    let Some((label, name)) = parse(what) else {
        return Err(MembersError::NoMembersName { what: what.into(), kind: kind.into() });
    };
    let (own, members) = members(node, keyring).await?;
    let Some(member) = members.iter().find(|member| member.enrollment.label == label) else {
        let labels = listed(members.iter().map(|member| member.enrollment.label.as_str()));
        return Err(MembersError::NoMember { label: label.into(), labels });
    };
    let me = own.enrollment.label;
    let remedy = format!(
        "have the domain's administrator give {me} the right, in a new line from `gdp-ctl invite {me} --read \
         '{label}:{name}'`"
    );
    let Some(shared) = shared(node, keyring, member, kind).await? else {
        return Err(MembersError::NothingShared { label: label.into(), me, remedy });
    };
    let names = listed(shared.iter().map(|shared| shared.alias.as_str()));
    let (label, kind, name) = (label.to_owned(), kind.to_owned(), name.to_owned());
    let found = shared.into_iter().find(|shared| shared.alias == what);
    found.ok_or(MembersError::NotShared { label, kind, name, me, names, remedy })
}

/// Returns all topics or services (`kind`) of other members that this key may read or call. The
/// second list has the members that did not answer, with the reason.
pub async fn all(node: &Node, keyring: &Keyring, kind: &str) -> Result<(Vec<SharedName>, Vec<String>), MembersError> {
    let (_, members) = members(node, keyring).await?;
    let asked = members.iter().map(|member| shared(node, keyring, member, kind));
    let (mut names, mut unanswered) = (Vec::new(), Vec::new());
    // A member may be switched off, so one timeout is for all.
    for answer in futures::future::join_all(asked).await {
        match answer {
            Ok(shared) => names.extend(shared.into_iter().flatten()),
            Err(error) => unanswered.push(error.to_string()),
        }
    }
    names.sort_by(|one, other| one.alias.cmp(&other.alias));
    Ok((names, unanswered))
}

/// Splits `/LABEL/NAME` into the label and the name at the member.
fn parse(what: &str) -> Option<(&str, &str)> {
    let rest = what.strip_prefix('/')?;
    let (label, name) = rest.split_at(rest.find('/')?);
    (!label.is_empty() && name.len() > 1).then_some((label, name))
}

/// Reads the directory. Returns this key's own entry, and the other members.
async fn members(node: &Node, keyring: &Keyring) -> Result<(Member, Vec<Member>), MembersError> {
    let (own, now) = (node.name(), unix_seconds());
    let right = keyring.directory(own, now).ok_or(MembersError::NoDirectory)??;
    let DirectoryRight { card, domain, grant } = right;
    let body = latest(node, &card, grant, DIRECTORY).await?.ok_or(MembersError::DirectorySilent)?;
    let mut members = Directory::from_bytes(&body)?.members(domain, own, now);
    let at = members.iter().position(|member| member.entity == own).ok_or(MembersError::NotListed(own))?;
    let own = members.swap_remove(at);
    Ok((own, members))
}

/// Reads the catalog of a member. Returns `None` if this key may not read it.
async fn shared(
    node: &Node,
    keyring: &Keyring,
    member: &Member,
    kind: &str,
) -> Result<Option<Vec<SharedName>>, MembersError> {
    let (Some(catalog), Some(grant)) = (&member.catalog, &member.grant) else { return Ok(None) };
    let label = &member.enrollment.label;
    let body = latest(node, catalog, grant.clone().into(), CATALOG).await?;
    let body = body.ok_or_else(|| MembersError::CatalogSilent { label: label.clone() })?;
    let membership = keyring.credentials.as_ref().and_then(|files| files.load().ok());
    let membership = membership.map(|credentials| credentials.membership);
    let (own, now) = (node.name(), unix_seconds());
    let name = |(card, grants): (NameCard, Vec<_>)| {
        let grant = right_of(&card, grants, own, membership.as_ref(), now)?;
        (card.get("kind") == Some(kind)).then(|| SharedName {
            alias: format!("/{label}{}", called(&card)),
            card,
            grant,
        })
    };
    Ok(Some(Catalog::read(&body, *catalog.owner_key())?.into_iter().filter_map(name).collect()))
}

/// Returns the first message of this encoding. `None` if none arrives in time.
async fn latest(
    node: &Node,
    card: &NameCard,
    grant: Reading,
    encoding: Encoding,
) -> Result<Option<bytes::Bytes>, NodeError> {
    let mut subscription = node.subscribe(card.proof(), grant, SubscribeOptions::reliable()).await?;
    let received = tokio::time::timeout(TIMEOUT, async {
        loop {
            match subscription.recv().await {
                Some(message) if message.encoding == encoding => return Some(message.body),
                Some(_) => {}
                None => return None,
            }
        }
    });
    Ok(received.await.unwrap_or(None))
}

/// Returns at most [`MAX_NAMES`] names, for an error.
fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut names: Vec<&str> = names.take(MAX_NAMES + 1).collect();
    if names.is_empty() {
        return "nothing".into();
    }
    if names.len() > MAX_NAMES {
        names[MAX_NAMES] = "…";
    }
    names.join(", ")
}

#[cfg(test)]
#[path = "../../tests/unit/keyring/members.rs"]
mod tests;
