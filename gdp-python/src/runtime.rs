//! The runtime of sessions, and the results that it brings to asyncio.
//!
//! A thread that holds Python's lock while Python ends aborts the process. So [`finish`], which
//! Python calls at its exit, waits for the results under way, and nothing follows them.

use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;
use pyo3_async_runtimes::generic::{self, ContextExt, Runtime};
use pyo3_async_runtimes::{TaskLocals, tokio::get_runtime};
use tokio::task::{JoinError, JoinHandle};

/// Longest time for results to arrive at the exit.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Number of results under way.
static UNDER_WAY: Mutex<usize> = Mutex::new(0);
/// A result has arrived.
static ARRIVED: Condvar = Condvar::new();
/// Python ends: no further result may begin.
static ENDING: AtomicBool = AtomicBool::new(false);

tokio::task_local! {
    static LOCALS: TaskLocals;
}

struct SdkRuntime;

impl Runtime for SdkRuntime {
    type JoinError = JoinError;
    type JoinHandle = JoinHandle<()>;

    fn spawn<F: Future<Output = ()> + Send + 'static>(future: F) -> JoinHandle<()> {
        get_runtime().spawn(future)
    }

    /// Brings a result to Python.
    fn spawn_blocking<F: FnOnce() + Send + 'static>(deliver: F) -> JoinHandle<()> {
        count(1);
        get_runtime().spawn_blocking(move || {
            let _counted = Counted;
            if !ENDING.load(Ordering::SeqCst) {
                deliver();
            }
        })
    }
}

impl ContextExt for SdkRuntime {
    fn scope<F, R>(locals: TaskLocals, future: F) -> Pin<Box<dyn Future<Output = R> + Send>>
    where
        F: Future<Output = R> + Send + 'static,
    {
        Box::pin(LOCALS.scope(locals, future))
    }

    fn get_task_locals() -> Option<TaskLocals> {
        LOCALS.try_with(Clone::clone).ok()
    }
}

/// A result under way, until it is dropped.
struct Counted;

impl Drop for Counted {
    fn drop(&mut self) {
        count(-1);
    }
}

fn count(by: isize) {
    let mut under_way = UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner);
    *under_way = under_way.saturating_add_signed(by);
    ARRIVED.notify_all();
}

/// Returns an awaitable of asyncio for a future.
pub fn awaitable<F, T>(py: Python<'_>, future: F) -> PyResult<Bound<'_, PyAny>>
where
    F: Future<Output = PyResult<T>> + Send + 'static,
    T: for<'py> IntoPyObject<'py> + Send + 'static,
{
    generic::future_into_py::<SdkRuntime, _, T>(py, future)
}

/// Waits for the results under way. Python calls it at its exit.
#[pyfunction]
pub fn finish(py: Python<'_>) {
    py.detach(|| {
        ENDING.store(true, Ordering::SeqCst);
        let under_way = UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner);
        drop(ARRIVED.wait_timeout_while(under_way, TIMEOUT, |under_way| *under_way > 0));
    });
}
