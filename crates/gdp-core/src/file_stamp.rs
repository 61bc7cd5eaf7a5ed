//! Whether a file is another than it was, without reading it.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::SystemTime;

/// Another file, or another content, has another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileStamp {
    modified: SystemTime,
    inode: u64,
    length: u64,
}

impl FileStamp {
    /// Of the file that is there now; `None` if there is none, or it cannot be asked for.
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        Some(Self { modified: metadata.modified().ok()?, inode: metadata.ino(), length: metadata.len() })
    }
}
