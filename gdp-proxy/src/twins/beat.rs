//! Tells the other proxies in a graph, and hears what they tell.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{LISTEN, Twins};

/// How often it is told, if nothing changes, once it has been told for as long as newcomers listen.
const BEAT: Duration = Duration::from_secs(1);

/// How soon after it was told news are told: what changes all the time would keep the whole graph busy. Newcomers tell as often, so that those
/// who discover them late answer in time.
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
pub async fn beat(twins: Arc<Twins>, mut voice: impl Voice) {
    let began = tokio::time::Instant::now();
    let (mut has_warned, mut next, mut due) = (false, began, began);
    loop {
        let heard = tokio::select! {
            () = tokio::time::sleep_until(due) => None,
            () = news(&twins, next) => None,
            heard = voice.hear() => match heard {
                Some(heard) => Some(heard),
                None => return,
            },
        };
        let Some(heard) = heard else {
            if let Some(text) = twins.claims() {
                voice.tell(text).await;
            }
            let now = tokio::time::Instant::now();
            next = now + PACE;
            due = now + if now < began + LISTEN { PACE } else { BEAT };
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

/// Returns when there are some, not before then.
async fn news(twins: &Twins, then: tokio::time::Instant) {
    tokio::time::sleep_until(then).await;
    twins.news.notified().await;
}

#[cfg(test)]
mod tests {
    use gdp_wire::Name;
    use tokio::sync::mpsc;

    use super::*;
    use crate::config::Side;
    use crate::twins::Part;

    struct Counting(mpsc::UnboundedSender<String>);

    impl Voice for Counting {
        async fn tell(&mut self, text: String) {
            self.0.send(text).unwrap();
        }

        async fn hear(&mut self) -> Option<Vec<u8>> {
            std::future::pending().await
        }
    }

    #[tokio::test]
    async fn what_changes_all_the_time_is_told_a_few_times_a_second() {
        let (twins, start) = (Arc::new(Twins::default()), Instant::now());
        let part = Part { name: Name::from_bytes([9; 32]), side: Side::Out, title: "topic /chatter".into() };
        let place = twins.enter(Name::from_bytes([1; 32]), part, true);
        let (tell, mut told) = mpsc::unbounded_channel();
        let beating = tokio::spawn(beat(twins, Counting(tell)));
        let mut texts = Vec::new();
        for i in 0..1000 {
            place.set_permitted(i % 2 == 0);
            tokio::time::sleep(Duration::from_millis(1)).await;
            texts.extend(std::iter::from_fn(|| told.try_recv().ok()));
        }
        // Those that are due anyway, and news.
        let most = 2 + start.elapsed().as_secs() + start.elapsed().as_millis() as u64 / PACE.as_millis() as u64;
        assert!((3..=most).contains(&(texts.len() as u64)), "{} in {:?}", texts.len(), start.elapsed());
        beating.abort();
    }
}
