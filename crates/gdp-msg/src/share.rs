//! Loads definitions from the folders that ROS installs: `share/PACKAGE/msg/*.msg`, and likewise
//! `srv` and `action`, for both generations of ROS.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::definition::MAX_TEXT;
use crate::dialect::Dialect;
use crate::name::{InterfaceKind, TypeName};
use crate::registry::{AddError, Registry};

/// Maximum number of entries in one folder. The share folder of a full desktop installation has a
/// few hundred.
const MAX_ENTRIES: usize = 10_000;

/// The reason why definitions were not loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    #[error("cannot read {path}: {error}")]
    Io { path: PathBuf, error: io::Error },
    #[error("{0} has more than {MAX_ENTRIES} entries: give the folders of single packages")]
    TooMany(PathBuf),
    #[error(
        "{0} is no path of a definition: PACKAGE/msg/Type.msg, PACKAGE/srv/Type.srv and PACKAGE/action/Type.action are"
    )]
    Path(PathBuf),
    #[error("{path}: {error}")]
    Definition { path: PathBuf, error: AddError },
}

/// The result of loading a folder.
#[derive(Default, Debug)]
pub struct Loaded {
    /// Number of files whose definitions were added.
    pub files: usize,
    /// Files that were refused, with the reasons. A mistake in one package does not affect the
    /// others.
    pub refused: Vec<LoadError>,
}

impl Registry {
    /// Loads all packages of a share folder, such as `/opt/ros/jazzy/share`. Ignores other files,
    /// including `.idl` files.
    ///
    /// # Errors
    /// If a folder cannot be read, or has too many entries.
    pub fn load_share(&mut self, dialect: Dialect, folder: &Path) -> Result<Loaded, LoadError> {
        let mut loaded = Loaded::default();
        for package in entries(folder)? {
            if package.is_dir() {
                self.load_kinds(dialect, &package, &mut loaded)?;
            }
        }
        Ok(loaded)
    }

    /// Loads one package, such as `/opt/ros/jazzy/share/std_msgs`.
    ///
    /// # Errors
    /// If a folder cannot be read, or has too many entries.
    pub fn load_package(&mut self, dialect: Dialect, folder: &Path) -> Result<Loaded, LoadError> {
        let mut loaded = Loaded::default();
        entries(folder)?;
        self.load_kinds(dialect, folder, &mut loaded)?;
        Ok(loaded)
    }

    /// Loads one file. Its path gives package and type: `…/PACKAGE/msg/Type.msg`.
    ///
    /// # Errors
    /// If the file cannot be read, or is not a definition.
    pub fn load_file(&mut self, dialect: Dialect, file: &Path) -> Result<(), LoadError> {
        let refused = || LoadError::Path(file.to_owned());
        let part = |path: Option<&Path>| path?.file_name()?.to_str().map(str::to_owned);
        let kind = file.extension().and_then(|ending| kind(ending.to_str()?)).ok_or_else(refused)?;
        let folder = file.parent();
        let (Some(stem), Some(package), Some(folder)) =
            (file.file_stem().and_then(|stem| stem.to_str()), part(folder.and_then(Path::parent)), part(folder))
        else {
            return Err(refused());
        };
        if folder != kind.folder() {
            return Err(refused());
        }
        let name = TypeName::new(&package, kind, stem).map_err(|_| refused())?;
        let text = read(file).map_err(|error| LoadError::Io { path: file.to_owned(), error })?;
        let added = self.add_file(dialect, &name, &text);
        added.map_err(|error| LoadError::Definition { path: file.to_owned(), error })
    }

    fn load_kinds(&mut self, dialect: Dialect, package: &Path, loaded: &mut Loaded) -> Result<(), LoadError> {
        for kind in [InterfaceKind::Message, InterfaceKind::Service, InterfaceKind::Action] {
            let folder = package.join(kind.folder());
            if !folder.is_dir() {
                continue;
            }
            for file in entries(&folder)? {
                if file.extension().is_none_or(|ending| ending != kind.folder()) {
                    continue;
                }
                match self.load_file(dialect, &file) {
                    Ok(()) => loaded.files += 1,
                    Err(error) => loaded.refused.push(error),
                }
            }
        }
        Ok(())
    }
}

fn kind(ending: &str) -> Option<InterfaceKind> {
    [InterfaceKind::Message, InterfaceKind::Service, InterfaceKind::Action]
        .into_iter()
        .find(|kind| kind.folder() == ending)
}

/// Returns the sorted entries of a folder, so that loading does not depend on the file system's
/// order.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, LoadError> {
    let failed = |error| LoadError::Io { path: folder.to_owned(), error };
    let mut entries = Vec::new();
    for entry in folder.read_dir().map_err(failed)? {
        if entries.len() >= MAX_ENTRIES {
            return Err(LoadError::TooMany(folder.to_owned()));
        }
        entries.push(entry.map_err(failed)?.path());
    }
    entries.sort();
    Ok(entries)
}

/// Reads a file of at most [`MAX_TEXT`] bytes.
fn read(file: &Path) -> io::Result<String> {
    let mut text = Vec::new();
    File::open(file)?.take(MAX_TEXT as u64 + 1).read_to_end(&mut text)?;
    if text.len() > MAX_TEXT {
        return Err(io::Error::other(format!("it is longer than {MAX_TEXT} bytes")));
    }
    String::from_utf8(text).map_err(io::Error::other)
}
