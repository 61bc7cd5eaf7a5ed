//! Modes and owners of files on Unix, and the folders of the XDG base directory specification.

use std::fs::{DirBuilder, File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::{
    DirBuilderExt as _, FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _, fchown,
};
use std::path::{Path, PathBuf};

/// Returns the effective user of this process. `None` where users have no numbers.
pub fn user() -> Option<u32> {
    // SAFETY: geteuid has no preconditions and cannot fail.
    Some(unsafe { libc::geteuid() })
}

/// Returns whether this process runs as root.
pub fn is_root() -> bool {
    user() == Some(0)
}

/// Returns the user that a file belongs to. `None` where users have no numbers.
pub fn owner(metadata: &Metadata) -> Option<u32> {
    Some(metadata.uid())
}

/// Returns whether an open file is a pipe or a socket, which may never end.
pub fn is_pipe(metadata: &Metadata) -> bool {
    metadata.file_type().is_fifo() || metadata.file_type().is_socket()
}

/// Opens a file for reading. Opening a FIFO does not wait for a writer.
pub fn open_for_reading(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)
}

/// Creates a file for writing that only its owner can access. Fails if it exists.
pub fn create_private(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)
}

/// Creates a folder, and those above it, that only their owner can access.
pub fn create_private_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(path)
}

/// Returns the mode of a file. `None` where files have none.
pub fn mode(metadata: &Metadata) -> Option<u32> {
    Some(metadata.permissions().mode() & 0o7777)
}

/// What tells a replaced file from the one before, if size and time are the same: `ctime`, which
/// also changes with the permissions, and the inode.
pub type FileIdentity = (i64, i64, u64);

/// Returns the identity of a file.
pub fn identity(metadata: &Metadata) -> FileIdentity {
    (metadata.ctime(), metadata.ctime_nsec(), metadata.ino())
}

/// Writes the names of a folder to the disk, so that they last over a loss of power.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// Gives a file of root's to the owner of a folder, if that is another user.
pub fn give_to_owner_of(folder: &Path, file: &File) -> io::Result<()> {
    let (own, above) = (file.metadata()?, folder.metadata()?);
    match own.uid() == 0 && above.uid() != 0 {
        true => fchown(file, Some(above.uid()), Some(above.gid())),
        false => Ok(()),
    }
}

/// Returns the folder below which programs have their configurations.
pub fn configuration_base() -> Option<PathBuf> {
    absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")))
}

/// Returns the folder below which programs have their state.
pub fn state_base() -> Option<PathBuf> {
    absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")))
}

/// Returns the folder below which programs have their sockets.
pub fn runtime_base() -> Option<PathBuf> {
    absolute("XDG_RUNTIME_DIR")
}

/// Returns a variable's path if it is absolute. The XDG base directory specification says to ignore
/// relative paths.
fn absolute(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}
