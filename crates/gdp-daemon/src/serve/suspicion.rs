//! Watches the counters of what only attacks and broken peers cause: frames that nobody may send,
//! and handshakes that come to no link. A burst of a kind gives one event and one log line, at most
//! once a minute. The counters themselves have everything.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_proto::admin::event::Event;
use gdp_util::ticks::next_tick;
use gdp_wire::{Counter, Name};
use tokio::time::sleep_until;

use super::core::Core;
use super::daemon::Daemon;

/// The interval at which the counters are read.
const LOOK: Duration = Duration::from_secs(5);

/// The minimum interval between two reports of a kind. Fewer than its burst in this time are none.
const PERIOD: Duration = Duration::from_secs(60);

/// A kind of suspicious frame.
struct Suspect {
    counter: Counter,
    /// The number of frames that count as a burst. Of some kinds, honest peers send a few after a
    /// restart.
    burst: u64,
    /// Whether the link's key authenticates such frames, so that its peer sent them.
    is_peers: bool,
    about: &'static str,
}

const FRAMES: [Suspect; 6] = [
    Suspect {
        counter: Counter::BadTag,
        burst: 10,
        is_peers: false,
        about: "frames that no peer with the link's key sent",
    },
    Suspect { counter: Counter::Replayed, burst: 10, is_peers: false, about: "frames that had come before" },
    Suspect { counter: Counter::Source, burst: 10, is_peers: true, about: "frames of a peer in the name of another" },
    Suspect {
        counter: Counter::NotPermitted,
        burst: 10,
        is_peers: true,
        about: "frames to names that the peer may not send to",
    },
    Suspect { counter: Counter::NoLink, burst: 1000, is_peers: false, about: "frames that belong to no link" },
    Suspect { counter: Counter::Truncated, burst: 1000, is_peers: false, about: "frames that were cut short" },
];

/// The kind of handshakes that came to no link, and their burst.
const HANDSHAKES: (&str, u64) = ("handshakes", 20);

/// The state of each watched counter.
#[derive(Default)]
struct Bursts(BTreeMap<&'static str, Counted>);

struct Counted {
    /// The value at the last report, or at the start of the present period.
    base: u64,
    since: Instant,
    reported: Option<Instant>,
}

impl Bursts {
    /// Takes the present value of a counter. Returns the increase if it is a burst to report.
    fn take(&mut self, what: &'static str, value: u64, burst: u64, now: Instant) -> Option<u64> {
        let counted = self.0.entry(what).or_insert(Counted { base: value, since: now, reported: None });
        if counted.reported.is_some_and(|at| now.saturating_duration_since(at) < PERIOD) {
            return None;
        }
        let increase = value.saturating_sub(counted.base);
        let is_burst = increase >= burst;
        if is_burst || now.saturating_duration_since(counted.since) >= PERIOD {
            (counted.base, counted.since) = (value, now);
        }
        if is_burst {
            counted.reported = Some(now);
        }
        is_burst.then_some(increase)
    }
}

/// Watches the counters until the daemon ends.
pub async fn run(daemon: Arc<Daemon>) {
    let mut bursts = Bursts::default();
    loop {
        look(&daemon, &mut bursts);
        sleep_until(next_tick(LOOK, Instant::now()).into()).await;
    }
}

fn look(daemon: &Daemon, bursts: &mut Bursts) {
    let (core, now) = (daemon.core(), Instant::now());
    if let Ok(counters) = core.switch.planes.counters() {
        let values: BTreeMap<&str, u64> =
            counters.into_iter().map(|(counter, first, userspace)| (counter.as_str(), first + userspace)).collect();
        for Suspect { counter, burst, is_peers, about } in &FRAMES {
            let (what, value) = (counter.as_str(), values.get(counter.as_str()).copied().unwrap_or_default());
            let Some(count) = bursts.take(what, value, *burst, now) else { continue };
            let peer = is_peers.then(|| worst(&core, *counter)).flatten();
            let from = peer.map(|peer| format!("; most over the link of {peer:#}")).unwrap_or_default();
            tracing::warn!(count, "dropped {about} ({what}){from}");
            core.events.tell(Event::Suspicious { what: what.into(), count, peer });
        }
    }
    let counts = daemon.port_config.handshakes.read();
    let (what, burst) = HANDSHAKES;
    // Who was challenged mostly gets a link.
    let value = counts.refused + counts.displaced + counts.failed;
    if let Some(count) = bursts.take(what, value, burst, now) {
        tracing::warn!(count, "handshakes of peers came to no link; `gdp-ctl status` tells how they ended");
        core.events.tell(Event::Suspicious { what: what.into(), count, peer: None });
    }
}

/// Returns the peer of the link with the most frames of a kind.
fn worst(core: &Core, counter: Counter) -> Option<Name> {
    let count = |link: u32| core.switch.planes.arrivals(link).map_or(0, |row| row[counter as usize]);
    let counts = core.switch.links.iter().map(|(id, state)| (count(*id), state.link.peer().name));
    counts.max().filter(|(count, _)| *count > 0).map(|(_, peer)| peer)
}

#[cfg(test)]
#[path = "../../tests/unit/serve/suspicion.rs"]
mod tests;
