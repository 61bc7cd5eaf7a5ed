//! The state of a route of calls to remote servers, and its tasks.

use crate::call::Way;
use crate::call::asking::Known;
use crate::call::inward::events::Remote;
use crate::call::outbox::Outbox;
use crate::call::stand::Stands;
use gdp::unstable::Client;
use gdp_ros::action::{Board, Goals};
use gdp_ros::call::Description;
use gdp_wire::Name;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::watch;

/// The known state of all remote servers of the name.
pub struct In<'a> {
    pub way: &'a Way<'a>,
    pub client: &'a Client,
    pub remotes: BTreeMap<Name, Remote>,
    /// The local server on their behalf, with its description.
    pub local: Option<(Arc<Stands>, Description)>,
    pub goals: &'a Mutex<Goals<Name>>,
    pub board: Board,
    pub outbox: Outbox,
    /// True while an event of the outbox is being published.
    pub is_speaking: bool,
    /// True when the route ends and waiting clients have to be informed.
    pub is_leaving: watch::Receiver<bool>,
}

impl In<'_> {
    pub fn knows(&self, known: &Arc<Known>) -> bool {
        matches!(self.remotes.get(&known.instance), Some(Remote::Known(now)) if Arc::ptr_eq(now, known))
    }

    /// Ends the goals of a server that has left or changed.
    pub fn lose_goals(&mut self, now: Instant, server: Name) {
        self.goals.lock().end_all(now, server);
        if self.board.leave(now, &server) {
            self.show();
        }
    }

    pub fn show(&mut self) {
        self.outbox.status(self.board.message());
    }
}
