//! Numbered messages from a robot to a cloud between SDK nodes: which arrive, how often, and in
//! which order.
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Result, ensure};
use gdp::unstable::{Node, NodeConfig, PublishOptions, SubscribeOptions};
use gdp_core::card::NameCard;
use gdp_core::cert::{Issued, Reading};
use gdp_core::identity::{Identity, SigningKey};
use gdp_e2e::seal::Encoding;
use gdp_tests::netns::Namespace;
use gdp_tests::wait::{TIMEOUT, wait_for};
use tokio::time::MissedTickBehavior;

use crate::patient::patient;

/// Interval between two messages.
const PACE: Duration = Duration::from_millis(1);

/// Numbered messages from the robot to the cloud.
pub struct Traffic {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    stop_sending: AtomicBool,
    stop: AtomicBool,
    sent: AtomicU64,
    /// Messages that could not be sent, with their errors.
    unsent: Mutex<Vec<String>>,
    received: Mutex<Vec<u64>>,
    /// Segments that arrived more than once, or too late.
    duplicates: AtomicU64,
    nodes: Mutex<[Option<Node>; 2]>,
    failure: Mutex<Option<String>>,
}

impl Traffic {
    /// Starts the traffic. The first folder has the key, card and certificate of the sending node,
    /// on interface `r0`. The second has those of the receiving node, on `l0`.
    pub fn start(robot: (&Namespace, PathBuf), cloud: (&Namespace, PathBuf)) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let mut traffic = Self { shared, threads: Vec::new() };
        traffic.spawn(cloud.0, cloud.1, |shared, folder| async move {
            let node = connect(&folder.join("key.pem"), "l0").await?;
            let card = NameCard::load(&folder.join("chatter.card"))?;
            let grant = Reading::from_pem(&std::fs::read_to_string(folder.join("chatter.cert"))?)?;
            let options = SubscribeOptions { queue: 1 << 16, ..patient().1 };
            let mut subscription = node.subscribe(card.proof(), grant, options).await?;
            shared.nodes()[1] = Some(node);
            while !shared.stop.load(Ordering::Relaxed) {
                if let Ok(Some(message)) = tokio::time::timeout(Duration::from_millis(50), subscription.recv()).await {
                    let number = u64::from_be_bytes(message.body[..].try_into()?);
                    shared.received.lock().expect("no panic").push(number);
                }
                shared.duplicates.store(subscription.counters().inbound.duplicates, Ordering::Relaxed);
            }
            Ok(())
        })?;
        wait_for("the subscription", TIMEOUT, || {
            traffic.check()?;
            Ok(traffic.shared.nodes()[1].is_some().then_some(()))
        })?;
        traffic.spawn(robot.0, robot.1, |shared, folder| async move {
            let node = connect(&folder.join("key.pem"), "r0").await?;
            let card = NameCard::load(&folder.join("chatter.card"))?;
            let cert = Issued::from_pem(&std::fs::read_to_string(folder.join("chatter.cert"))?)?;
            // No message gives way to newer ones.
            let options = PublishOptions { history: 1 << 16, ..patient().0 };
            let mut publisher = node.publish(card.proof(), cert, options).await?;
            shared.nodes()[0] = Some(node);
            let mut pace = tokio::time::interval(PACE);
            pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
            while !shared.stop_sending.load(Ordering::Relaxed) {
                pace.tick().await;
                let number = shared.sent.load(Ordering::Relaxed);
                match publisher.send(Encoding::Bytes, &number.to_be_bytes()).await {
                    Ok(_) => drop(shared.sent.fetch_add(1, Ordering::Relaxed)),
                    Err(error) => shared.unsent.lock().expect("no panic").push(error.to_string()),
                }
            }
            while !shared.stop.load(Ordering::Relaxed) {
                pace.tick().await;
            }
            Ok(())
        })?;
        Ok(traffic)
    }

    /// Runs a node on its own runtime in a namespace: namespaces belong to threads.
    fn spawn<F: Future<Output = Result<()>>>(
        &mut self,
        at: &Namespace,
        folder: PathBuf,
        run: impl FnOnce(Arc<Shared>, PathBuf) -> F + Send + 'static,
    ) -> Result<()> {
        let (shared, door) = (self.shared.clone(), at.door()?);
        self.threads.push(std::thread::spawn(move || {
            let ended = door.enter().and_then(|_inside| {
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
                runtime.block_on(run(shared.clone(), folder))
            });
            if let Err(error) = ended {
                *shared.failure.lock().expect("no panic") = Some(format!("{error:#}"));
            }
        }));
        Ok(())
    }

    pub fn wait_for_more(&self, more: usize, limit: Duration) -> Result<()> {
        self.wait_for_total((self.received() + more) as u64, limit)
    }

    pub fn wait_for_total(&self, total: u64, limit: Duration) -> Result<()> {
        wait_for(&format!("message {total}"), limit, || {
            self.check()?;
            Ok((self.received() as u64 >= total).then_some(()))
        })
    }

    pub fn received(&self) -> usize {
        self.shared.received.lock().expect("no panic").len()
    }

    /// Stops sending, and returns the number of messages sent.
    pub fn stop_sending(&self) -> u64 {
        self.shared.stop_sending.store(true, Ordering::Relaxed);
        // One message may be in progress; it is counted once it is sent, and no other follows.
        let mut before = u64::MAX;
        let settled = wait_for("the last message", TIMEOUT, || {
            let sent = self.shared.sent.load(Ordering::Relaxed);
            Ok((std::mem::replace(&mut before, sent) == sent).then_some(sent))
        });
        settled.expect("it ends")
    }

    /// Returns the number of links that both nodes have made so far.
    pub fn links_made(&self) -> u64 {
        self.shared.nodes().iter().flatten().map(|node| node.counters().links).sum()
    }

    /// Returns the number of nodes without a link.
    pub fn links_down(&self) -> usize {
        self.shared.nodes().iter().flatten().filter(|node| node.switch().is_err()).count()
    }

    pub fn nothing_is_missing(&self) -> Result<()> {
        let unsent = self.shared.unsent.lock().expect("no panic");
        ensure!(unsent.is_empty(), "{} messages could not be sent: {:?}", unsent.len(), unsent.first());
        let received = self.shared.received.lock().expect("no panic");
        let gap = received.iter().enumerate().find(|(i, number)| *i as u64 != **number);
        ensure!(gap.is_none(), "not each once and in order: place {gap:?} of {}", received.len());
        Ok(())
    }

    /// Checks that no message arrived twice or out of order, and returns the number of missing
    /// messages. A segment that another path delayed beyond a later message also counts as surplus,
    /// like a duplicate. In that case its message is missing.
    pub fn nothing_came_twice(&self) -> Result<usize> {
        let received = self.shared.received.lock().expect("no panic");
        ensure!(received.is_sorted_by(|a, b| a < b), "messages came twice, or out of order");
        let missing = received.last().map_or(0, |last| *last as usize + 1) - received.len();
        let duplicates = self.shared.duplicates.load(Ordering::Relaxed);
        ensure!(duplicates <= missing as u64, "{duplicates} segments too many, and {missing} messages missing");
        Ok(missing)
    }

    pub fn summary(&self) -> String {
        let counters: Vec<_> = self.shared.nodes().iter().flatten().map(Node::counters).collect();
        format!("sent {}, received {}: {counters:?}", self.shared.sent.load(Ordering::Relaxed), self.received())
    }

    fn check(&self) -> Result<()> {
        match &*self.shared.failure.lock().expect("no panic") {
            Some(failure) => anyhow::bail!("a node failed: {failure}"),
            None => Ok(()),
        }
    }
}

impl Shared {
    fn nodes(&self) -> std::sync::MutexGuard<'_, [Option<Node>; 2]> {
        self.nodes.lock().expect("no panic")
    }
}

impl Drop for Traffic {
    fn drop(&mut self) {
        self.shared.stop_sending.store(true, Ordering::Relaxed);
        self.shared.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

async fn connect(key: &Path, interface: &str) -> Result<Node> {
    let identity = Identity::new(SigningKey::load(key)?, "proxy");
    Ok(Node::connect(NodeConfig::new(identity, format!("eth://{interface}").parse()?)).await?)
}
