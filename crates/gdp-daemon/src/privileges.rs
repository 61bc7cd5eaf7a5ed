//! Drops privileges at start: all capabilities except those of a switch. First does what needs
//! more.

use std::ffi::CString;
use std::io;
use std::net::SocketAddr;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use gdp_dataplane::capabilities::{self, Capability};
use gdp_dataplane::{device, pins};

use crate::config::{Config, DataPlane};
use gdp_util::os;

/// The first port that needs no CAP_NET_BIND_SERVICE, with the default of
/// `net.ipv4.ip_unprivileged_port_start`.
const FIRST_UNPRIVILEGED_PORT: u16 = 1024;

#[derive(Debug, thiserror::Error)]
pub enum PrivilegesError {
    #[error("cannot give up the capabilities that a switch does not need: {0}")]
    Kernel(#[from] io::Error),
    #[error(
        "{} belongs to user {owner}, and the daemon gives up root's right to other users' files: `chown root {}`, or \
         run it \
         as that user with the capabilities", path.display(), path.display()
    )]
    OfAnother { path: PathBuf, owner: u32 },
}

/// Drops all capabilities except those of a switch, and sets `no_new_privs`.
///
/// The caller must be the only thread. A daemon with DPDK keeps its capabilities, for its devices
/// and huge pages.
pub fn restrict(config: &Config) -> Result<(), PrivilegesError> {
    if config.data_plane == DataPlane::Dpdk {
        return Ok(());
    }
    if let (DataPlane::Auto | DataPlane::Xdp, Some(bpffs)) = (config.data_plane, &config.bpffs)
        && capabilities::missing(&capabilities::XDP).is_empty()
    {
        // If the mount fails, the first use of the file system reports it.
        let _ = pins::mount(bpffs);
    }
    device::remember_programs();
    capabilities::keep_only(&needed(config))?;
    files(config).try_for_each(|(path, mode)| check(path, mode))
}

fn needed(config: &Config) -> Vec<Capability> {
    let is_low = |addr: SocketAddr| (1..FIRST_UNPRIVILEGED_PORT).contains(&addr.port());
    let low_port = [config.udp, config.tls].into_iter().flatten().any(is_low);
    capabilities::SWITCH.into_iter().chain(low_port.then_some(capabilities::NET_BIND_SERVICE)).collect()
}

/// Returns the files that the daemon reads, and the folders that it writes, with the access mode.
fn files(config: &Config) -> impl Iterator<Item = (&Path, libc::c_int)> {
    let domain = config.domain.iter().flat_map(|domain| {
        let files = &domain.files;
        [&files.card, &files.membership].into_iter().chain(&files.peers)
    });
    let read = [&config.identity].into_iter().chain(&config.ebpf_object).chain(domain);
    let folders = [&config.identity, &config.socket].into_iter().filter_map(|file| file.parent());
    read.map(|path| (path.as_path(), libc::R_OK)).chain(folders.map(|folder| (folder, libc::W_OK | libc::X_OK)))
}

/// Checks that this process still has the access `mode` to a file. Fails only where root's rights
/// sufficed before.
fn check(path: &Path, mode: libc::c_int) -> Result<(), PrivilegesError> {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    let above = |mode| path.parent().map_or(Ok(()), |folder| check(folder, mode));
    let refused = access(path, mode).map_err(|error| error.kind());
    match (refused, path.metadata()) {
        (Err(io::ErrorKind::NotFound), _) if mode & libc::W_OK != 0 => above(mode),
        (Err(io::ErrorKind::PermissionDenied), Err(_)) => above(libc::X_OK),
        (Err(io::ErrorKind::PermissionDenied), Ok(found)) if os::is_root() && found.uid() != 0 => {
            Err(PrivilegesError::OfAnother { path: path.to_owned(), owner: found.uid() })
        }
        _ => Ok(()),
    }
}

fn access(path: &Path, mode: libc::c_int) -> io::Result<()> {
    let path = CString::new(path.as_os_str().as_bytes())?;
    // SAFETY: a C string that outlives the call.
    match unsafe { libc::access(path.as_ptr(), mode) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}
