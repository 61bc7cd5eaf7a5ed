//! Events of the kernel about the folders of watched files.

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ::inotify::{EventMask, EventOwned, EventStream, Inotify, WatchDescriptor, WatchMask, Watches};
use futures_util::StreamExt as _;

/// Interval between two polls of every file, because some changes cause no event.
pub const POLL_INTERVAL: Duration = Duration::from_secs(5);

/// The folders that inotify watches. If the kernel provides no inotify instance, only polling
/// detects changes.
pub struct Folders {
    events: Option<(EventStream<[u8; 4096]>, Watches)>,
    watched: HashMap<PathBuf, WatchDescriptor>,
    /// The names of the files.
    names: HashSet<OsString>,
}

impl Folders {
    pub fn new() -> Self {
        let events = Inotify::init().and_then(|inotify| {
            let watches = inotify.watches();
            Ok((inotify.into_event_stream([0; 4096])?, watches))
        });
        Self { events: events.ok(), watched: HashMap::new(), names: HashSet::new() }
    }

    /// Watches exactly the folders of these files.
    pub fn follow<'a>(&mut self, files: impl Iterator<Item = &'a PathBuf> + Clone) {
        let Some((_, watches)) = &mut self.events else { return };
        self.names = files.clone().filter_map(|file| file.file_name()).map(OsString::from).collect();
        let wanted: HashSet<&Path> = files.map(|file| folder_of(file)).collect();
        for (_, descriptor) in self.watched.extract_if(|folder, _| !wanted.contains(folder.as_path())) {
            // The kernel has already removed the watch of a deleted folder.
            let _ = watches.remove(descriptor);
        }
        let mask = WatchMask::CLOSE_WRITE
            | WatchMask::MOVE
            | WatchMask::CREATE
            | WatchMask::DELETE
            | WatchMask::ATTRIB
            | WatchMask::DELETE_SELF
            | WatchMask::MOVE_SELF
            | WatchMask::ONLYDIR;
        for folder in wanted {
            if !self.watched.contains_key(folder)
                && let Ok(descriptor) = watches.add(folder, mask)
            {
                self.watched.insert(folder.to_owned(), descriptor);
            }
        }
    }

    /// Waits for an event of one of the files, or of a folder itself. This function is cancel-safe.
    pub async fn event(&mut self) {
        while !self.next().await {}
    }

    /// Waits for an event in one of the folders. Returns whether it may concern a file.
    async fn next(&mut self) -> bool {
        let Some((stream, _)) = &mut self.events else { return std::future::pending().await };
        match stream.next().await {
            Some(Ok(EventOwned { name: Some(name), .. })) => self.names.contains(&name),
            Some(Ok(EventOwned { wd, mask, .. })) => {
                let is_gone = mask.intersects(EventMask::IGNORED | EventMask::DELETE_SELF | EventMask::MOVE_SELF);
                if is_gone {
                    self.watched.retain(|_, watched| *watched != wd);
                }
                true
            }
            Some(Err(_)) | None => {
                self.events = None;
                self.watched.clear();
                true
            }
        }
    }
}

fn folder_of(file: &Path) -> &Path {
    match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}
