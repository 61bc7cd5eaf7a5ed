//! Options shared by all commands.

use std::path::{Path, PathBuf};

use gdp_util::folders;

use super::output::Output;
use crate::client::Client;

/// The daemon's socket, and the output format.
#[derive(Clone)]
pub struct Context {
    pub socket: Option<PathBuf>,
    pub output: Output,
}

impl Context {
    /// Connects to the proxy of this machine.
    pub fn proxy(&self, socket: Option<&Path>) -> anyhow::Result<Client> {
        let path = socket.map_or_else(folders::proxy_socket, |path| Ok(path.into()))?;
        Ok(Client::connect(&path)?)
    }

    /// Whether this machine has a socket of a proxy and none of a daemon.
    pub fn has_only_proxy(&self) -> bool {
        let exists = |path: Result<PathBuf, _>| path.is_ok_and(|path: PathBuf| path.exists());
        self.socket.is_none() && !exists(folders::admin_socket()) && exists(folders::proxy_socket())
    }

    pub fn client(&self) -> anyhow::Result<Client> {
        let path = match &self.socket {
            Some(path) => path.clone(),
            None => folders::admin_socket_for_commands()?,
        };
        Ok(Client::connect(&path)?)
    }
}
