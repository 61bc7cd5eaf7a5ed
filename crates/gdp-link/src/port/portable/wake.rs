//! Events that wake a thread which waits for one of several.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, Thread};
use std::time::Duration;

use parking_lot::Mutex;

/// An event that one thread waits for.
#[derive(Debug, Default)]
pub struct WakeEvent {
    is_set: AtomicBool,
    /// The thread that waited last.
    waiter: Mutex<Option<Thread>>,
}

impl WakeEvent {
    /// Never fails here.
    pub fn new() -> io::Result<Self> {
        Ok(Self::default())
    }

    pub fn set(&self) {
        self.is_set.store(true, Ordering::Release);
        if let Some(waiter) = &*self.waiter.lock() {
            waiter.unpark();
        }
    }

    pub fn clear(&self) {
        self.is_set.store(false, Ordering::Relaxed);
    }

    /// Makes this thread the one that [`Self::set`] wakes.
    fn wait_here(&self) {
        let mut waiter = self.waiter.lock();
        if waiter.as_ref().is_none_or(|waiter| waiter.id() != thread::current().id()) {
            *waiter = Some(thread::current());
        }
    }
}

/// Waits until one of the events is set or the timeout expires. Clears all of them. May return
/// early.
pub fn wait_any<'a>(events: impl Iterator<Item = &'a WakeEvent> + Clone, timeout: Duration) {
    events.clone().for_each(WakeEvent::wait_here);
    // An event that is set after this look leaves a token, with which parking returns at once.
    if !events.clone().any(|event| event.is_set.load(Ordering::Acquire)) {
        thread::park_timeout(timeout);
    }
    events.for_each(WakeEvent::clear);
}
