//! The one file that the robot needs from the edge: the robot's key and certificates, for this test
//! alone. Nothing in it is trusted before [`RobotFile::read`] has checked it.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};

use super::echo::TOPICS;
use super::nic::{MachineFacts, clean};

/// The version of the format, and of what both machines do.
const VERSION: u64 = 1;

/// No file is longer, in bytes; nor is one of those in it.
const MOST_BYTES: u64 = 64 << 10;
const MOST_BYTES_EACH: usize = 8 << 10;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotFile {
    version: u64,
    /// The name of the edge's switch, 64 hex digits.
    pub switch: String,
    pub edge: MachineFacts,
    /// What forwards at the edge's interface, as `gdp-ctl status` names it.
    pub data_plane: String,
    /// Files of the robot's proxy by name. Exactly those of [`names`].
    files: BTreeMap<String, String>,
}

/// The names of the files of the robot's proxy.
fn names() -> impl Iterator<Item = String> {
    let of_topics = TOPICS.iter().flat_map(|topic| ["card", "cert"].map(|kind| format!("{}.{kind}", topic.stem())));
    ["key.pem".to_owned()].into_iter().chain(of_topics)
}

impl RobotFile {
    /// Collects the files from the folder of the robot's proxy.
    pub fn collect(folder: &Path, switch: &str, edge: MachineFacts, data_plane: &str) -> Result<Self> {
        let read = |name: String| {
            let text = fs::read_to_string(folder.join(&name)).with_context(|| format!("cannot read {name}"))?;
            Ok((name, text))
        };
        let files = names().map(read).collect::<Result<_>>()?;
        Ok(Self { version: VERSION, switch: switch.to_owned(), edge, data_plane: clean(data_plane, 40), files })
    }

    /// Writes the file, which only its owner may read.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_private(path, &serde_json::to_string_pretty(self)?)
    }

    /// Reads and checks a file that may be anything.
    pub fn read(path: &Path) -> Result<Self> {
        let shown = path.display();
        let cannot = || format!("cannot read {shown}: copy it from the edge, where `field-report serve` wrote it");
        // A named pipe would block.
        ensure!(fs::metadata(path).with_context(cannot)?.is_file(), "{shown} is not a file");
        let mut bytes = Vec::new();
        File::open(path).with_context(cannot)?.take(MOST_BYTES + 1).read_to_end(&mut bytes).with_context(cannot)?;
        ensure!(bytes.len() as u64 <= MOST_BYTES, "{shown} is longer than a file of `field-report serve` can be");
        let parsed = parse(&bytes).with_context(|| format!("{shown} is not a file of `field-report serve`"))?;
        Ok(Self { edge: parsed.edge.clean(), data_plane: clean(&parsed.data_plane, 40), ..parsed })
    }

    /// Writes the proxy's files into a folder.
    pub fn unpack(&self, folder: &Path) -> Result<()> {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        names().try_for_each(|name| write_private(&folder.join(&name), &self.files[&name]))
    }
}

/// Errors quote what the file contains, so they are cleaned.
fn parse(bytes: &[u8]) -> Result<RobotFile> {
    #[derive(Deserialize)]
    struct OnlyVersion {
        version: u64,
    }
    let cleaned = |error: serde_json::Error| anyhow::anyhow!(clean(&error.to_string(), 200));
    let OnlyVersion { version } = serde_json::from_slice(bytes).map_err(cleaned)?;
    if version != VERSION {
        bail!("it has version {version}, and this tree has {VERSION}: use the same commit on both machines");
    }
    let parsed: RobotFile = serde_json::from_slice(bytes).map_err(cleaned)?;
    let is_name = parsed.switch.len() == 64 && parsed.switch.bytes().all(|byte| byte.is_ascii_hexdigit());
    ensure!(is_name, "`switch` is not a name of 64 hex digits");
    for name in names() {
        let content = parsed.files.get(&name).with_context(|| format!("`files` has no {name}"))?;
        let is_text = content.bytes().all(|byte| byte.is_ascii_graphic() || b" \n".contains(&byte));
        ensure!(is_text && content.len() <= MOST_BYTES_EACH, "{name} is not what `gdp-ctl` writes");
    }
    ensure!(parsed.files.len() == names().count(), "`files` has further ones");
    Ok(parsed)
}

fn write_private(path: &Path, text: &str) -> Result<()> {
    let write = || {
        // A file that exists would keep its permissions.
        if let Err(error) = fs::remove_file(path)
            && error.kind() != std::io::ErrorKind::NotFound
        {
            return Err(error);
        }
        OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?.write_all(text.as_bytes())
    };
    write().with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
#[path = "../../tests/unit/field_report/robot_file.rs"]
mod tests;
