//! Probes the data planes of peers by echoes.
//!
//! A switch that has negotiated echoes is probed as long as the link lasts. Frames avoid the link
//! while it does not answer, although QUIC may not have noticed anything yet.
//!
//! QUIC ends in the peer's daemon or process, but its data plane may still forward. The switch
//! therefore keeps such a link with its routes, and probes it, whatever was negotiated. A link to
//! an endpoint is removed as soon as echoes go unanswered. One to a switch stays until its time is
//! over: frames use it again once it answers.

use std::sync::Arc;

use gdp_core::crypto;
use gdp_core::peer::Role;
use gdp_dataplane::LinkCounters;
use gdp_link::link::Link;
use gdp_link::link::liveness::{Detector, Evidence, Pace};
use gdp_util::ticks::next_tick;
use gdp_wire::Counter;
use tokio::time::{Duration, Instant, sleep_until};

use super::core::Core;
use super::daemon::Daemon;
use super::detach::detach_lost;

/// Steps that are at least this far apart use common ticks.
const COMMON: Duration = Duration::from_secs(1);

/// Returns whether the link is probed while QUIC is alive.
pub fn is_probed(link: &Link) -> bool {
    link.peer().role == Role::Switch && link.negotiated_pace().is_some()
}

/// Probes a link until it is removed, its peer has a newer link, or it expires.
pub async fn watch(daemon: Arc<Daemon>, link: Link) {
    let (began, mut detector, mut asked) = (Instant::now(), Detector::default(), 0);
    loop {
        let cookie = crypto::random().map_or(0, u64::from_le_bytes);
        let step = {
            let mut core = daemon.core();
            let Some((pace, sample)) = sample(&core, &link, asked) else { return };
            let step = detector.step(began.elapsed(), pace, sample, cookie);
            core.switch.planes.ask(link.local_id(), cookie);
            asked += 1;
            if step.changed && link.peer().role == Role::Switch {
                core.set_answering(&link, !detector.is_silent());
            }
            step
        };
        if step.changed && !react(&daemon, &link, detector.is_silent()) {
            return;
        }
        let now = Instant::now();
        let common = (step.wait >= COMMON).then(|| next_tick(step.wait, now.into_std()).into());
        sleep_until(common.unwrap_or(now + step.wait)).await;
    }
}

/// Waits until the data plane at the other end of a live link does not answer.
pub async fn until_silent(daemon: &Daemon, link: &Link) {
    loop {
        let silent = daemon.silent.notified();
        if !daemon.core().switch.answers(link) {
            return;
        }
        silent.await;
    }
}

/// Handles a link that has become silent, or alive again. Returns whether to probe on.
fn react(daemon: &Arc<Daemon>, link: &Link, is_silent: bool) -> bool {
    let peer = format_args!("{:#}", link.peer().name).to_string();
    if link.peer().role == Role::Switch {
        match is_silent {
            true => {
                tracing::warn!(peer, "the data plane of the switch does not answer; frames avoid its link");
                daemon.silent.notify_waiters();
            }
            false => tracing::info!(peer, "the data plane of the switch answers again"),
        }
        daemon.topology_changed();
        return true;
    }
    tracing::info!(peer, "its data plane does not answer either; its link is gone");
    let lost = daemon.core().switch.release(link.local_id());
    if let Some(entity) = lost {
        daemon.spawn(detach_lost(daemon.clone(), entity));
    }
    false
}

/// Returns the pace of a link and what has arrived on it, or `None` if it is no longer probed.
fn sample(core: &Core, link: &Link, asked: u64) -> Option<(Pace, Evidence)> {
    let (switch, id, is_switch) = (&core.switch, link.local_id(), link.peer().role == Role::Switch);
    let is_live = switch.links.contains_key(&id);
    let pace = match (is_live, is_switch) {
        (true, _) => link.negotiated_pace()?,
        _ if !switch.awaits(link) => return None,
        (false, true) => link.pace(),
        // The release is final, so an endpoint gets the time of a Wi-Fi adapter that roams.
        (false, false) => Pace::of(link.addr()),
    };
    let arrivals = switch.planes.arrivals(id).unwrap_or([0; Counter::COUNT]);
    let (received, data) = traffic(&arrivals, switch.planes.frames_sent(id), asked);
    // A peer without its daemon sends no echoes, so only answers prove both directions.
    let received = if is_live { received } else { 0 };
    let rtt = if is_live { link.rtt() } else { Duration::ZERO };
    Some((pace, Evidence { answer: switch.planes.notices().answer(id), received, data, rtt }))
}

/// Returns the number of frames that prove that the peer is alive, and that of data frames in both
/// directions. The latter starts anywhere.
///
/// Only frames with a valid tag that are no replays count. `sent` includes echoes and answers.
fn traffic(arrivals: &LinkCounters, sent: u64, asked: u64) -> (u64, u64) {
    let of = |counter: Counter| arrivals[counter as usize];
    let onward = Counter::ALL.iter().filter(|counter| counter.is_onward()).map(|counter| of(*counter)).sum::<u64>();
    let received = onward + of(Counter::Echoed) + of(Counter::Notice);
    (received, onward.wrapping_add(sent).wrapping_sub(asked).wrapping_sub(of(Counter::Echoed)))
}

#[cfg(test)]
#[path = "../../tests/unit/serve/liveness.rs"]
mod tests;
