//! What the application's handles share, and what ends the node with the last of them.

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::state::State;

/// What keeps the node running.
pub struct Handle {
    pub state: Arc<State>,
    pub stop: watch::Sender<bool>,
    pub supervisor: Mutex<Option<JoinHandle<()>>>,
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.stop.send_replace(true);
    }
}
