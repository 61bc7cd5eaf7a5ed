//! The state that the application's handles share, and that stops the node when the last handle is
//! dropped.

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::state::State;

/// The shared handle that keeps the node running.
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
