//! Pauses between attempts: ever longer ones, that news of the network cut short; how often they
//! may.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until};

use gdp_core::crypto;
use gdp_util::backoff::{Backoff, jittered};

/// Between attempts to get the link back, and to state what was refused: doubled from the first to
/// the second.
pub const BACKOFF: Backoff = Backoff::new(Duration::from_millis(100), Duration::from_secs(5));

/// What the kernel says of a network that has changed comes in parts.
const NEWS_SETTLE: Duration = Duration::from_millis(2);

/// Attempts that news bring about as they come, as another network comes in parts; and how far
/// apart they are then on average, because of a network that comes and goes there is no end of
/// them.
const AT_ONCE: u32 = 3;
const HURRIED: Duration = Duration::from_millis(100);

/// The same where nobody knows which news matter.
const BLIND: Duration = Duration::from_secs(1);

/// Waits for the next delay, with jitter, so that many nodes do not return at once. A wait that is
/// cut short does not count.
pub async fn wait(backoff: &mut Backoff) {
    let random = crypto::random::<1>().map_or(255, |[byte]| byte);
    let mut next = *backoff;
    sleep(jittered(next.next_delay(), random)).await;
    *backoff = next;
}

/// When news cut pauses short, the last [`AT_ONCE`] times.
#[derive(Debug, Default)]
pub struct ExpediteToken(VecDeque<Instant>);

impl ExpediteToken {
    /// Waits for the end of the pause, or for `news`; then the next pause is a short one again,
    /// unless these may be of no use (`blind`).
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
