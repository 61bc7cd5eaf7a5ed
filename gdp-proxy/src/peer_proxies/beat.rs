//! Sends the claims of this proxy to the other proxies of a graph, and receives theirs.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{LISTEN, PeerProxies};

/// How often it is told, if nothing changes, once it has been told for as long as newcomers listen.
const BEAT: Duration = Duration::from_secs(1);

/// How soon after it was told news are told: what changes all the time would keep the whole graph
/// busy. Newcomers tell as often, so that those who discover them late answer in time.
const PACE: Duration = Duration::from_millis(250);

/// What one proxy tells, in bytes.
const MAX_TEXT: usize = 4 << 20;

/// How the proxies of one graph speak to one another.
pub trait Voice: Send {
    /// Tells all others. Waits for nobody; it is told again soon.
    fn tell(&mut self, text: String) -> impl Future<Output = ()> + Send;

    /// The next text of another, or nonsense; `None` once there are no more. Safe to cancel.
    fn hear(&mut self) -> impl Future<Output = Option<Vec<u8>>> + Send;
}

/// Runs for ever, or until nothing more can be heard.
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
            due = now + if now < began + LISTEN { PACE } else { BEAT };
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

/// Returns when there are some, not before then.
async fn news(peer_proxies: &PeerProxies, then: tokio::time::Instant) {
    tokio::time::sleep_until(then).await;
    peer_proxies.news.notified().await;
}

#[cfg(test)]
#[path = "../../tests/unit/peer_proxies/beat.rs"]
mod tests;
