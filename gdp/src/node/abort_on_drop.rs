//! A task that is aborted when its handle is dropped.

use tokio::task::JoinHandle;

pub struct AbortOnDrop(pub JoinHandle<()>);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}
