//! Exponential backoff between attempts, which network changes cut short, with a rate limit.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until};

use gdp_core::crypto;
use gdp_util::backoff::{Backoff, jittered};

/// The backoff between reconnection attempts, and between repetitions of refused statements.
pub const BACKOFF: Backoff = Backoff::new(Duration::from_millis(100), Duration::from_secs(5));

/// Time to wait for further notifications, because the kernel reports a network change in parts.
const NEWS_SETTLE: Duration = Duration::from_millis(2);

/// Rate limit of pauses that network changes cut short. `AT_ONCE` pauses may end at once, because a
/// change arrives in several notifications. On average they are `HURRIED` apart, because a flapping
/// network changes endlessly.
const AT_ONCE: u32 = 3;
const HURRIED: Duration = Duration::from_millis(100);

/// The same interval if the node cannot determine which changes are relevant.
const BLIND: Duration = Duration::from_secs(1);

/// Waits for the next delay, with jitter, to spread the reconnections of many nodes. A cancelled
/// wait does not advance the backoff.
pub async fn wait(backoff: &mut Backoff) {
    let random = crypto::random::<1>().map_or(255, |[byte]| byte);
    let mut next = *backoff;
    sleep(jittered(next.next_delay(), random)).await;
    *backoff = next;
}

/// The times of the last [`AT_ONCE`] pauses that network changes cut short.
#[derive(Debug, Default)]
pub struct ExpediteToken(VecDeque<Instant>);

impl ExpediteToken {
    /// Waits for the end of the pause or for `news`, a network change. After a change the backoff
    /// restarts, unless the change may be irrelevant (`blind`).
    pub async fn pause(&mut self, backoff: &mut Backoff, news: impl Future<Output = ()>, blind: bool) {
        let apart = if blind { BLIND } else { HURRIED };
        let is_full = self.0.len() >= AT_ONCE as usize;
        let earliest = self.0.front().filter(|_| is_full).map(|first| *first + apart * AT_ONCE);
        let hurried = async {
            news.await;
            sleep(NEWS_SETTLE).await;
            if let Some(earliest) = earliest {
                sleep_until(earliest).await;
            }
        };
        tokio::select! {
            () = wait(backoff) => return,
            () = hurried => {}
        }
        if is_full {
            self.0.pop_front();
        }
        self.0.push_back(Instant::now());
        if !blind {
            backoff.reset();
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/pause.rs"]
mod tests;
