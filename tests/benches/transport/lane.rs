//! A flow of messages of one size, and what became of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use parking_lot::Mutex;

/// What is sent.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Of a message; room for its time at least.
    pub bytes: usize,
    /// From one message to the next; `None`: as soon as the one before is taken.
    pub every: Option<Duration>,
}

/// One flow. Both ends are in this process, so they share it.
pub struct Lane {
    load: Load,
    began: Instant,
    sent: AtomicU64,
    received: Mutex<Received>,
    /// Of messages at a fixed rate: nanoseconds from when each was due to when it was there.
    latencies: Mutex<Vec<u64>>,
    stopped: AtomicBool,
    failure: Mutex<Option<anyhow::Error>>,
}

/// Messages so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Received {
    pub count: u64,
    /// When the last one was there, in nanoseconds.
    pub last: u64,
}

/// The sending end of a contender.
pub trait Sender: Send {
    /// Returns as soon as the next message may come.
    fn send(&mut self, body: &[u8]) -> impl Future<Output = Result<()>> + Send;
}

/// Bytes of a message's time, at its beginning.
const STAMP: usize = size_of::<u64>();

/// Small messages between two turns for other tasks.
const TURN: u64 = 32;

impl Lane {
    pub fn new(load: Load) -> Arc<Self> {
        assert!(load.bytes >= STAMP, "{load:?}");
        Arc::new(Self {
            load,
            began: Instant::now(),
            sent: AtomicU64::new(0),
            received: Mutex::default(),
            latencies: Mutex::default(),
            stopped: AtomicBool::new(false),
            failure: Mutex::default(),
        })
    }

    /// Bytes of every message.
    pub fn bytes(&self) -> usize {
        self.load.bytes
    }

    /// Sends until the lane is stopped, and then keeps the sender: what it has taken may still be
    /// under way.
    pub async fn feed(self: Arc<Self>, mut sender: impl Sender) {
        let fed = self.try_feed(&mut sender).await;
        self.note(fed);
        std::future::pending().await
    }

    /// A message is there. Others than the lane's are none of its.
    pub fn arrived(&self, body: &[u8]) {
        if body.len() != self.load.bytes {
            return;
        }
        let now = self.now();
        if let Some(stamp) = body.first_chunk::<STAMP>().filter(|_| self.load.every.is_some()) {
            self.latencies.lock().push(now.saturating_sub(u64::from_be_bytes(*stamp)));
        }
        let mut received = self.received.lock();
        *received = Received { count: received.count + 1, last: now };
    }

    /// Keeps the first error of either end.
    pub fn note(&self, result: Result<()>) {
        if let Err(error) = result {
            self.failure.lock().get_or_insert(error);
        }
    }

    pub fn check(&self) -> Result<()> {
        match self.failure.lock().take() {
            Some(error) if !self.stopped.load(Ordering::Relaxed) => Err(error),
            _ => Ok(()),
        }
    }

    /// Messages so far.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    pub fn received(&self) -> Received {
        *self.received.lock()
    }

    /// Since the last call.
    pub fn take_latencies(&self) -> Vec<u64> {
        std::mem::take(&mut self.latencies.lock())
    }

    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    async fn try_feed(&self, sender: &mut impl Sender) -> Result<()> {
        let mut body = vec![0x5a; self.load.bytes];
        // From a tick of the timer on, which has one a millisecond.
        tokio::time::sleep(Duration::from_millis(1)).await;
        let first = self.now();
        while !self.stopped.load(Ordering::Relaxed) {
            let number = self.sent();
            let mut stamp = self.now();
            if let Some(every) = self.load.every {
                let due = first + every.as_nanos() as u64 * number;
                self.wait_until(due).await;
                // A sender that is held up does not make its messages younger.
                stamp = due.min(self.now());
            } else if number.is_multiple_of(TURN) || self.load.bytes > 1000 {
                tokio::task::yield_now().await;
            }
            body[..STAMP].copy_from_slice(&stamp.to_be_bytes());
            sender.send(&body).await?;
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    /// The timer rounds up to its tick: half of one before, it is the right one.
    async fn wait_until(&self, due: u64) {
        const HALF_A_TICK: u64 = 500_000;
        let early = self.began + Duration::from_nanos(due.saturating_sub(HALF_A_TICK));
        tokio::time::sleep_until(early.into()).await;
    }

    fn now(&self) -> u64 {
        self.began.elapsed().as_nanos() as u64
    }
}

/// Reads messages of a lane from a stream, one behind the other, until it ends.
pub async fn drain(lane: &Lane, mut stream: impl tokio::io::AsyncRead + Unpin) -> Result<()> {
    let mut body = vec![0; lane.bytes()];
    loop {
        tokio::io::AsyncReadExt::read_exact(&mut stream, &mut body).await?;
        lane.arrived(&body);
    }
}

/// Which lane a stream is of: its first byte.
pub async fn of<'a>(lanes: &'a [Arc<Lane>], stream: &mut (impl tokio::io::AsyncRead + Unpin)) -> Result<&'a Arc<Lane>> {
    let index = tokio::io::AsyncReadExt::read_u8(stream).await?;
    match lanes.get(usize::from(index)) {
        Some(lane) => Ok(lane),
        None => bail!("a stream of lane {index}"),
    }
}
