//! A flow of messages of one size, and its results.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use parking_lot::Mutex;

/// The messages of a lane.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Bytes of a message; at least the size of its timestamp.
    pub bytes: usize,
    /// Interval between messages; `None`: as soon as the previous one is accepted.
    pub every: Option<Duration>,
}

/// One flow. Both ends are in this process and share it.
pub struct Lane {
    load: Load,
    began: Instant,
    sent: AtomicU64,
    received: Mutex<Received>,
    /// For messages at a fixed rate: nanoseconds from the due time to the arrival.
    latencies: Mutex<Vec<u64>>,
    stopped: AtomicBool,
    failure: Mutex<Option<anyhow::Error>>,
}

/// Messages received so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Received {
    pub count: u64,
    /// Arrival time of the last message in nanoseconds.
    pub last: u64,
}

/// The sending end of a contender.
pub trait Sender: Send {
    /// Returns as soon as the next message can be sent.
    fn send(&mut self, body: &[u8]) -> impl Future<Output = Result<()>> + Send;
}

/// Bytes of the timestamp at the beginning of a message.
const STAMP: usize = size_of::<u64>();

/// Number of small messages between two yields to other tasks.
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

    /// Returns the bytes of every message.
    pub fn bytes(&self) -> usize {
        self.load.bytes
    }

    /// Sends until the lane is stopped, and then keeps the sender alive: accepted messages may
    /// still be in flight.
    pub async fn feed(self: Arc<Self>, mut sender: impl Sender) {
        let fed = self.try_feed(&mut sender).await;
        self.note(fed);
        std::future::pending().await
    }

    /// Records an arrival. Ignores messages of another size, which are not the lane's.
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

    /// Stores the first error of either end.
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

    /// Returns the number of messages sent so far.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    pub fn received(&self) -> Received {
        *self.received.lock()
    }

    /// Returns the latencies since the last call.
    pub fn take_latencies(&self) -> Vec<u64> {
        std::mem::take(&mut self.latencies.lock())
    }

    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    async fn try_feed(&self, sender: &mut impl Sender) -> Result<()> {
        let mut body = vec![0x5a; self.load.bytes];
        // Starts at a tick of the timer, whose resolution is one millisecond.
        tokio::time::sleep(Duration::from_millis(1)).await;
        let first = self.now();
        while !self.stopped.load(Ordering::Relaxed) {
            let number = self.sent();
            let mut stamp = self.now();
            if let Some(every) = self.load.every {
                let due = first + every.as_nanos() as u64 * number;
                self.wait_until(due).await;
                // A delayed sender does not make its messages younger.
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

    /// Waits until the due time. The timer rounds up to its tick; half a tick earlier, the rounded
    /// tick is correct.
    async fn wait_until(&self, due: u64) {
        const HALF_A_TICK: u64 = 500_000;
        let early = self.began + Duration::from_nanos(due.saturating_sub(HALF_A_TICK));
        tokio::time::sleep_until(early.into()).await;
    }

    fn now(&self) -> u64 {
        self.began.elapsed().as_nanos() as u64
    }
}

/// Reads consecutive messages of a lane from a stream until it ends.
pub async fn drain(lane: &Lane, mut stream: impl tokio::io::AsyncRead + Unpin) -> Result<()> {
    let mut body = vec![0; lane.bytes()];
    loop {
        tokio::io::AsyncReadExt::read_exact(&mut stream, &mut body).await?;
        lane.arrived(&body);
    }
}

/// Returns the lane of a stream, which its first byte selects.
pub async fn of<'a>(lanes: &'a [Arc<Lane>], stream: &mut (impl tokio::io::AsyncRead + Unpin)) -> Result<&'a Arc<Lane>> {
    let index = tokio::io::AsyncReadExt::read_u8(stream).await?;
    match lanes.get(usize::from(index)) {
        Some(lane) => Ok(lane),
        None => bail!("a stream of lane {index}"),
    }
}
