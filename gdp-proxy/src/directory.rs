//! Follows the directory of the trust domain. What its members share with this proxy, or it with
//! them, is then exposed and imported without a section of its own in the configuration. A renewed
//! membership of this proxy comes with the directory.

use std::convert::Infallible;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use gdp::unstable::{Node, NodeError, SubscribeOptions};
use gdp_core::cert::{CertError, Membership, Reading};
use gdp_core::secret_file;
use gdp_directory::DIRECTORY;
use gdp_directory::directory::{Directory, DirectoryError, Member};
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;
use tokio::sync::watch;

use crate::config::{ImportConfig, MemberReader, PatternsByKind, Remap, SharedImport, SharedTopics};
use crate::material::{DirectoryMaterial, ImportMaterial};
use crate::offload::run_blocking_if_large;
use crate::permission::Permission;
use crate::renewal::{Notified, Renewal};
use crate::ros2::TopicName;
use crate::route_status::{RETRY, Right, RouteStatus, ticks};
use crate::stats::DirectoryStats;
use crate::waiting::Waiting;

/// The members whose certificates hold, in the order of their labels.
pub type Members = Arc<[Member]>;

/// What the members share, as it adds to the configuration.
#[derive(Default)]
pub struct SharedByDirectory {
    pub exposed: SharedTopics,
    pub imports: Vec<(ImportConfig, ImportMaterial)>,
}

/// Reads the directory, forever, and reports each change. Without a directory it does nothing,
/// forever. The members of the last directory stay while its publisher is away.
pub async fn follow(
    node: &Node,
    material: Option<DirectoryMaterial>,
    status: Option<&RouteStatus>,
    members: &watch::Sender<Members>,
) -> Infallible {
    let (Some(material), Some(status)) = (material, status) else { return std::future::pending().await };
    let DirectoryMaterial { card, domain, membership, grant, file } = material;
    let (mut right, mut pause) = (Right::read(grant, file), RETRY);
    loop {
        let subscribed = node.subscribe(card.proof(), right.current(), SubscribeOptions::reliable()).await;
        let error = match subscribed {
            Ok(mut subscription) => {
                pause = RETRY;
                status.is_up();
                if members.borrow().is_empty() {
                    status.set_status(Waiting::Directory.as_str());
                }
                let mut looks = ticks();
                loop {
                    tokio::select! {
                        message = subscription.recv() => match message {
                            Some(message) if message.encoding == DIRECTORY => {
                                take(&message.body, domain, node.name(), &membership, members);
                                status.set_status("up");
                            }
                            Some(_) => {}
                            None => break NodeError::from(subscription.ended().await),
                        },
                        _ = looks.tick() => status.renew(&mut right, async |new| subscription.renew(new).await).await,
                    }
                }
            }
            Err(error) => error,
        };
        status.pause(error, &mut pause, &mut right).await;
    }
}

/// Returns the status of the directory, if there is one.
pub fn status(material: Option<&DirectoryMaterial>) -> Option<RouteStatus> {
    material.map(|of| RouteStatus::new("directory".into(), of.card.name(), None, None))
}

/// Returns the directory's part of the statistics.
pub fn stats(status: &RouteStatus) -> DirectoryStats {
    DirectoryStats { name: status.name(), status: status.status(), waiting_for: status.waiting_for() }
}

/// Looks at what the directory waits for.
pub fn look(status: &RouteStatus, node: &Node) {
    let waits_for = || (status.status() == Waiting::Directory.as_str()).then_some(Waiting::Directory);
    let detail = |_| "; the join service on the domain's server publishes it".to_owned();
    status.look(Instant::now(), node.switch().is_ok(), waits_for, detail);
}

fn take(body: &[u8], domain: Name, own: Name, file: &Path, members: &watch::Sender<Members>) {
    let now = unix_seconds();
    let read = || -> Result<_, DirectoryError> {
        let directory = Directory::from_bytes(body)?;
        // Each member has signatures to verify.
        Ok((directory.members(domain, own, now), directory.membership_of(own, domain, now).cloned()))
    };
    match run_blocking_if_large(body.len(), read) {
        Ok((read, membership)) => {
            if let Some(membership) = membership
                && let Err(error) = store_newer(&membership, file)
            {
                tracing::error!("the renewed membership is not stored: {error:#}");
            }
            members.send_if_modified(|known| {
                let is_new = **known != *read;
                if is_new {
                    *known = read.into();
                }
                is_new
            });
        }
        Err(error) => tracing::warn!("the directory of the domain is not taken: {error}"),
    }
}

/// Replaces the membership in `file`, whose watcher then shows it to the switch, by a newer one.
fn store_newer(membership: &Membership, file: &Path) -> anyhow::Result<()> {
    let age = |membership: &Membership| -> Result<_, CertError> {
        Ok((membership.serial_unverified()?, membership.until_unverified()?))
    };
    let known = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let known = Membership::from_pem(&known).with_context(|| file.display().to_string())?;
    // Only the domain itself replaces the first membership. Its service may renew it.
    let is_same = membership.serial_unverified()? == known.serial_unverified()?;
    let role = |membership: &Membership| membership.cert.claims_unverified().map(|claims| claims.role);
    let is_exchange = membership.invite.is_none() && role(membership)? == role(&known)?;
    if (is_same || is_exchange) && age(membership)? > age(&known)? {
        secret_file::replace(file, membership.to_pem().as_bytes())?;
        tracing::info!("the membership is renewed, {}", relative(membership.until_unverified()?, unix_seconds()));
    }
    Ok(())
}

/// Returns what the members share with the proxy `own`, and it with them.
pub fn shared(members: &[Member], own: Name, graph: Option<&str>) -> SharedByDirectory {
    let mut shared = SharedByDirectory::default();
    let Some(me) = members.iter().find(|member| member.entity == own) else { return shared };
    for other in members.iter().filter(|member| member.entity != own) {
        let names = PatternsByKind::of(me.readable_by(&other.enrollment));
        if !names.is_empty() {
            shared.exposed.exports.extend(me.imported_by(&other.enrollment).map(|(here, _)| here));
            shared.exposed.readers.push(MemberReader { entity: other.entity, names });
        }
        shared.imports.extend(import(me, other, graph));
    }
    shared
}

/// Returns the import of what `me` may read of `other`.
fn import(me: &Member, other: &Member, graph: Option<&str>) -> Option<(ImportConfig, ImportMaterial)> {
    let (catalog, grant) = (other.catalog.clone()?, Reading::from(other.grant.clone()?));
    let label = &other.enrollment.label;
    let wanted = PatternsByKind::of(other.readable_by(&me.enrollment));
    if wanted.is_empty() {
        return None;
    }
    let imported: Vec<_> = other.imported_by(&me.enrollment).collect();
    let remap = |(there, here): &(String, &str)| {
        let (from, to) = (literal(there)?, literal(here)?);
        Some(Remap { from, to })
    };
    let PatternsByKind { topics, services, actions } = wanted;
    let config = ImportConfig {
        graph: graph.map(str::to_owned),
        topics,
        services,
        actions,
        shared: Some(SharedImport {
            within: PatternsByKind::of(&other.enrollment.expose),
            under_own_names: PatternsByKind::of(imported.iter().map(|(there, _)| there)),
        }),
        remap: imported.iter().filter_map(remap).collect(),
        prefix: TopicName::parse(&format!("/{label}")).ok(),
        ..ImportConfig::default()
    };
    let permission = Permission::Read(grant.clone());
    let file = Renewal::Notified(Notified::new(watch::channel(permission).1));
    Some((config, ImportMaterial { catalog, grant, file }))
}

/// Returns the part of a pattern before its first segment with a wildcard.
fn literal(pattern: &str) -> Option<TopicName> {
    let segments = pattern.split('/').skip(1).take_while(|segment| !segment.contains('*'));
    let text: String = segments.map(|segment| format!("/{segment}")).collect();
    TopicName::parse(&text).ok()
}

#[cfg(test)]
#[path = "../tests/unit/directory.rs"]
mod tests;
