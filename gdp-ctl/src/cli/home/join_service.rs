//! `gdp-ctl join-service`: serves the domain's join service, publishes its directory, and renews
//! memberships. The rules are in `gdp-directory`.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp::unstable::{Call, LinkConfig, Node, NodeConfig, Overflow, PublishOptions, Publisher, Reliability};
use gdp_core::card::NameCard;
use gdp_core::cbor;
use gdp_core::cert::{AdCert, Issued, issue};
use gdp_core::domain::{CredentialFiles, Credentials};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::secret_file;
use gdp_directory::messages::{JoinReply, JoinRequest};
use gdp_directory::service::JoinService;
use gdp_directory::{DIRECTORY, JOIN, directory_card, join_card};
use gdp_util::file_watch::{FileSet, FileWatcher};
use gdp_util::service_manager::ServiceManager;
use gdp_util::signals;
use gdp_util::unix_time::unix_nanos;
use gdp_wire::Name;

use super::join_metrics::JoinMetrics;
use super::{Home, HomeOptions, files, members, renewals};
use crate::cli::issuing::validity;

/// How often the directory is made again, because certificates expire.
const AGAIN: Duration = Duration::from_secs(600);

/// How often memberships are looked at: ten times in their lifetime, and at least this often. A
/// clock that was set back makes them be renewed again.
const LOOK: Duration = Duration::from_secs(5);

/// Versions of the directory that readers may request again.
const HISTORY: usize = 4;

/// Pause between attempts to reach the switch.
const RETRY: Duration = Duration::from_secs(1);

#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    home: HomeOptions,
    /// Address and port of metrics in OpenMetrics, or a port alone for loopback
    #[arg(long, value_name = "ADDRESS:PORT", env = "GDP_JOIN_METRICS", value_parser = gdp_http::parse_address)]
    metrics: Option<SocketAddr>,
    /// File of the token that a scrape needs. Without it, metrics are on loopback only
    #[arg(long, value_name = "FILE", env = "GDP_JOIN_METRICS_TOKEN", requires = "metrics")]
    metrics_token: Option<PathBuf>,
}

/// The service with its files.
struct JoinServer {
    home: Home,
    service: JoinService,
    publisher: Publisher,
    /// The directory that was published last.
    published: Vec<u8>,
    metrics: JoinMetrics,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let _log = gdp_util::log::start();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        let stop = signals::stop().context("cannot wait for SIGTERM and SIGINT")?;
        let mut manager = ServiceManager::from_environment();
        let metrics = JoinMetrics::default();
        if let Some(address) = options.metrics {
            let listener = gdp_http::metrics::listen(address, options.metrics_token.as_deref()).context("metrics")?;
            tracing::info!("metrics on http://{}{}", listener.address(), gdp_http::metrics::PATH);
            tokio::spawn(metrics.clone().serve(listener));
        }
        manager.status("waiting for the switch");
        let ended = tokio::select! {
            ended = serve(home, metrics, &mut manager) => ended,
            () = stop => Ok(()),
        };
        manager.stopping();
        ended
    })
}

async fn serve(home: Home, metrics: JoinMetrics, manager: &mut ServiceManager) -> anyhow::Result<()> {
    let watcher = FileWatcher::start();
    let files = [files::ENROLLMENTS, files::RENEWALS, files::MEMBERSHIPS, files::DECISIONS];
    let signed: Vec<PathBuf> = files.map(|file| home.path(file)).into_iter().chain([home.revocation_path()]).collect();
    // Created before the file is read, so that no change is missed.
    let mut changed = FileSet::new(&watcher, signed.iter().map(PathBuf::as_path));
    let service = members::stored(&home)?;
    home.renew_all_own();
    let key = SigningKey::load(&home.path("join.pem"))?;
    let (card, membership) = (home.path("domain.card"), home.member_file(renewals::JOIN));
    let credentials = CredentialFiles { card, membership, peers: Vec::new() };
    let watched = FileSet::new(&watcher, credentials.paths());
    let node = connect(&home, &key, credentials.load()?, manager).await?;
    let mut keeping = std::pin::pin!(node.follow_credentials(&credentials, watched));
    let (directory, join) = (directory_card(key.verify_key())?, join_card(key.verify_key())?);
    let publisher = node.publish(directory.proof(), own_right(&key, &directory, node.name())?, options()).await?;
    let mut server = node.serve(join.proof(), own_right(&key, &join, node.name())?).await?;
    let look = LOOK.min(Duration::from_secs((home.address()?.lifetime / 10).max(1)));
    let mut running = JoinServer { home, service, publisher, published: Vec::new(), metrics };
    running.publish();
    tracing::info!("the join service is ready");
    manager.ready("answers members");
    let (mut again, mut looks) = (tokio::time::interval(AGAIN), tokio::time::interval(look));
    loop {
        tokio::select! {
            call = server.recv() => match call {
                Some(call) => running.answer(call).await?,
                None => bail!("the right to serve has ended: {}; run `gdp-ctl up` again", server.ended().await),
            },
            never = &mut keeping => match never {},
            () = changed.changed() => {
                if members::update(&running.home, &mut running.service)? {
                    running.store()?;
                    running.publish();
                }
            }
            _ = again.tick() => running.publish(),
            _ = looks.tick() => {
                running.renew();
                manager.alive(Instant::now());
            }
        }
    }
}

impl JoinServer {
    /// Answers a call. A new member is stored and published before it knows.
    async fn answer(&mut self, call: Call) -> anyhow::Result<()> {
        let caller = call.client();
        let before = self.service.applications().get(&caller).cloned();
        let mut reply = match JoinRequest::from_bytes(call.body()) {
            Ok(request) => self.service.answer(caller, request, unix_nanos()),
            Err(error) => JoinReply::Refused(format!("the request cannot be read: {error}")),
        };
        let is_change = match &reply {
            JoinReply::Pending => self.service.applications().get(&caller) != before.as_ref(),
            JoinReply::Joined { .. } | JoinReply::Left => true,
            JoinReply::Approved(_) | JoinReply::Refused(_) => false,
        };
        if let JoinReply::Refused(reason) = &reply {
            tracing::warn!(%caller, "refused to join: {reason}");
        }
        if is_change {
            let what = match &reply {
                JoinReply::Pending => "asks to join; see `gdp-ctl robots`",
                JoinReply::Left => "left",
                _ => "joined",
            };
            tracing::info!(%caller, "{what}");
            if let Err(error) = self.store() {
                tracing::error!(%caller, "cannot be stored: {error:#}");
                reply = JoinReply::Refused("the join service cannot store it; its log says why".into());
            }
            self.publish();
        }
        self.metrics.replied(&reply);
        if let Err(error) = call.reply(JOIN, &reply.to_bytes()?).await {
            tracing::warn!(%caller, "the caller is gone: {error}");
        }
        Ok(())
    }

    /// Renews the memberships of which half has passed.
    fn renew(&mut self) {
        self.home.renew_all_own();
        if self.service.renew_due(unix_nanos()) {
            if let Err(error) = self.store() {
                tracing::error!("the renewed memberships are not stored: {error:#}");
            }
            self.publish();
        }
    }

    fn store(&self) -> anyhow::Result<()> {
        let waiting: Vec<_> = self.service.applications().iter().collect();
        let store = || -> anyhow::Result<()> {
            secret_file::replace(&self.home.path(files::APPLICATIONS), &cbor::encode(&waiting)?)?;
            Ok(secret_file::replace(&self.home.path("directory.members"), &self.service.to_bytes()?)?)
        };
        store().inspect_err(|_| self.metrics.write_failed())
    }

    fn publish(&mut self) {
        let directory = self.service.directory(unix_nanos());
        self.metrics.update(&directory, self.service.applications().len());
        match directory.to_bytes() {
            Ok(directory) if directory != self.published => {
                self.publisher.pin(DIRECTORY, &directory);
                self.published = directory;
            }
            Ok(_) => {}
            Err(error) => tracing::error!("the directory stays as it was: {error}"),
        }
    }
}

/// Returns the right of the join service to publish or serve a name of its own.
fn own_right(key: &SigningKey, card: &NameCard, entity: Name) -> anyhow::Result<Issued<AdCert>> {
    let (serial, (not_before, not_after)) = (unix_nanos(), validity(renewals::RENEWABLE));
    Ok(issue(key, &AdCert { name: card.name(), entity, scope: vec![], serial, not_before, not_after })?.into())
}

/// Connects to the switch, which may start later.
async fn connect(
    home: &Home,
    key: &SigningKey,
    credentials: Credentials,
    manager: &mut ServiceManager,
) -> anyhow::Result<Node> {
    let address = home.address()?;
    let identity = Identity::new(key.clone(), "tool");
    let target = address.local();
    let links = vec![LinkConfig { target: target.clone(), switch: Some(address.switch), budget: None }];
    let config = NodeConfig { links, credentials: Some(credentials), ..NodeConfig::new(identity, target) };
    loop {
        match Node::connect(config.clone()).await {
            Ok(node) => return Ok(node),
            Err(error) if error.may_pass() => {
                tracing::warn!("no switch yet: {error}");
                // A restart would not help, and whoever starts the service need not wait.
                manager.ready("no switch answers yet; trying on");
                manager.alive(Instant::now());
            }
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
