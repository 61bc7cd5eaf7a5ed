//! Topics and services of the other members of a domain, found by `/LABEL/NAME`: the directory of
//! the domain lists the members, and the catalog of each lists what this key may read.

use std::time::Duration;

use anyhow::{Context as _, bail};
use gdp::{Encoding, SubscribeOptions};
use gdp_core::card::NameCard;
use gdp_core::cert::Reading;
use gdp_directory::DIRECTORY;
use gdp_directory::directory::{Directory, Member};
use gdp_ros::catalog::{CATALOG, Catalog, right_of};
use gdp_util::unix_time::unix_seconds;

use super::fabric::Fabric;
use super::keyring::{DirectoryRight, called};

/// Time to wait for the directory or a catalog. Their publishers repeat them to new readers.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of names in an error.
const MAX_NAMES: usize = 16;

/// A name of another member that this key may read or call.
pub struct SharedName {
    /// The name here: `/LABEL` and the name at the member.
    pub alias: String,
    pub card: NameCard,
    pub grant: Reading,
}

/// Finds the topic or service `/LABEL/NAME` (`kind`).
pub async fn find(fabric: &Fabric, what: &str, kind: &str) -> anyhow::Result<SharedName> {
    let Some((label, name)) = parse(what) else {
        bail!(
            "{what} is not in the keyring, and not a {kind} of a member, which is written /LABEL/{}",
            kind.to_uppercase()
        )
    };
    let (own, members) = members(fabric).await?;
    let Some(member) = members.iter().find(|member| member.enrollment.label == label) else {
        let labels = listed(members.iter().map(|member| member.enrollment.label.as_str()));
        bail!("no member has the label {label}; the directory of the domain lists {labels}");
    };
    let me = &own.enrollment.label;
    let remedy = format!(
        "have the domain's administrator give {me} the right, in a new line from `gdp-ctl invite {me} --read \
         '{label}:{name}'`"
    );
    let Some(shared) = shared(fabric, member, kind).await? else {
        bail!("{label} shares nothing with this machine, which is {me}; {remedy}");
    };
    let names = listed(shared.iter().map(|shared| shared.alias.as_str()));
    shared.into_iter().find(|shared| shared.alias == what).with_context(|| {
        format!("{label} lists no {kind} {name} for {me}, but {names}; if it is published there, {remedy}")
    })
}

/// Returns all topics or services (`kind`) of other members that this key may read or call. The
/// second list has the members that did not answer, with the reason.
pub async fn all(fabric: &Fabric, kind: &str) -> anyhow::Result<(Vec<SharedName>, Vec<String>)> {
    let (_, members) = members(fabric).await?;
    let asked = members.iter().map(|member| shared(fabric, member, kind));
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
async fn members(fabric: &Fabric) -> anyhow::Result<(Member, Vec<Member>)> {
    let (own, now) = (fabric.node.name(), unix_seconds());
    let right = fabric.keyring.directory(own, now).context("the keyring has no grant to read a directory")??;
    let DirectoryRight { card, domain, grant } = right;
    let body = latest(fabric, &card, grant, DIRECTORY).await?.with_context(|| {
        format!(
            "the directory of the domain did not arrive in {} s; is `gdp-ctl up` running on the domain's server?",
            TIMEOUT.as_secs()
        )
    })?;
    let mut members = Directory::from_bytes(&body)?.members(domain, own, now);
    let at = members.iter().position(|member| member.entity == own).with_context(|| {
        format!("{own:#} is not in the directory of the domain: it has left or was revoked; join with another line")
    })?;
    let own = members.swap_remove(at);
    Ok((own, members))
}

/// Reads the catalog of a member. Returns `None` if this key may not read it.
async fn shared(fabric: &Fabric, member: &Member, kind: &str) -> anyhow::Result<Option<Vec<SharedName>>> {
    let (Some(catalog), Some(grant)) = (&member.catalog, &member.grant) else { return Ok(None) };
    let label = &member.enrollment.label;
    let body = latest(fabric, catalog, grant.clone().into(), CATALOG).await?.with_context(|| {
        format!("the list of topics of {label} did not arrive in {} s; is its proxy running?", TIMEOUT.as_secs())
    })?;
    let membership = fabric.keyring.credentials.as_ref().and_then(|files| files.load().ok());
    let membership = membership.map(|credentials| credentials.membership);
    let (own, now) = (fabric.node.name(), unix_seconds());
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
    fabric: &Fabric,
    card: &NameCard,
    grant: Reading,
    encoding: Encoding,
) -> anyhow::Result<Option<bytes::Bytes>> {
    let mut subscription = fabric.node.subscribe(card.proof(), grant, SubscribeOptions::reliable()).await?;
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
#[path = "../../tests/unit/ros/members.rs"]
mod tests;
