//! Receiving for Python, which may give up at any time.
//!
//! A future that asyncio cancels loses its result. So [`Receiving::ready`] only waits, and leaves
//! what it receives here. [`Receiving::take`] returns it at once, and nothing can come between.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;
use tokio::sync::Mutex;

use crate::convert::seconds;
use crate::runtime::awaitable;

/// Receives one after another, safe to cancel.
pub trait Receive: Send + 'static {
    type Received: Send + 'static;

    fn receive(&mut self) -> impl Future<Output = PyResult<Option<Self::Received>>> + Send;
}

type Undelivered<T> = std::sync::Mutex<Option<PyResult<Option<T>>>>;

/// A receiver, and what it has received and nobody has taken yet. Clones are the same.
pub struct Receiving<R: Receive>(Arc<(Mutex<R>, Undelivered<R::Received>)>);

impl<R: Receive> Clone for Receiving<R> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<R: Receive> Receiving<R> {
    pub fn new(receiver: R) -> Self {
        Self(Arc::new((Mutex::new(receiver), Undelivered::default())))
    }

    /// Waits until [`Self::take`] has something to return, at most for these seconds.
    pub fn ready<'py>(&self, py: Python<'py>, timeout: Option<f64>) -> PyResult<Bound<'py, PyAny>> {
        let (this, timeout) = (self.clone(), timeout.map(seconds).transpose()?);
        awaitable(py, async move {
            // It is taken, or not, by what is in the slot then.
            _ = tokio::time::timeout(timeout.unwrap_or(Duration::MAX), this.fill()).await;
            Ok(())
        })
    }

    async fn fill(&self) {
        let (receiver, slot) = &*self.0;
        // Others that wait find the slot full.
        let mut receiver = receiver.lock().await;
        if !is_full(slot) {
            let received = receiver.receive().await;
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(received);
        }
    }

    /// Returns what was received, in a list of one; `None` in it is the end. The list is empty if
    /// nothing has arrived.
    pub fn take(&self) -> PyResult<Vec<Option<R::Received>>> {
        let received = self.0.1.lock().unwrap_or_else(PoisonError::into_inner).take();
        Ok(received.transpose()?.into_iter().collect())
    }
}

fn is_full<T>(slot: &Undelivered<T>) -> bool {
    slot.lock().unwrap_or_else(PoisonError::into_inner).is_some()
}
