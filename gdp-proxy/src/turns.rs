//! Carries by turns what only one proxy of a graph carries at a time, as [`twins`](crate::twins) says.

use std::pin::{Pin, pin};
use std::time::{Duration, Instant};

use gdp::{Name, Node};

use crate::standing::{RouteError, Standing};
use crate::twins::Place;

/// How often it is looked whether another proxy of the graph carries it.
const LOOK: Duration = Duration::from_millis(250);

/// Ends when a turn is over.
pub type Over<'a> = Pin<&'a mut (dyn Future<Output = ()> + 'a)>;

/// Carries whenever no other proxy of the graph does, until `stop` ends. `carry`: one turn, that leaves both sides properly once what it is given has
/// ended, and returns; before that only with an error.
pub async fn by_turns(
    place: &Place,
    node: &Node,
    standing: &Standing,
    stop: impl Future<Output = ()>,
    mut carry: impl AsyncFnMut(Over<'_>) -> Result<(), RouteError>,
) -> Result<(), RouteError> {
    let mut stop = pin!(stop);
    loop {
        // Before anything is carried: who has it already is not disturbed.
        if let Some(ahead) = place.ahead(Instant::now()) {
            tracing::info!(what = standing.title(), name = %standing.name(), "standing by for {ahead}");
            standing.set_status(&format!("standing by for {ahead}"));
            tokio::select! {
                () = &mut stop => return Ok(()),
                () = until(node, place, |ahead| ahead.is_none().then_some(())) => {}
            }
        }
        let mut is_stopped = false;
        let over = async {
            tokio::select! {
                () = &mut stop => is_stopped = true,
                _ = until(node, place, |ahead| ahead) => {}
            }
        };
        carry(pin!(over)).await?;
        if is_stopped {
            return Ok(());
        }
    }
}

/// Does something unless the turn is over before.
pub async fn unless<T>(over: &mut (impl Future<Output = ()> + Unpin), work: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        done = work => Some(done),
        () = over => None,
    }
}

/// Waits for what is wanted of who carries it instead of this proxy; and tells meanwhile whether this one could.
async fn until<T>(node: &Node, place: &Place, wanted: impl Fn(Option<Name>) -> Option<T>) -> T {
    loop {
        place.set_attached(node.switch().is_ok());
        if let Some(found) = wanted(place.ahead(Instant::now())) {
            return found;
        }
        tokio::time::sleep(LOOK).await;
    }
}
