//! Follows the directory of the trust domain. What its members share with this proxy, or it with
//! them, is then exposed and imported without a section of its own in the configuration.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use gdp::{Node, NodeError, SubscribeOptions};
use gdp_core::cert::Reading;
use gdp_directory::DIRECTORY;
use gdp_directory::directory::{Directory, Member};
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;
use tokio::sync::watch;

use crate::config::{ImportConfig, MemberReader, Pattern, Remap, SharedTopics};
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
    let (Some(DirectoryMaterial { card, domain, grant, file }), Some(status)) = (material, status) else {
        return std::future::pending().await;
    };
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
                                take(&message.body, domain, node.name(), members);
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
    material.map(|of| RouteStatus::new("directory".into(), of.card.name(), None))
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

fn take(body: &[u8], domain: Name, own: Name, members: &watch::Sender<Members>) {
    // Each member has signatures to verify.
    let read = || Ok(Directory::from_bytes(body)?.members(domain, own, unix_seconds()));
    let read: Result<Vec<Member>, gdp_directory::directory::DirectoryError> = run_blocking_if_large(body.len(), read);
    match read {
        Ok(read) => {
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

/// Returns what the members share with the proxy `own`, and it with them.
pub fn shared(members: &[Member], own: Name, graph: Option<&str>) -> SharedByDirectory {
    let mut shared = SharedByDirectory::default();
    let Some(me) = members.iter().find(|member| member.entity == own) else { return shared };
    for other in members.iter().filter(|member| member.entity != own) {
        let topics = patterns(me.readable_by(&other.enrollment));
        if !topics.is_empty() {
            shared.exposed.exports.extend(patterns(me.imported_by(&other.enrollment).map(|(here, _)| here)));
            shared.exposed.readers.push(MemberReader { entity: other.entity, topics });
        }
        shared.imports.extend(import(me, other, graph));
    }
    shared
}

/// Returns the import of what `me` may read of `other`.
fn import(me: &Member, other: &Member, graph: Option<&str>) -> Option<(ImportConfig, ImportMaterial)> {
    let (catalog, grant) = (other.catalog.clone()?, Reading::from(other.grant.clone()?));
    let label = &other.enrollment.label;
    let topics = patterns(other.readable_by(&me.enrollment));
    if topics.is_empty() {
        return None;
    }
    let imported: Vec<_> = other.imported_by(&me.enrollment).collect();
    let remap = |(there, here): &(String, &str)| {
        let (from, to) = (literal(there)?, literal(here)?);
        Some(Remap { from, to })
    };
    let config = ImportConfig {
        graph: graph.map(str::to_owned),
        topics,
        within: Some(patterns(&other.enrollment.expose)),
        remap: imported.iter().filter_map(remap).collect(),
        merge: patterns(imported.iter().map(|(there, _)| there)),
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

/// Returns the texts that are patterns, each once.
fn patterns(texts: impl IntoIterator<Item = impl AsRef<str>>) -> Vec<Pattern> {
    let mut seen = BTreeSet::new();
    let texts = texts.into_iter().filter(|text| seen.insert(text.as_ref().to_owned()));
    texts.filter_map(|text| Pattern::parse(text.as_ref()).ok()).collect()
}

#[cfg(test)]
#[path = "../tests/unit/directory.rs"]
mod tests;
