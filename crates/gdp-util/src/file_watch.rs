//! Watches files that other programs replace while this one runs: certificates, configurations,
//! memberships.
//!
//! On Linux, one task watches the files' folders by inotify, so it also detects a replacement by
//! `rename`. It also polls every file, because a bind mount, a network file system or a link into
//! another folder sends no event. Events of other files in these folders do not count: programs
//! also write there. Other systems only poll.

#[cfg(target_os = "linux")]
mod inotify;
#[cfg(not(target_os = "linux"))]
mod polling;

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Weak};
use std::time::{Duration, SystemTime};

use futures_util::FutureExt as _;
use futures_util::future::select_all;
use parking_lot::Mutex;
use tokio::sync::{Notify, watch};
use tokio::task::AbortHandle;
use tokio::time::{Instant, sleep, sleep_until};

#[cfg(target_os = "linux")]
use self::inotify::{Folders, POLL_INTERVAL};
#[cfg(not(target_os = "linux"))]
use self::polling::{Folders, POLL_INTERVAL};
use crate::os;

/// Time to wait after an event. A file is often replaced in several steps, which count as one
/// change.
const SETTLE: Duration = Duration::from_millis(20);

/// Maximum number of events that count as one change.
const MOST_EVENTS: usize = 256;

/// Time without a change after which a set of files has changed. Before that, a program may still
/// be writing one of them.
const QUIET: Duration = Duration::from_millis(200);

/// The identity of a file's content. Another file or other content has another stamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileStamp {
    modified: SystemTime,
    length: u64,
    identity: os::FileIdentity,
}

impl FileStamp {
    /// Returns the stamp of a file, or `None` if it does not exist or is not accessible.
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        let identity = os::identity(&metadata);
        Some(Self { modified: metadata.modified().ok()?, length: metadata.len(), identity })
    }
}

/// Watches files. Clones share one task, which ends with the last clone.
#[derive(Clone)]
pub struct FileWatcher(Arc<Owner>);

struct Owner {
    shared: Arc<Shared>,
    task: AbortHandle,
}

#[derive(Default)]
struct Shared {
    files: Mutex<HashMap<PathBuf, Watched>>,
    /// Notified when a file was added, so that the task watches its folder.
    added: Notify,
}

struct Watched {
    stamp: Option<FileStamp>,
    changes: watch::Sender<()>,
}

/// One watched file. Dropping it ends the watch.
#[derive(Clone)]
pub struct WatchedFile {
    path: PathBuf,
    changes: watch::Receiver<()>,
}

impl FileWatcher {
    /// Starts a watcher without files. Must be called within a tokio runtime.
    pub fn start() -> Self {
        let shared = Arc::<Shared>::default();
        let task = tokio::spawn(run(Arc::downgrade(&shared))).abort_handle();
        Self(Arc::new(Owner { shared, task }))
    }

    /// Watches a file for changes from now on. The file need not exist.
    pub fn watch(&self, path: &Path) -> WatchedFile {
        let mut files = self.0.shared.files.lock();
        let begin = || Watched { stamp: FileStamp::of(path), changes: watch::Sender::new(()) };
        let watched = files.entry(path.to_owned()).or_insert_with(begin);
        self.0.shared.added.notify_one();
        WatchedFile { path: path.to_owned(), changes: watched.changes.subscribe() }
    }
}

/// A set of related files, such as a configuration and the files that it names. Dropping it ends
/// the watch.
pub struct FileSet {
    watcher: FileWatcher,
    /// The files, each with its stamp at the last reported change.
    files: Vec<(WatchedFile, Option<FileStamp>)>,
}

impl FileSet {
    /// Watches these files. Their current content counts as unchanged, so create the set before
    /// reading them.
    pub fn new<'a>(watcher: &FileWatcher, paths: impl IntoIterator<Item = &'a Path>) -> Self {
        let mut set = Self { watcher: watcher.clone(), files: Vec::new() };
        set.replace(paths);
        set
    }

    /// Replaces the files of the set. Unreported changes of files that stay in the set still count.
    pub fn replace<'a>(&mut self, paths: impl IntoIterator<Item = &'a Path>) {
        let known = std::mem::take(&mut self.files);
        for path in paths.into_iter().collect::<BTreeSet<_>>() {
            let same = known.iter().find(|(file, _)| file.path() == path);
            self.files.push(same.cloned().unwrap_or_else(|| {
                let file = self.watcher.watch(path);
                (file, FileStamp::of(path))
            }));
        }
    }

    /// Returns whether an existing file of the set has changed. A missing file does not count,
    /// because it may be about to be replaced.
    pub fn has_changed(&self) -> bool {
        self.files.iter().any(|(file, seen)| FileStamp::of(file.path()).is_some_and(|now| Some(now) != *seen))
    }

    /// Waits until [`Self::has_changed`] returns true and no file has changed for 200 ms. Reports
    /// each change once. This function is cancel-safe.
    pub async fn changed(&mut self) {
        loop {
            while !self.has_changed() {
                self.event().await;
            }
            let before = self.stamps();
            sleep(QUIET).await;
            if self.stamps() == before {
                break;
            }
        }
        for (file, seen) in &mut self.files {
            *seen = FileStamp::of(file.path());
        }
    }

    fn stamps(&self) -> Vec<Option<FileStamp>> {
        self.files.iter().map(|(file, _)| FileStamp::of(file.path())).collect()
    }

    /// Waits until the watcher has detected a change.
    async fn event(&mut self) {
        if self.files.is_empty() {
            return std::future::pending().await;
        }
        select_all(self.files.iter_mut().map(|(file, _)| Box::pin(file.changed()))).await;
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl WatchedFile {
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Waits until the file is replaced or its content changes. This function is cancel-safe.
    pub async fn changed(&mut self) {
        if self.changes.changed().await.is_err() {
            std::future::pending().await
        }
    }

    /// Returns whether the file has changed since the last call, without waiting.
    pub fn has_changed(&mut self) -> bool {
        let changed = self.changes.has_changed().unwrap_or(false);
        self.changes.mark_unchanged();
        changed
    }
}

async fn run(shared: Weak<Shared>) {
    let mut folders = Folders::new();
    let mut next_poll = Instant::now() + POLL_INTERVAL;
    loop {
        let Some(now) = shared.upgrade() else { return };
        folders.follow(now.files.lock().keys());
        tokio::select! {
            () = folders.event() => {
                sleep(SETTLE).await;
                // What else has happened meanwhile belongs to the same change.
                for _ in 0..MOST_EVENTS {
                    if folders.event().now_or_never().is_none() {
                        break;
                    }
                }
            }
            () = now.added.notified() => {}
            () = sleep_until(next_poll) => next_poll = Instant::now() + POLL_INTERVAL,
        }
        now.look();
    }
}

impl Shared {
    /// Polls every file, and removes those that have no watcher any more.
    fn look(&self) {
        let mut files = self.files.lock();
        files.retain(|_, watched| watched.changes.receiver_count() > 0);
        for (path, watched) in files.iter_mut() {
            let stamp = FileStamp::of(path);
            if stamp != watched.stamp {
                watched.stamp = stamp;
                watched.changes.send_replace(());
            }
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/file_watch.rs"]
mod tests;
