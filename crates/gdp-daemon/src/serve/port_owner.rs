//! Finds the process that uses a UDP port, for the error about a port that is taken.

use std::fs;
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;

use super::start_error::StartError;

/// Checks that the UDP address is free. The daemon calls this before it changes an interface.
pub fn expect_free(addr: SocketAddr) -> Result<(), StartError> {
    match UdpSocket::bind(addr) {
        Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
            let owner = find(addr.port()).unwrap_or_else(|| "another process".into());
            Err(StartError::PortTaken { addr, owner })
        }
        // Opening the port reports any other failure.
        _ => Ok(()),
    }
}

/// Returns the process that has a socket on this port, such as `process 4711 (gdp-ctl)`. Finds only
/// processes that this user may examine.
fn find(port: u16) -> Option<String> {
    let tables = ["/proc/net/udp", "/proc/net/udp6"].map(|table| fs::read_to_string(table).unwrap_or_default());
    let inodes: Vec<&str> = tables.iter().flat_map(|table| sockets(table, port)).collect();
    let targets: Vec<String> = inodes.iter().map(|inode| format!("socket:[{inode}]")).collect();
    let is_target = |link: &Path| targets.iter().any(|target| link == Path::new(target));
    for process in fs::read_dir("/proc").ok()?.flatten() {
        let id = process.file_name();
        // Other entries, such as `self`, are no processes or are links to one.
        let Some(id) = id.to_str().filter(|id| id.bytes().all(|c| c.is_ascii_digit())) else { continue };
        let Ok(files) = fs::read_dir(process.path().join("fd")) else { continue };
        if files.flatten().any(|file| fs::read_link(file.path()).is_ok_and(|link| is_target(&link))) {
            let program = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            return Some(format!("process {id} ({})", program.trim()));
        }
    }
    None
}

/// Returns the inodes of the sockets on this local port in a table of the kernel.
fn sockets(table: &str, port: u16) -> impl Iterator<Item = &str> {
    let local = format!(":{port:04X}");
    table.lines().skip(1).filter_map(move |line| {
        let mut columns = line.split_ascii_whitespace();
        columns.nth(1).filter(|address| address.ends_with(&local))?;
        columns.nth(7)
    })
}

#[cfg(test)]
#[path = "../../tests/unit/serve/port_owner.rs"]
mod tests;
