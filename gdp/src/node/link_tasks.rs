//! The tasks of one link while it is up: renewing statements, and detecting silence of the switch.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until, timeout_at};

use super::attachment::Attachment;
use super::network::{BETWEEN, HostNetwork, NetworkPath};
use super::pause::{BACKOFF, wait};
use super::send_path::SendPath;
use super::state::{LIFETIME, State};
use gdp_link::link::Link;
use gdp_link::link::liveness::{Detector, Pace};
use gdp_link::port::{LinkAddr, Port};
use gdp_proto::control::Request;

/// Maximum time for the first answer of a switch on the same host. Over UDP, also the base timeout
/// after this machine has changed networks; four round trips are added.
pub const ANSWER: Duration = Duration::from_millis(500);

/// The same base timeout for a switch over Ethernet.
const ANSWER_ON_CABLE: Duration = Duration::from_millis(100);

/// Renewal interval of certificates and statements with a lifetime of [`LIFETIME`].
const RENEWAL: Duration = Duration::from_secs(LIFETIME as u64 / 3);

/// The paces of echoes on the main link and on other links to a switch that negotiates none.
const MAIN_PACE: Pace = pace(100);
const OTHER_PACE: Pace = pace(500);

const fn pace(millis: u64) -> Pace {
    Pace { interval: Duration::from_millis(millis), idle: Duration::from_secs(1), misses: 5 }
}

/// Sends the node's statements to the RIB. Repeats them after a temporary refusal, after a
/// withdrawal that also removed them, and before they expire.
pub async fn keep_stated(state: Arc<State>, attachment: Arc<Attachment>) {
    let mut backoff = BACKOFF;
    let mut renewal = Instant::now() + RENEWAL;
    let (links, mut preferred) = (&state.send_path.links, None);
    loop {
        let turn = links.main_turn(&attachment);
        if turn.is_some() && turn != preferred {
            if !prefer(&state, &attachment).await {
                wait(&mut backoff).await;
                continue;
            }
            preferred = turn;
        }
        if !state.state_all(&attachment).await {
            wait(&mut backoff).await;
            continue;
        }
        backoff = BACKOFF;
        tokio::select! {
            () = links.slot(&attachment).unstated.notified() => {}
            () = sleep_until(renewal) => {
                renewal = Instant::now() + RENEWAL;
                if let Err(error) = state.attach(&attachment).await {
                    tracing::warn!(%error, "could not renew the attachment");
                }
            }
        }
    }
}

/// Requests that a switch with several links to this node prefer this one. Returns whether the
/// switch answered.
async fn prefer(state: &State, attachment: &Attachment) -> bool {
    if state.send_path.links.slots().len() == 1 {
        return true;
    }
    let answer = attachment.link.request(&Request::Ready).await;
    answer.inspect_err(|error| tracing::debug!(%error, "the switch did not hear that this is the main link")).is_ok()
}

/// Detects a switch that does not answer. The node then uses another link at once, although this
/// one is up.
pub async fn watch_silence(send_path: Arc<SendPath>, attachment: Arc<Attachment>) {
    let mut detector = Detector::default();
    loop {
        let of_old = || if send_path.links.is_main(&attachment) { MAIN_PACE } else { OTHER_PACE };
        let pace = attachment.link.negotiated_pace().unwrap_or_else(of_old);
        let step = attachment.probe(&mut detector, pace);
        // Also without a change: a preferred link that has been up for long enough becomes the main
        // one.
        send_path.set_silent(attachment.lane.into(), detector.is_silent());
        sleep(step.wait).await;
    }
}

/// Probes a link whose switch has fallen silent. Frames leave on it while its data plane answers,
/// until `until`. Returns then.
pub async fn watch_stale(send_path: &SendPath, attachment: &Arc<Attachment>, until: Instant) {
    let lane = usize::from(attachment.lane);
    let probing = async {
        let mut detector = Detector::default();
        loop {
            let step = attachment.probe(&mut detector, Pace::of(attachment.link.addr()));
            match (step.changed, detector.is_silent()) {
                (true, true) => {
                    tracing::warn!("nothing is sent to the switch for now: its data plane does not answer either");
                    send_path.end_stale(lane);
                }
                (true, false) => {
                    tracing::info!("the data plane of the switch answers again");
                    send_path.resume_stale(attachment);
                }
                (false, _) => {}
            }
            sleep(step.wait).await;
        }
    };
    let _: Result<(), _> = timeout_at(until, probing).await;
    tracing::warn!("nothing is sent to the switch any more: its daemon has been silent for too long");
    send_path.end_stale(lane);
}

/// Closes the link when its tunnel has ended.
pub async fn watch_tunnel(ended: impl Future<Output = ()>, link: Link) {
    ended.await;
    link.close("the TLS connection to the switch has ended");
}

/// Closes a link that is only for the time without a preferred one, once it is not needed.
pub async fn leave_unneeded(send_path: Arc<SendPath>, attachment: Arc<Attachment>) {
    send_path.links.until_unneeded(attachment.lane.into()).await;
    attachment.link.close("a preferred link is up");
}

/// Limits frames to what the route to the switch takes, after each change of this machine's
/// networks. QUIC discovers a larger path MTU, but not a smaller one soon.
pub async fn watch_mtu(network: Arc<HostNetwork>, port: Arc<Port>, link: Link) {
    let mut changes = network.changes();
    while changes.changed().await.is_ok() {
        link.limit_mtu(port.route_mtu(link.addr()));
        sleep(BETWEEN).await;
    }
}

/// Makes the node use other links after the path to the switch has changed, until the switch
/// answers again. Closes the link if the switch has a path but does not answer. `to` and `through`
/// are those of the path on the network.
pub async fn watch_moves(
    send_path: Arc<SendPath>,
    network: Arc<HostNetwork>,
    port: Arc<Port>,
    (to, through): (LinkAddr, Option<u32>),
    attachment: Arc<Attachment>,
) {
    let (lane, link) = (usize::from(attachment.lane), &attachment.link);
    let timeout = match link.addr() {
        LinkAddr::Udp(_) => ANSWER,
        LinkAddr::Ethernet { .. } => ANSWER_ON_CABLE,
    };
    let mut path = attachment.path.clone();
    loop {
        path = network.until_other(to, through, &path).await;
        send_path.set_moved(lane, true);
        let answered = async {
            if path == NetworkPath::Nowhere {
                // Wi-Fi may return soon.
                std::future::pending::<()>().await;
            }
            if let Err(error) = port.show_address() {
                tracing::debug!(%error, "the switch is not shown the new address");
            }
            attachment.is_answered(timeout + 4 * link.rtt()).await
        };
        tokio::select! {
            answered = answered => {
                if !answered {
                    return link.close("this machine is in another network, from which the switch does not answer");
                }
                send_path.set_moved(lane, false);
            }
            // Restart with the current path.
            _ = network.until_other(to, through, &path) => {}
        }
    }
}
