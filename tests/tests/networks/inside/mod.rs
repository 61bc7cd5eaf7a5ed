//! A tokio runtime in a network namespace, for tests that run daemons and nodes in their own
//! process.

use anyhow::Result;
use gdp_tests::netns::Namespace;
use tokio::runtime::Runtime;

pub const ROOT: libc::uid_t = 0;

/// A runtime whose threads are in a namespace.
pub struct Inside {
    pub runtime: Runtime,
}

impl Inside {
    /// Starts the runtime. `user`: the user id of its threads.
    pub fn new(namespace: &Namespace, user: libc::uid_t) -> Result<Self> {
        let door = namespace.door()?;
        let enter = move || {
            // A runtime thread stays inside until it ends.
            std::mem::forget(door.enter().expect("a namespace that is there"));
            // SAFETY: the arguments are three numbers. The raw system call changes this thread;
            // libc's function changes all threads.
            let changed = unsafe { libc::syscall(libc::SYS_setresuid, user, user, user) };
            assert_eq!(changed, 0, "a thread of root can become anybody's");
        };
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        Ok(Self { runtime: builder.worker_threads(1).enable_all().on_thread_start(enter).build()? })
    }

    /// Runs a future on a runtime thread. `block_on` alone would stay on the calling thread, whose
    /// sockets belong to another namespace.
    pub fn run<T: Send + 'static>(&self, future: impl Future<Output = T> + Send + 'static) -> Result<T> {
        Ok(self.runtime.block_on(self.runtime.spawn(future))?)
    }
}
