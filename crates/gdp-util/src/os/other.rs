//! Files of Windows. Who can access one is inherited from its folder, and not looked at here.

use std::fs::{File, Metadata, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Returns whether this process runs as root.
pub fn is_root() -> bool {
    false
}

/// Returns `None`: users have no numbers here.
pub fn user() -> Option<u32> {
    None
}

/// Returns `None`: users have no numbers here.
pub fn owner(_: &Metadata) -> Option<u32> {
    None
}

/// Returns false: pipes have no paths among those of files.
pub fn is_pipe(_: &Metadata) -> bool {
    false
}

/// Opens a file for reading.
pub fn open_for_reading(path: &Path) -> io::Result<File> {
    File::open(path)
}

/// Creates a file for writing, which those can access that its folder allows. Fails if it exists.
pub fn create_private(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create_new(true).open(path)
}

/// Creates a folder, and those above it, which those can access that the folder above allows.
pub fn create_private_folder(path: &Path) -> io::Result<()> {
    std::fs::create_dir_all(path)
}

/// Returns the mode of a file. `None` where files have none.
pub fn mode(_: &Metadata) -> Option<u32> {
    None
}

/// What tells a replaced file from the one before, if size and time are the same: when it was
/// created.
pub type FileIdentity = Option<SystemTime>;

/// Returns the identity of a file.
pub fn identity(metadata: &Metadata) -> FileIdentity {
    metadata.created().ok()
}

/// Does nothing: a folder cannot be opened here.
pub fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

/// Does nothing: files belong to the user that makes them.
pub fn give_to_owner_of(_: &Path, _: &File) -> io::Result<()> {
    Ok(())
}

/// Returns the folder below which programs have their configurations.
pub fn configuration_base() -> Option<PathBuf> {
    absolute("APPDATA")
}

/// Returns the folder below which programs have their state.
pub fn state_base() -> Option<PathBuf> {
    absolute("LOCALAPPDATA")
}

/// Returns the folder below which programs have their sockets.
pub fn runtime_base() -> Option<PathBuf> {
    None
}

fn absolute(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}
