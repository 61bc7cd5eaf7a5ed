//! One link of a node, attached to its switch.

use crate::node::frame_size::FrameSize;
use crate::node::network::NetworkPath;
use crate::node::shared_entry::SharedEntry;
use gdp_core::crypto;
use gdp_link::link::liveness::{Detector, Evidence, Pace, Step};
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

/// An established link, as publishers use it.
pub struct Attachment {
    /// The lane of the link.
    pub lane: u8,
    pub link: Link,
    pub entry: SharedEntry,
    pub data: Arc<DataSocket>,
    /// Size of the largest frame that may arrive, in bytes.
    pub largest: usize,
    /// The known frame size limit of links beyond the first.
    pub frame_size: FrameSize,
    /// The network path to the switch when the link was made.
    pub path: NetworkPath,
    pub since: Instant,
    /// Number of frames sent, and of those without a message among them.
    pub count: AtomicU64,
    own_frames: AtomicU64,
    /// Number of data frames received.
    pub data_received: Arc<AtomicU64>,
    /// The cookie of the latest answer to an echo.
    pub answer: AtomicU64,
    /// Whether the switch reports path costs.
    pub reported_costs: AtomicBool,
}

impl Attachment {
    pub fn new(lane: u8, link: Link, path: NetworkPath, port: &Port) -> Self {
        let (entry, data, largest) = (SharedEntry::new(link.entry(PORT_USERSPACE)), port.data(), port.mtu() as usize);
        Self {
            lane,
            entry,
            link,
            data,
            largest,
            frame_size: FrameSize::default(),
            path,
            since: Instant::now(),
            count: AtomicU64::new(0),
            own_frames: AtomicU64::new(0),
            data_received: Arc::default(),
            answer: AtomicU64::new(0),
            reported_costs: AtomicBool::new(false),
        }
    }

    /// Returns the count for the next frame. The first frame has count 1.
    pub fn next_count(&self) -> u64 {
        self.count.fetch_add(1, Ordering::Relaxed).wrapping_add(1)
    }

    /// Returns the number of data frames that were sent and received.
    pub fn data_frames(&self) -> u64 {
        let sent = self.count.load(Ordering::Relaxed).wrapping_sub(self.own_frames.load(Ordering::Relaxed));
        sent.wrapping_add(self.data_received.load(Ordering::Relaxed))
    }

    /// Sends a frame without a payload to the switch itself. The frame is not retransmitted.
    pub fn send(&self, mut header: Header) {
        self.own_frames.fetch_add(1, Ordering::Relaxed);
        hop::stamp(&mut header, &self.entry.get(), self.next_count());
        self.data.send_batch([OutFrame { to: self.link.addr(), head: header.as_bytes(), body: &[] }]);
    }

    /// Records the switch's answer to the echo with this cookie.
    pub fn answered(&self, cookie: u64) {
        self.answer.store(cookie, Ordering::Relaxed);
    }

    /// Sends the next echo to the switch's data plane. Call it again after [`Step::wait`].
    pub fn probe(&self, detector: &mut Detector, pace: Pace) -> Step {
        let cookie = crypto::random().map_or(0, u64::from_le_bytes);
        // The switch sends no echoes to a node, so only answers prove both directions.
        let sample = Evidence {
            answer: self.answer.load(Ordering::Relaxed),
            received: 0,
            data: self.data_frames(),
            rtt: self.link.rtt(),
        };
        let step = detector.step(self.since.elapsed(), pace, sample, cookie);
        self.send(Header::echo(cookie));
        step
    }

    /// Returns whether the switch's data plane answers at the address of frames within this time. A
    /// switch on the same host answers in microseconds, but its daemon may not have installed the
    /// link yet.
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

    /// Requests path costs from the switch and returns them, unless the switch already reports
    /// them. If the switch does not answer, the node selects servers without costs. It repeats the
    /// request with the next statement.
    pub async fn watch_costs(&self) -> Option<PathCosts> {
        if self.reported_costs.load(Ordering::Relaxed) {
            return None;
        }
        match self.link.request(&Request::WatchCosts).await {
            // A report that has arrived since the request is newer.
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

    /// Returns the maximum payload of a frame, in bytes. It respects this link's MTU and the known
    /// limits of further links.
    pub fn max_payload(&self) -> usize {
        let settling = matches!(self.link.addr(), LinkAddr::Udp(_)) && self.since.elapsed() < SETTLING;
        let largest = if settling { SMALLEST_PATH.into() } else { self.link.mtu() };
        (largest.min(self.frame_size.get()) as usize).saturating_sub(Header::LEN)
    }

    /// Replaces the link's keys on schedule until the link closes.
    pub async fn keep_keys(self: Arc<Self>) {
        let put = |keys: &LinkKeys| {
            self.entry.update(|entry| keys.put(entry));
            true
        };
        self.link.keep_keys(|| self.count.load(Ordering::Relaxed), put).await;
    }
}

/// Interval between echoes in [`Attachment::is_answered`].
pub const ECHOES: Duration = Duration::from_millis(10);

/// Time for which frames on a new UDP link fit any path. Meanwhile QUIC discovers the path MTUs of
/// links that are made at the same time, and switches learn them from QUIC.
pub const SETTLING: Duration = Duration::from_secs(3);
