//! Files that hold secrets. They are created with mode 0600 and never visible half-written or with
//! a wider mode. They belong to the owner of the folder, if root creates them. A file that others
//! than the owner can access is refused, and so is one of another user. They hold private keys and
//! the command line's state of a name; the caller defines the content.
//!
//! Windows has no modes: who can read a file there depends on its folder, and is not checked.

use gdp_util::os;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

#[derive(Debug, thiserror::Error)]
pub enum SecretFileError {
    #[error("{}: cannot {action}: {source}", path.display())]
    Io { path: PathBuf, action: &'static str, source: io::Error },
    #[error("{}: a file of this name exists and is not overwritten; choose another name or remove it", .0.display())]
    Exists(PathBuf),
    #[error("{}: not a regular file", .0.display())]
    NotAFile(PathBuf),
    #[error("{}: mode {mode:04o} lets others at a secret; run `chmod 600 {}`", path.display(), path.display())]
    TooOpen { path: PathBuf, mode: u32 },
    #[error(
        "{}: belongs to user {owner}, who can read and change it; if it is this machine's, run `chown {own} {}`",
        path.display(), path.display()
    )]
    OfAnother { path: PathBuf, owner: u32, own: u32 },
    #[error("{}: longer than {max} bytes, so not what it should be", path.display())]
    TooLong { path: PathBuf, max: usize },
    #[error("{}: {reason}", path.display())]
    Malformed { path: PathBuf, reason: String },
}

impl SecretFileError {
    pub fn is_not_found(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }

    /// Creates the error that the content of the file is malformed, for this reason.
    pub fn malformed(path: &Path, reason: impl ToString) -> Self {
        Self::Malformed { path: path.into(), reason: reason.to_string() }
    }
}

/// Creates `path` with `content`. The bytes are written and synced under a temporary name and then
/// linked to the final one, which fails if that exists. A reader of `path` thus sees the whole
/// content or no file.
pub(crate) fn create(path: &Path, content: &[u8]) -> Result<(), SecretFileError> {
    with_temporary(path, content, |temporary| {
        fs::hard_link(temporary, path).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => SecretFileError::Exists(path.into()),
            _ => SecretFileError::Io { path: path.into(), action: "create", source },
        })
    })
}

/// Creates a file as [`create`] does, but replaces an existing one. After a crash, either the old
/// or the new file exists in full.
pub fn replace(path: &Path, content: &[u8]) -> Result<(), SecretFileError> {
    let io = |action| move |source| SecretFileError::Io { path: path.into(), action, source };
    with_temporary(path, content, |temporary| {
        fs::rename(temporary, path).map_err(io("replace"))?;
        os::sync_folder(folder_of(path)).map_err(io("keep"))
    })
}

fn with_temporary(
    path: &Path,
    content: &[u8],
    place: impl FnOnce(&Path) -> Result<(), SecretFileError>,
) -> Result<(), SecretFileError> {
    let io = |source| SecretFileError::Io { path: path.into(), action: "create", source };
    let suffix = crate::crypto::random::<8>().map_err(|e| io(io::Error::other(e)))?;
    let mut file_name = path.file_name().ok_or_else(|| SecretFileError::NotAFile(path.into()))?.to_owned();
    file_name.push(format!(".{}.tmp", hex::encode(suffix)));
    let temporary = path.with_file_name(file_name);

    let written = os::create_private(&temporary).and_then(|mut file| {
        give_to_owner_of_folder(&file, path)?;
        file.write_all(content).and_then(|()| file.sync_all())
    });
    let result = written.map_err(io).and_then(|()| place(&temporary));
    // A failure needs no handling: the file has moved, was not created, or its name does not
    // matter.
    let _ = fs::remove_file(&temporary);
    result
}

/// Keys that admit members. They remain root's in another user's folder, because only commands of
/// root use them, and no running program.
pub const OF_ROOT: [&str; 3] = ["domain.pem", "domain.new", "successor.pem"];

/// Gives what root writes into another user's folder to that user, whose programs read it.
fn give_to_owner_of_folder(file: &File, path: &Path) -> io::Result<()> {
    if OF_ROOT.iter().any(|name| path.file_name() == Some(name.as_ref())) {
        return Ok(());
    }
    os::give_to_owner_of(folder_of(path), file)
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Returns the contents of a file as [`read`] does, or `None` if it does not exist.
pub fn read_optional(path: &Path, max: usize) -> Result<Option<Zeroizing<Vec<u8>>>, SecretFileError> {
    match read(path, max) {
        Err(error) if error.is_not_found() => Ok(None),
        result => result.map(Some),
    }
}

/// Reads the whole of `path`, at most `max` bytes. It follows a symbolic link and checks the
/// target.
pub fn read(path: &Path, max: usize) -> Result<Zeroizing<Vec<u8>>, SecretFileError> {
    let io = |action| move |source| SecretFileError::Io { path: path.into(), action, source };
    let file = os::open_for_reading(path).map_err(io("open"))?;
    check(path, &file)?;
    let mut content = Zeroizing::new(Vec::with_capacity(max + 1));
    file.take(max as u64 + 1).read_to_end(&mut content).map_err(io("read"))?;
    if content.len() > max {
        return Err(SecretFileError::TooLong { path: path.into(), max });
    }
    Ok(content)
}

/// Checks the open file instead of its name, so that nothing can be exchanged in between.
fn check(path: &Path, file: &File) -> Result<(), SecretFileError> {
    let metadata =
        file.metadata().map_err(|source| SecretFileError::Io { path: path.into(), action: "examine", source })?;
    if !metadata.is_file() {
        return Err(SecretFileError::NotAFile(path.into()));
    }
    if let Some(mode) = os::mode(&metadata).filter(|mode| mode & 0o077 != 0) {
        return Err(SecretFileError::TooOpen { path: path.into(), mode });
    }
    os::owner(&metadata).map_or(Ok(()), |owner| check_owner(path, owner))
}

/// Refuses a file of a user other than this process's and root. Root also reads what it may have
/// [given to the owner of the folder](give_to_owner_of_folder).
fn check_owner(path: &Path, owner: u32) -> Result<(), SecretFileError> {
    let Some(own) = os::user() else { return Ok(()) };
    let of_folder = || os::owner(&folder_of(&path.canonicalize().ok()?).metadata().ok()?);
    if [own, 0].contains(&owner) || own == 0 && of_folder() == Some(owner) {
        return Ok(());
    }
    Err(SecretFileError::OfAnother { path: path.into(), owner, own })
}

#[cfg(test)]
#[path = "../tests/unit/secret_file.rs"]
mod tests;
