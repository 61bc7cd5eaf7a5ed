//! Publishes and subscribes to bytes by name, without ROS. Requires a running switch: `gdp-ctl
//! serve` (without root).
//!
//! ```text
//! cargo run -p gdp --example pubsub                               both ends in one process
//! cargo run -p gdp --example pubsub -- --dir /tmp/papers --subscribe    one end each, in this order,
//! cargo run -p gdp --example pubsub -- --dir /tmp/papers --publish      with the keys and certificates in a folder
//! ```

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use clap::Parser;
use gdp::{Node, NodeConfig, PublishOptions, SubscribeOptions};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, Issued, ReadGrant, Reading, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_e2e::seal::Encoding;

#[derive(Parser)]
#[command(about = "Publish and subscribe bytes by name")]
struct Options {
    /// Where the switch is: udp://HOST:PORT, or eth://INTERFACE as root.
    #[arg(long, default_value = "udp://127.0.0.1:31415")]
    link: gdp_core::link_target::LinkTarget,
    /// Folder of keys and certificates, made if it is not there; without it, all are made anew and
    /// forgotten.
    #[arg(long)]
    dir: Option<PathBuf>,
    /// Only publish.
    #[arg(long, requires = "dir", conflicts_with = "subscribe")]
    publish: bool,
    /// Only subscribe.
    #[arg(long, requires = "dir")]
    subscribe: bool,
    #[arg(long, default_value_t = 10)]
    count: u64,
}

#[tokio::main]
async fn main() -> Result<()> {
    let level = tracing_subscriber::EnvFilter::from_default_env();
    tracing_subscriber::fmt().with_env_filter(level).with_writer(std::io::stderr).init();
    let options = Options::parse();
    let scratch = tempfile::tempdir()?;
    let papers = Credentials::in_folder(options.dir.as_deref().unwrap_or(scratch.path()))?;
    println!("name {}", papers.card.name());
    match (options.publish, options.subscribe) {
        (true, _) => publish(&options, &papers).await,
        (_, true) => subscribe(&options, &papers, None).await,
        _ => {
            let (ready, subscribed) = tokio::sync::oneshot::channel();
            let publisher = async { if subscribed.await.is_ok() { publish(&options, &papers).await } else { Ok(()) } };
            let (received, sent) = tokio::join!(subscribe(&options, &papers, Some(ready)), publisher);
            received.and(sent)
        }
    }
}

async fn publish(options: &Options, papers: &Credentials) -> Result<()> {
    let node = Node::connect(NodeConfig::new(papers.robot.clone(), options.link.clone())).await?;
    let mut publisher = node.publish(papers.card.proof(), papers.ad_cert()?, PublishOptions::reliable()).await?;
    for i in 1..=options.count {
        let text = format!("message {i} of {}", options.count);
        publisher.send(Encoding::Bytes, text.as_bytes()).await?;
        println!("sent      {text}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    // Waits until the reader has received all messages.
    publisher.close(Duration::from_secs(5)).await?;
    node.close().await;
    Ok(())
}

async fn subscribe(
    options: &Options,
    papers: &Credentials,
    ready: Option<tokio::sync::oneshot::Sender<()>>,
) -> Result<()> {
    let node = Node::connect(NodeConfig::new(papers.cloud.clone(), options.link.clone())).await?;
    let mut subscription = node.subscribe(papers.card.proof(), papers.grant()?, SubscribeOptions::reliable()).await?;
    ready.map(|ready| ready.send(()));
    // A publisher that joins later is authorised by its certificate. This subscriber needs no
    // configuration for it.
    for received in 0..options.count {
        let waiting = tokio::time::timeout(Duration::from_secs(60), subscription.recv());
        let Ok(Some(message)) = waiting.await else {
            bail!("{received} of {} messages in time; {:?}", options.count, node.counters());
        };
        let age = SystemTime::UNIX_EPOCH.elapsed()?.saturating_sub(Duration::from_nanos(message.timestamp_ns));
        println!("received  {} from {:#}, {age:?} old", String::from_utf8_lossy(&message.body), message.writer);
    }
    println!("{:?}", node.counters());
    node.close().await;
    Ok(())
}

/// The certificates that the owner of a topic issues, and their holders. In a deployment, the
/// owner's key would not be on the robot.
struct Credentials {
    owner: SigningKey,
    card: NameCard,
    robot: Identity,
    cloud: Identity,
}

impl Credentials {
    fn in_folder(dir: &Path) -> Result<Self> {
        std::fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
        let owner = SigningKey::load_or_generate(&dir.join("owner.pem"))?;
        let card = dir.join("greeting.card");
        if !card.exists() {
            NameCard::create(owner.verify_key(), "topic", "/greeting", "bytes", None)?.save_new(&card)?;
        }
        Ok(Self {
            card: NameCard::load(&card)?,
            robot: Identity::load_or_generate(&dir.join("robot.pem"), "proxy")?,
            cloud: Identity::load_or_generate(&dir.join("cloud.pem"), "proxy")?,
            owner,
        })
    }

    fn ad_cert(&self) -> Result<Issued<AdCert>> {
        let (serial, not_before, not_after) = today()?;
        let (name, entity, scope) = (self.card.name(), self.robot.name(), vec![]);
        Ok(issue(&self.owner, &AdCert { name, entity, scope, serial, not_before, not_after })?.into())
    }

    fn grant(&self) -> Result<Reading> {
        let (serial, not_before, not_after) = today()?;
        let (name, to) = (self.card.name(), Grantee::Entity(self.cloud.name()));
        Ok(issue(&self.owner, &ReadGrant { name, to, serial, not_before, not_after })?.into())
    }
}

/// Returns a certificate's serial in Unix nanoseconds, and its validity in Unix seconds: from an
/// hour ago to tomorrow.
fn today() -> Result<(u64, u64, u64)> {
    let now = SystemTime::UNIX_EPOCH.elapsed()?;
    Ok((u64::try_from(now.as_nanos())?, now.as_secs() - 3600, now.as_secs() + 24 * 3600))
}
