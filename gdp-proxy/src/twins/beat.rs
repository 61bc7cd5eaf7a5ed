//! Tells the other proxies in a graph, and hears what they tell.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::time::MissedTickBehavior;

use super::Twins;

/// How often it is told, if nothing changes.
const BEAT: Duration = Duration::from_secs(1);

/// What one proxy tells, in bytes.
const MAX_TEXT: usize = 1 << 20;

/// How the proxies of one graph speak to one another.
pub trait Voice: Send {
    /// Tells all others. Waits for nobody; it is told again soon.
    fn tell(&mut self, text: String) -> impl Future<Output = ()> + Send;

    /// The next text of another, or nonsense; `None` once there are no more. Safe to cancel.
    fn hear(&mut self) -> impl Future<Output = Option<Vec<u8>>> + Send;
}

/// Runs for ever, or until nothing more can be heard.
pub async fn beat(twins: Arc<Twins>, mut voice: impl Voice) {
    let mut ticks = tokio::time::interval(BEAT);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut has_warned = false;
    loop {
        let heard = tokio::select! {
            _ = ticks.tick() => None,
            () = twins.news.notified() => None,
            heard = voice.hear() => match heard {
                Some(heard) => Some(heard),
                None => return,
            },
        };
        let Some(heard) = heard else {
            if let Some(text) = twins.claims() {
                voice.tell(text).await;
            }
            continue;
        };
        let text = String::from_utf8_lossy(heard.get(..MAX_TEXT.min(heard.len())).unwrap_or_default());
        if let Err(error) = twins.heard(Instant::now(), &text)
            && !std::mem::replace(&mut has_warned, true)
        {
            tracing::warn!("what another proxy in the graph says of what it carries is not heeded: {error}");
        }
    }
}
