//! Options shared by all commands.

use std::path::PathBuf;

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
    pub fn client(&self) -> anyhow::Result<Client> {
        let path = match &self.socket {
            Some(path) => path.clone(),
            None => folders::admin_socket_for_commands()?,
        };
        Ok(Client::connect(&path)?)
    }
}
