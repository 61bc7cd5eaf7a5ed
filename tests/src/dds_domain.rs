//! DDS domains of tests. No two tests share one, also not those of processes that run at the same
//! time: their nodes would find each other.

use std::fs::{self, File};
use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::{Context, Result, bail};

/// The domains whose ports the system gives to no socket that wants any
/// (`net.ipv4.ip_local_port_range` begins at 32768, RTPS 2.5, 9.6.2.3).
const DOMAINS: std::ops::RangeInclusive<u16> = 1..=100;

/// The lock files of the domains of this process.
static LEASED: Mutex<Vec<File>> = Mutex::new(Vec::new());

/// Returns a DDS domain that only the caller uses, until this process ends.
///
/// # Panics
///
/// All domains are in use, or the folder of their lock files cannot be written.
pub fn lease() -> u16 {
    try_lease().expect("a DDS domain")
}

fn try_lease() -> Result<u16> {
    let mut leased = LEASED.lock().expect("no lease panics");
    let folder = folder();
    fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for id in DOMAINS {
        let path = folder.join(id.to_string());
        let file = File::create(&path).with_context(|| format!("cannot create {}", path.display()))?;
        if file.try_lock().is_ok() {
            leased.push(file);
            return Ok(id);
        }
    }
    bail!("tests that run now use all of the {} DDS domains: end some", DOMAINS.count())
}

/// The same for every user and checkout of this machine.
fn folder() -> PathBuf {
    std::env::temp_dir().join("gdp-dds-domains")
}
