//! `gdp-ctl admin`: backup and restoration of a domain, and the log of what was issued and revoked.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Subcommand;
use gdp_core::cbor;
use gdp_core::secret_file;
use gdp_util::date::relative;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Home, HomeOptions, rotate};
use crate::cli::context::Context;

/// Maximum size of a backup, in bytes.
const MAX_BACKUP: usize = 64 << 20;

/// Maximum size of the log that is shown, in bytes.
const MAX_LOG: u64 = 16 << 20;

const VERSION: u8 = 1;

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write the whole domain to one file: keys, ledger, members and configuration.
    #[command(after_help = "The file holds the domain's key. Store it offline, as you would the key.")]
    Backup {
        /// New file, mode 0600.
        file: PathBuf,
        #[command(flatten)]
        home: HomeOptions,
    },
    /// Make the folder of a domain from a backup. Then run `gdp-ctl up`.
    Restore {
        /// Backup file.
        file: PathBuf,
        #[command(flatten)]
        home: HomeOptions,
    },
    /// Replace the domain's key by its successor.
    #[command(after_help = "Without the successor's key there is no rotation: make a new domain.")]
    Rotate(rotate::Options),
    /// Show what was issued and revoked, when and by whom.
    Log {
        #[command(flatten)]
        home: HomeOptions,
    },
}

/// A backup: the files of the folder by their relative paths.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Backup {
    version: u8,
    files: BTreeMap<String, Content>,
}

#[derive(Serialize, Deserialize)]
struct Content(#[serde(with = "gdp_core::cbor::bytes")] Vec<u8>);

/// Output of `gdp-ctl admin backup` and `restore`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct BackupOutput {
    file: PathBuf,
    folder: PathBuf,
    /// Number of files.
    files: usize,
}

/// Output of `gdp-ctl admin log`, and one line of the file.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
pub struct LogOutput {
    /// Unix seconds.
    time: u64,
    /// User of the machine who ran the command.
    user: String,
    /// `invite`, `enroll`, `deny`, `revoke`, `rotate`, `retire` or `restore`.
    action: String,
    label: String,
    /// Serials of the certificates. Text, because JavaScript and jq round such numbers.
    serials: Vec<String>,
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Backup { file, home } => backup(&file, &home.home()?, context),
        Command::Restore { file, home } => restore(&file, &home.home()?, context),
        Command::Rotate(options) => rotate::run(&options, context),
        Command::Log { home } => log(&home.home()?, context),
    }
}

fn backup(file: &Path, home: &Home, context: &Context) -> anyhow::Result<()> {
    // Locked, so that no other command issues anything meanwhile.
    let _ledger = home.ledger()?;
    if file.exists() {
        bail!("{}: a file of this name exists and is not overwritten", file.display());
    }
    let mut files = BTreeMap::new();
    gather(home.folder(), home.folder(), &mut files)?;
    let count = files.len();
    let bytes = cbor::encode(&Backup { version: VERSION, files })?;
    if bytes.len() > MAX_BACKUP {
        bail!("{} has {} bytes, and a backup at most {MAX_BACKUP}", home.folder().display(), bytes.len());
    }
    secret_file::replace(file, &bytes)?;
    print_backup(file, home, count, "saved in", context)
}

fn restore(file: &Path, home: &Home, context: &Context) -> anyhow::Result<()> {
    if home.path("domain.card").exists() || home.path("domain.pem").exists() {
        bail!("{} has a domain already; move it away, or say where with --dir", home.folder().display());
    }
    let bytes = secret_file::read(file, MAX_BACKUP)?;
    let backup: Backup = cbor::decode(&bytes, MAX_BACKUP).with_context(|| format!("{}: no backup", file.display()))?;
    if backup.version != VERSION {
        bail!("{}: a backup of version {}, which this release does not know", file.display(), backup.version);
    }
    let is_inside =
        |path: &str| Path::new(path).components().all(|part| matches!(part, std::path::Component::Normal(_)));
    if let Some(path) = backup.files.keys().find(|path| !is_inside(path)) {
        bail!("{}: the backup has a file outside of its folder: {path}", file.display());
    }
    // Key and card come last: without them, an interrupted restoration can be repeated.
    let (last, others): (Vec<_>, Vec<_>) =
        backup.files.iter().partition(|(path, _)| ["domain.pem", "domain.card"].contains(&path.as_str()));
    for (path, Content(content)) in others.into_iter().chain(last.into_iter().rev()) {
        let path = home.path(path);
        let folder = path.parent().unwrap_or(home.folder());
        gdp_util::ownership::create(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        secret_file::replace(&path, content)?;
    }
    home.record("restore", "", &[])?;
    note("gdp-ctl: what was revoked after the backup is a member again: revoke it once more");
    print_backup(file, home, backup.files.len(), "restored from", context)
}

fn print_backup(file: &Path, home: &Home, files: usize, verb: &str, context: &Context) -> anyhow::Result<()> {
    let output = BackupOutput { file: file.into(), folder: home.folder().into(), files };
    context
        .output
        .print(&output, || [format!("{files} files of {} {verb} {}", home.folder().display(), file.display())])
}

fn gather(root: &Path, folder: &Path, files: &mut BTreeMap<String, Content>) -> anyhow::Result<()> {
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let kind = fs::symlink_metadata(&path)?.file_type();
        if kind.is_dir() {
            gather(root, &path, files)?;
        } else if kind.is_file() {
            let content = fs::read(&path).with_context(|| path.display().to_string())?;
            let name = path.strip_prefix(root)?.to_str().with_context(|| format!("{}: not UTF-8", path.display()))?;
            files.insert(name.to_owned(), Content(content));
        }
    }
    Ok(())
}

fn log(home: &Home, context: &Context) -> anyhow::Result<()> {
    let path = home.path("audit.log");
    let mut text = String::new();
    match fs::File::open(&path) {
        Ok(file) => file.take(MAX_LOG).read_to_string(&mut text).with_context(|| path.display().to_string())?,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            bail!("nothing was issued in {}", home.folder().display())
        }
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    for line in text.lines() {
        let entry: LogOutput = serde_json::from_str(line).with_context(|| format!("{}: not a log", path.display()))?;
        let when = relative(entry.time, unix_seconds());
        context.output.print(&entry, || {
            [format!("{when}  {}  {}  {}  {}", entry.user, entry.action, entry.label, entry.serials.join(" "))]
        })?;
    }
    Ok(())
}

impl Home {
    /// Appends a line to the log of what was issued and revoked.
    pub(super) fn record(&self, action: &str, label: &str, serials: &[u64]) -> anyhow::Result<()> {
        let user = ["SUDO_USER", "USER"].into_iter().find_map(|name| std::env::var(name).ok());
        let entry = LogOutput {
            time: unix_seconds(),
            user: user.unwrap_or_else(|| "unknown".into()),
            action: action.into(),
            label: label.into(),
            serials: serials.iter().map(u64::to_string).collect(),
        };
        let path = self.path("audit.log");
        let mut file = fs::OpenOptions::new()
            .append(true)
            .create(true)
            .mode(0o600)
            .custom_flags(libc::O_NOFOLLOW)
            .open(&path)
            .with_context(|| path.display().to_string())?;
        let line = serde_json::to_string(&entry)? + "\n";
        file.write_all(line.as_bytes()).and_then(|()| file.sync_all()).with_context(|| path.display().to_string())
    }
}
