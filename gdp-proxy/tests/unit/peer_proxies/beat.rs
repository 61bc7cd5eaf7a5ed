//! Unit tests of `peer_proxies::beat`.

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::*;
use crate::config::Side;
use crate::peer_proxies::RoutePart;

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
    let (peer_proxies, start) = (Arc::new(PeerProxies::default()), Instant::now());
    let part = RoutePart { name: Name::from_bytes([9; 32]), side: Side::Out, title: "topic /chatter".into() };
    let candidate = peer_proxies.enter(Name::from_bytes([1; 32]), part, true);
    let (tell, mut told) = mpsc::unbounded_channel();
    let beating = tokio::spawn(beat(peer_proxies, Counting(tell)));
    let mut texts = Vec::new();
    for i in 0..1000 {
        candidate.set_permitted(i % 2 == 0);
        tokio::time::sleep(Duration::from_millis(1)).await;
        texts.extend(std::iter::from_fn(|| told.try_recv().ok()));
    }
    // Those that are due anyway, and news.
    let most = 2 + start.elapsed().as_secs() + start.elapsed().as_millis() as u64 / PACE.as_millis() as u64;
    assert!((3..=most).contains(&(texts.len() as u64)), "{} in {:?}", texts.len(), start.elapsed());
    beating.abort();
}
