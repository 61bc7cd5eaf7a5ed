//! Runs a route only while this proxy is the active one of its graph, as
//! [`peer_proxies`](crate::peer_proxies) decides.

use std::pin::Pin;
use std::time::{Duration, Instant};

use gdp::unstable::Node;
use gdp_util::ticks::next_tick;
use gdp_wire::Name;

use crate::peer_proxies::Candidate;
use crate::route_status::{RouteStatus, STANDING_BY};

/// How often the proxy checks whether another proxy of the graph has gone silent, and whether the
/// fabric is there.
const LOOK: Duration = Duration::from_secs(1);

/// The turns in which this proxy carries a route, until `stop` completes.
pub struct Turns<'a, S> {
    candidate: &'a Candidate,
    node: &'a Node,
    route_status: &'a RouteStatus,
    stop: Pin<&'a mut S>,
    is_stopped: bool,
}

impl<'a, S: Future<Output = ()>> Turns<'a, S> {
    pub fn new(candidate: &'a Candidate, node: &'a Node, route_status: &'a RouteStatus, stop: Pin<&'a mut S>) -> Self {
        Self { candidate, node, route_status, stop, is_stopped: false }
    }

    /// Waits until no other proxy of the graph carries the route, and returns true. Returns false
    /// once `stop` has completed.
    pub async fn begin(&mut self) -> bool {
        if self.is_stopped {
            return false;
        }
        // Checked before the route starts, so that the proxy that carries it already is not
        // disturbed.
        let Some(ahead) = self.candidate.ahead(Instant::now()) else { return true };
        tracing::info!(what = self.route_status.title(), name = %self.route_status.name(), "standing by for {ahead}");
        self.route_status.set_status(&format!("{STANDING_BY} for {ahead}"));
        tokio::select! {
            () = &mut self.stop => false,
            () = until(self.node, self.candidate, |ahead| ahead.is_none().then_some(())) => true,
        }
    }

    /// Waits for the end of the turn. The route then has to leave the graph and the fabric in
    /// order.
    pub async fn over(&mut self) {
        tokio::select! {
            () = &mut self.stop => self.is_stopped = true,
            _ = until(self.node, self.candidate, |ahead| ahead) => {}
        }
    }
}

/// Runs `work` unless the turn ends first. Returns `None` in that case.
pub async fn unless<T>(over: &mut (impl Future<Output = ()> + Unpin), work: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        done = work => Some(done),
        () = over => None,
    }
}

/// Waits until `wanted` accepts the proxy that carries the route instead of this one, if any.
/// Meanwhile it announces whether this proxy is attached to the fabric.
async fn until<T>(node: &Node, candidate: &Candidate, wanted: impl Fn(Option<Name>) -> Option<T>) -> T {
    let mut changes = candidate.changes();
    loop {
        candidate.set_attached(node.switch().is_ok());
        if let Some(found) = wanted(candidate.ahead(Instant::now())) {
            return found;
        }
        tokio::select! {
            () = tokio::time::sleep_until(next_tick(LOOK, Instant::now()).into()) => {}
            () = changes.next() => {}
        }
    }
}
