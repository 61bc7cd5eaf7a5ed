//! The end of a handle and its reason, set once by the first task that detects it.

use std::pin::pin;
use std::sync::{Arc, OnceLock};

use tokio::sync::Notify;

use super::error::NodeError;
use gdp_core::cert::CertError;

/// Why a handle can no longer be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Ended {
    /// The right has expired, or the name's owner has revoked it.
    #[error(transparent)]
    Right(#[from] CertError),
    /// The node is closed, or the handle was dropped.
    #[error("the node is closed")]
    Closed,
}

impl From<Ended> for NodeError {
    fn from(ended: Ended) -> Self {
        match ended {
            Ended::Right(error) => Self::Cert(error),
            Ended::Closed => Self::Closed,
        }
    }
}

#[derive(Default)]
pub struct Ending {
    why: OnceLock<Ended>,
    ended: Notify,
}

impl Ending {
    pub fn end(&self, why: Ended) {
        if self.why.set(why).is_ok() {
            self.ended.notify_waiters();
        }
    }

    pub fn get(&self) -> Option<&Ended> {
        self.why.get()
    }

    /// Waits for the end. The future may outlive the handle.
    pub fn wait(self: &Arc<Self>) -> impl Future<Output = Ended> + Send + use<> {
        let ending = self.clone();
        async move {
            loop {
                let mut ended = pin!(ending.ended.notified());
                ended.as_mut().enable();
                if let Some(why) = ending.get() {
                    return why.clone();
                }
                ended.await;
            }
        }
    }
}
