//! Gives what root creates in another user's folder to that user, so that its programs can use it.

use std::os::fd::AsRawFd as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, fchown, lchown};
use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::os::is_root;

/// Creates a folder as `create_dir_all` does. What root creates inside another user's folder
/// belongs to that user, so that its programs can use it.
pub fn create(folder: &Path) -> io::Result<()> {
    let missing: Vec<_> =
        folder.ancestors().take_while(|path| !path.as_os_str().is_empty() && !path.exists()).collect();
    fs::create_dir_all(folder)?;
    missing.into_iter().rev().try_for_each(give_to_owner_above)
}

/// Gives a file or folder to the owner of the folder that it is in, if this process is root and
/// that owner is not. It does not follow a symbolic link.
pub fn give_to_owner_above(path: &Path) -> io::Result<()> {
    let owner = above(path).metadata()?;
    match is_root() && owner.uid() != 0 {
        true => lchown(path, Some(owner.uid()), Some(owner.gid())),
        false => Ok(()),
    }
}

/// Gives the open file at `path` to the owner of the folder that it is in, as
/// [`give_to_owner_above`] does, whatever the path means now.
pub fn give_file(file: &fs::File, path: &Path) -> io::Result<()> {
    let owner = above(path).metadata()?;
    match is_root() && owner.uid() != 0 {
        true => fchown(file, Some(owner.uid()), Some(owner.gid())),
        false => Ok(()),
    }
}

/// Returns whether this process is root and another user could have put a link at `path`.
pub fn is_foreign_link(path: &Path) -> bool {
    let is_foreign = above(path).metadata().is_ok_and(|above| above.uid() != 0);
    is_root() && is_foreign && path.symlink_metadata().is_ok_and(|found| found.is_symlink())
}

/// Gives `folder` and all below it to the owner of the folder above, if this process is root and
/// that owner is not.
///
/// Files named in `except` stay as they are.
/// That owner may put links into the folder meanwhile. So each owner is set by an open file, links
/// are not followed, and a file with two names is left out.
pub fn give_all(folder: &Path, except: &[&str]) -> io::Result<()> {
    let owner = above(folder).metadata()?;
    if !is_root() || owner.uid() == 0 {
        return Ok(());
    }
    give_opened(folder, except, (owner.uid(), owner.gid()))
}

fn give_opened(path: &Path, except: &[&str], owner: (u32, u32)) -> io::Result<()> {
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK | libc::O_CLOEXEC;
    let opened = match fs::OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Ok(opened) => opened,
        // A link, or a socket.
        Err(error) if matches!(error.raw_os_error(), Some(libc::ELOOP | libc::ENXIO)) => return Ok(()),
        Err(error) => return Err(error),
    };
    let found = opened.metadata()?;
    if found.is_dir() {
        // Goes by the open folder, whatever its name means now.
        let inside = PathBuf::from(format!("/proc/self/fd/{}", opened.as_raw_fd()));
        for entry in fs::read_dir(&inside)? {
            let name = entry?.file_name();
            if !except.iter().any(|kept| name == *kept) {
                give_opened(&inside.join(name), except, owner)?;
            }
        }
    }
    match found.is_dir() || found.is_file() && found.nlink() == 1 {
        true => fchown(&opened, Some(owner.0), Some(owner.1)),
        false => Ok(()),
    }
}

fn above(path: &Path) -> &Path {
    path.parent().filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
#[path = "../tests/unit/ownership.rs"]
mod tests;
