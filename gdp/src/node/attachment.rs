//! One link of a node, attached to its switch.

use crate::node::frame_size::FrameSize;
use crate::node::network::NetworkPath;
use crate::node::shared_entry::SharedEntry;
use gdp_core::crypto;
use gdp_link::link::liveness::{Liveness, Pace, Step};
use gdp_link::link::{Link, LinkKeys};
use gdp_link::port::{DataSocket, LinkAddr, OutFrame, Port};
use gdp_proto::control::{PathCosts, Request, Response};
use gdp_wire::table::PORT_USERSPACE;
use gdp_wire::{Header, SMALLEST_PATH, hop};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::{Instant, sleep};
use zerocopy::IntoBytes as _;

/// A link that was made, as publishers use it.
pub struct Attachment {
    /// Which of the node's links it is.
    pub lane: u8,
    pub link: Link,
    pub entry: SharedEntry,
    pub data: Arc<DataSocket>,
    /// Bytes of the largest frame that may come.
    pub largest: usize,
    /// What links further on take, as far as it is known.
    pub frame_size: FrameSize,
    /// How the switch was reached when the link was made.
    pub path: NetworkPath,
    pub since: Instant,
    pub count: AtomicU64,
    /// Cookie of the latest answer to an echo.
    pub answer: AtomicU64,
    /// The switch tells what paths cost.
    pub reported_costs: AtomicBool,
}

impl Attachment {
    pub fn new(lane: u8, link: Link, path: NetworkPath, port: &Port) -> Self {
        let (entry, data, largest) = (SharedEntry::new(link.entry(PORT_USERSPACE)), port.data(), port.mtu() as usize);
        let (count, answer, frame_size) = (AtomicU64::new(0), AtomicU64::new(0), FrameSize::default());
        let reported_costs = AtomicBool::new(false);
        Self {
            lane,
            entry,
            link,
            data,
            largest,
            frame_size,
            path,
            since: Instant::now(),
            count,
            answer,
            reported_costs,
        }
    }

    /// The count for the next frame: 1 for the first.
    pub fn next_count(&self) -> u64 {
        self.count.fetch_add(1, Ordering::Relaxed).wrapping_add(1)
    }

    /// Sends a frame without a payload to the switch itself; if it is lost, so be it.
    pub fn send(&self, mut header: Header) {
        hop::stamp(&mut header, &self.entry.get(), self.next_count());
        self.data.send_batch([OutFrame { to: self.link.addr(), head: header.as_bytes(), body: &[] }]);
    }

    /// The switch has answered the echo with this cookie.
    pub fn answered(&self, cookie: u64) {
        self.answer.store(cookie, Ordering::Relaxed);
    }

    /// Asks the data plane of the switch whether it lives, and returns when it does not answer.
    pub async fn until_silent(&self) {
        let mut liveness = Liveness::new(Pace::of(self.link.addr()));
        loop {
            let cookie = crypto::random().map_or(0, u64::from_le_bytes);
            match liveness.step(self.answer.load(Ordering::Relaxed), cookie) {
                Step::Ask => self.send(Header::echo(cookie)),
                Step::Silent => return,
            }
            sleep(liveness.pace().interval).await;
        }
    }

    /// Whether the data plane of the switch answers where frames are sent to. On the host itself
    /// that takes microseconds, but the daemon may not have taken the link into service yet.
    pub async fn is_answered(&self, within: Duration) -> bool {
        let (mut asked, until) = (Vec::new(), Instant::now() + within);
        while Instant::now() < until {
            let cookie = crypto::random().map_or(0, u64::from_le_bytes);
            asked.push(cookie);
            self.send(Header::echo(cookie));
            sleep(ECHOES).await;
            if asked.contains(&self.answer.load(Ordering::Relaxed)) {
                return true;
            }
        }
        false
    }

    /// Has the switch report what paths cost, and returns that, unless it reports it already. If it
    /// does not answer, servers are chosen without, and it is asked again with the next statement.
    pub async fn watch_costs(&self) -> Option<PathCosts> {
        if self.reported_costs.load(Ordering::Relaxed) {
            return None;
        }
        match self.link.request(&Request::WatchCosts).await {
            // What it has reported since is newer.
            Ok(Response::Costs(costs)) => (!self.reported_costs.swap(true, Ordering::Relaxed)).then_some(costs),
            Ok(other) => {
                tracing::debug!(?other, "the switch does not report what paths cost");
                None
            }
            Err(error) => {
                tracing::debug!(%error, "the switch did not report what paths cost");
                None
            }
        }
    }

    /// Largest payload of a frame, in bytes: what this link takes now, and links further on as far
    /// as is known.
    pub fn max_payload(&self) -> usize {
        let settling = matches!(self.link.addr(), LinkAddr::Udp(_)) && self.since.elapsed() < SETTLING;
        let largest = if settling { SMALLEST_PATH.into() } else { self.link.mtu() };
        (largest.min(self.frame_size.get()) as usize).saturating_sub(Header::LEN)
    }

    /// Replaces the keys of the link now and then, as long as it lives.
    pub async fn keep_keys(self: Arc<Self>) {
        let put = |keys: &LinkKeys| {
            self.entry.update(|entry| keys.put(entry));
            true
        };
        self.link.keep_keys(|| self.count.load(Ordering::Relaxed), put).await;
    }
}

/// Between two echoes that are waited for.
pub const ECHOES: Duration = Duration::from_millis(10);

/// How long frames on a new link over UDP stay as small as any path takes: meanwhile QUIC learns
/// the paths of links that are made at the same time, and switches learn them from it.
pub const SETTLING: Duration = Duration::from_secs(3);
