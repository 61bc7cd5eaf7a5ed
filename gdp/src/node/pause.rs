//! Pauses between attempts: ever longer ones, that news of the network cut short; how often they may.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until};

use crate::crypto;

/// Between attempts to get the link back, and to state what was refused: doubled from the first to the second.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));

/// What the kernel says of a network that has changed comes in parts.
const NEWS_SETTLE: Duration = Duration::from_millis(2);

/// Attempts that news bring about as they come, as another network comes in parts; and how far apart they are then on average, because
/// of a network that comes and goes there is no end of them.
const AT_ONCE: u32 = 3;
const HURRIED: Duration = Duration::from_millis(100);

/// The same where nobody knows which news matter.
const BLIND: Duration = Duration::from_secs(1);

/// Growing pauses, each between half and the whole of its length, so that many nodes do not return at once.
pub struct Backoff(Duration);

impl Backoff {
    pub fn new() -> Self {
        Self(BACKOFF.0)
    }

    pub async fn wait(&mut self) {
        let random = crypto::random::<1>().map_or(255, |[byte]| byte);
        sleep(self.0 / 2 + self.0 / 512 * u32::from(random)).await;
        self.0 = (self.0 * 2).min(BACKOFF.1);
    }
}

/// When news cut pauses short, the last [`AT_ONCE`] times.
#[derive(Debug, Default)]
pub struct Hurry(VecDeque<Instant>);

impl Hurry {
    /// Waits for the end of the pause, or for `news`; then the next pause is a short one again, unless these may be of no use (`blind`).
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
            () = backoff.wait() => return,
            () = hurried => {}
        }
        if is_full {
            self.0.pop_front();
        }
        self.0.push_back(Instant::now());
        if !blind {
            *backoff = Backoff::new();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::{pending, ready};

    /// A pause that nothing here waits for.
    const LONG: Duration = Duration::from_secs(600);

    #[tokio::test]
    async fn news_cut_a_pause_short_but_not_without_end() {
        let (mut hurry, start) = (Hurry::default(), Instant::now());
        for attempts in 0..3 * AT_ONCE {
            let mut backoff = Backoff(LONG);
            hurry.pause(&mut backoff, ready(()), false).await;
            assert_eq!(backoff.0, BACKOFF.0, "it begins anew");
            let least = attempts / AT_ONCE * AT_ONCE * HURRIED;
            assert!(start.elapsed() >= least, "{attempts} attempts after {:?}", start.elapsed());
        }
        assert!(start.elapsed() < LONG / 2);
    }

    #[tokio::test]
    async fn news_that_may_be_of_no_use_leave_pauses_long_and_come_apart() {
        let (mut hurry, mut backoff, start) = (Hurry::default(), Backoff(LONG), Instant::now());
        for _ in 0..=AT_ONCE {
            hurry.pause(&mut backoff, ready(()), true).await;
        }
        assert!(start.elapsed() >= AT_ONCE * BLIND && backoff.0 == LONG);
    }

    #[tokio::test]
    async fn without_news_pauses_grow() {
        let (mut hurry, mut backoff) = (Hurry::default(), Backoff(Duration::from_millis(2)));
        hurry.pause(&mut backoff, pending(), false).await;
        assert!(backoff.0 == Duration::from_millis(4) && hurry.0.is_empty());
    }
}
