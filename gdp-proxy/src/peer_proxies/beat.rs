//! Sends the claims of this proxy to the other proxies of a graph, and receives theirs.

use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_util::ticks::next_tick;

use super::{LISTEN, PeerProxies};

/// Period of the announcements without changes, after the start phase ([`LISTEN`]).
const BEAT: Duration = Duration::from_secs(1);

/// The period while no other proxy is known, after [`ALONE`]. A proxy that joins announces itself,
/// and gets an answer at once.
const ALONE_BEAT: Duration = Duration::from_secs(5);
const ALONE: Duration = Duration::from_secs(30);

/// Shortest time between two announcements, because constant changes would load the whole graph. A
/// proxy announces with this period in its start phase, so that those that discover it late answer
/// in time.
const PACE: Duration = Duration::from_millis(250);

/// Bound on the size of one announcement in bytes.
const MAX_TEXT: usize = 4 << 20;

/// The channel between the proxies of one graph.
pub trait Voice: Send {
    /// Sends the text to all other proxies. It does not wait for receivers, because the text is
    /// sent again soon.
    fn tell(&mut self, text: String) -> impl Future<Output = ()> + Send;

    /// Returns the next text of another proxy, which may be invalid, or `None` at the end. Safe to
    /// cancel.
    fn hear(&mut self) -> impl Future<Output = Option<Vec<u8>>> + Send;
}

/// Announces and receives claims forever, or until the channel ends.
pub async fn beat(peer_proxies: Arc<PeerProxies>, mut voice: impl Voice) {
    let began = tokio::time::Instant::now();
    let (mut has_warned, mut next, mut due) = (false, began, began);
    loop {
        let heard = tokio::select! {
            () = tokio::time::sleep_until(due) => None,
            () = news(&peer_proxies, next) => None,
            heard = voice.hear() => match heard {
                Some(heard) => Some(heard),
                None => return,
            },
        };
        let Some(heard) = heard else {
            if let Some(text) = peer_proxies.claims() {
                voice.tell(text).await;
            }
            let now = tokio::time::Instant::now();
            next = now + PACE;
            due = match now.duration_since(began) {
                time if time < LISTEN => now + PACE,
                time if time > ALONE && peer_proxies.is_alone(now.into_std()) => {
                    next_tick(ALONE_BEAT, now.into_std()).into()
                }
                _ => next_tick(BEAT, now.into_std()).into(),
            };
            continue;
        };
        let text = String::from_utf8_lossy(heard.get(..MAX_TEXT.min(heard.len())).unwrap_or_default());
        if let Err(error) = peer_proxies.receive(Instant::now(), &text)
            && !std::mem::replace(&mut has_warned, true)
        {
            tracing::warn!("what another proxy in the graph says of what it carries is not heeded: {error}");
        }
    }
}

/// Waits until `then`, and then until the claims of this proxy change.
async fn news(peer_proxies: &PeerProxies, then: tokio::time::Instant) {
    tokio::time::sleep_until(then).await;
    peer_proxies.news.notified().await;
}

#[cfg(test)]
#[path = "../../tests/unit/peer_proxies/beat.rs"]
mod tests;
