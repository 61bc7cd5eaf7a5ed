//! `gdp-ctl join-service`: serves the domain's join service and publishes its directory. The rules
//! are in `gdp-directory`.

use std::time::Duration;

use anyhow::{Context as _, bail};
use clap::Args;
use gdp::{Call, LinkConfig, Node, NodeConfig, Overflow, PublishOptions, Publisher, Reliability};
use gdp_core::cert::{AdCert, Membership, Revocation};
use gdp_core::domain::Credentials;
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::secret_file;
use gdp_directory::directory::MAX_DIRECTORY;
use gdp_directory::messages::{JoinReply, JoinRequest};
use gdp_directory::service::{Delegations, JoinService};
use gdp_directory::{DIRECTORY, JOIN, directory_card, join_card};
use gdp_util::file_watch::{FileSet, FileWatcher};
use gdp_util::unix_time::unix_nanos;
use tokio::signal::unix::{SignalKind, signal};

use super::{Home, HomeOptions, enrollments};
use crate::cli::issuance_log::newest_revocation;

/// How often the directory is made again, because certificates expire and are renewed.
const AGAIN: Duration = Duration::from_secs(600);

/// Versions of the directory that readers may request again.
const HISTORY: usize = 4;

/// Pause between attempts to reach the switch.
const RETRY: Duration = Duration::from_secs(1);

#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    home: HomeOptions,
}

/// The service with its files.
struct JoinServer {
    home: Home,
    service: JoinService,
    publisher: Publisher,
    /// The directory that was published last.
    published: Vec<u8>,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let _log = gdp_util::log::start();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        let mut terminate = signal(SignalKind::terminate()).context("cannot wait for SIGTERM")?;
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot wait for SIGINT")?;
        tokio::select! {
            ended = serve(home) => ended,
            _ = terminate.recv() => Ok(()),
            _ = interrupt.recv() => Ok(()),
        }
    })
}

/// Returns the join service with the members that have joined.
pub(super) fn stored(home: &Home) -> anyhow::Result<JoinService> {
    let domain = home.card()?;
    let delegations =
        Delegations { directory: home.signed("directory.delegation")?, join: home.signed("join.delegation")? };
    let mut service = JoinService::new(SigningKey::load(&home.path("join.pem"))?, domain.name(), delegations);
    let members = home.path("directory.members");
    match secret_file::read(&members, MAX_DIRECTORY) {
        Ok(bytes) => service.restore(&bytes).with_context(|| members.display().to_string())?,
        Err(error) if error.is_not_found() => {}
        Err(error) => return Err(error.into()),
    }
    update(home, &mut service)?;
    Ok(service)
}

/// Applies what the domain's key has signed since: revocations and enrollments. Returns true if the
/// directory changes.
fn update(home: &Home, service: &mut JoinService) -> anyhow::Result<bool> {
    let revoked = revocation(home)?.is_some_and(|revocation| service.revoke(revocation));
    let mut enrolled = false;
    for enrollment in home.signed_enrollments()? {
        enrolled |= service.enroll(enrollment);
    }
    Ok(revoked || enrolled)
}

/// Returns the newest revocation of the domain, which lies beside its card.
fn revocation(home: &Home) -> anyhow::Result<Option<Revocation>> {
    Ok(newest_revocation(&home.card()?, &home.revocation_path())?.map(|(_, claims)| claims))
}

async fn serve(home: Home) -> anyhow::Result<()> {
    let watcher = FileWatcher::start();
    let revoked = home.revocation_path();
    // Created before the file is read, so that no change is missed.
    let mut changed = FileSet::new(&watcher, [revoked.as_path(), &home.path(enrollments::FILE)]);
    let service = stored(&home)?;
    let domain = *home.card()?.owner_key();
    let node = connect(&home).await?;
    let cert = |name: &str| anyhow::Ok(home.signed::<AdCert>(name)?.into());
    let publisher = node.publish(directory_card(domain)?.proof(), cert("directory.cert")?, options()).await?;
    let mut server = node.serve(join_card(domain)?.proof(), cert("join.cert")?).await?;
    let mut running = JoinServer { home, service, publisher, published: Vec::new() };
    running.publish()?;
    tracing::info!("the join service is ready");
    let mut again = tokio::time::interval(AGAIN);
    loop {
        tokio::select! {
            call = server.recv() => match call {
                Some(call) => running.answer(call).await?,
                None => bail!("the right to serve has ended: {}; run `gdp-ctl up` again", server.ended().await),
            },
            () = changed.changed() => {
                if update(&running.home, &mut running.service)? {
                    running.store()?;
                    running.publish()?;
                }
            }
            _ = again.tick() => running.publish()?,
        }
    }
}

impl JoinServer {
    /// Answers a call. A new member is stored and published before it knows.
    async fn answer(&mut self, call: Call) -> anyhow::Result<()> {
        let caller = call.client();
        let reply = match JoinRequest::from_bytes(call.body()) {
            Ok(request) => self.service.answer(caller, request, unix_nanos()),
            Err(error) => JoinReply::Refused(format!("the request cannot be read: {error}")),
        };
        match &reply {
            JoinReply::Refused(reason) => tracing::warn!(%caller, "refused to join: {reason}"),
            JoinReply::Joined { .. } | JoinReply::Left => {
                tracing::info!(%caller, "{}", if reply == JoinReply::Left { "left" } else { "joined" });
                self.store()?;
                self.publish()?;
            }
        }
        if let Err(error) = call.reply(JOIN, &reply.to_bytes()?).await {
            tracing::warn!(%caller, "the caller is gone: {error}");
        }
        Ok(())
    }

    fn store(&self) -> anyhow::Result<()> {
        Ok(secret_file::replace(&self.home.path("directory.members"), &self.service.to_bytes()?)?)
    }

    fn publish(&mut self) -> anyhow::Result<()> {
        let directory = self.service.directory(unix_nanos())?.to_bytes()?;
        if directory != self.published {
            self.publisher.pin(DIRECTORY, &directory);
            self.published = directory;
        }
        Ok(())
    }
}

async fn connect(home: &Home) -> anyhow::Result<Node> {
    let address = home.address()?;
    let identity = Identity::new(SigningKey::load(&home.path("join.pem"))?, "tool");
    let membership = std::fs::read_to_string(home.path("join.member")).context("join.member")?;
    let credentials = Some(Credentials { membership: Membership::from_pem(&membership)?, peers: Vec::new() });
    let target: gdp_core::link_target::LinkTarget = format!("udp://127.0.0.1:{}", address.port).parse()?;
    let links = vec![LinkConfig { target: target.clone(), switch: Some(address.switch), budget: None }];
    let config = NodeConfig { links, credentials, ..NodeConfig::new(identity, target) };
    loop {
        match Node::connect(config.clone()).await {
            Ok(node) => return Ok(node),
            Err(error) if error.may_pass() => tracing::warn!("no switch yet: {error}"),
            Err(error) => return Err(error.into()),
        }
        tokio::time::sleep(RETRY).await;
    }
}

/// Reliable delivery of the newest versions.
fn options() -> PublishOptions {
    let reliability = Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: HISTORY } };
    PublishOptions { reliability, history: HISTORY, class: 5, ..PublishOptions::reliable() }
}
