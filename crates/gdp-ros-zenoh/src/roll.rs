//! The node tokens of a session: the node's own, and those of nodes that it stands for.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;

use crate::token::{Endpoint, Gid, Role, Token};
use crate::topic::Topic;

/// The nodes that this session shows.
pub struct Roll {
    session: zenoh::Session,
    domain: u32,
    /// Full name of the own node.
    own: String,
    nodes: Mutex<BTreeMap<String, OpenNode>>,
    next_id: AtomicU64,
}

struct OpenNode {
    id: u64,
    /// Endpoints of the node. The token ends with the last one.
    endpoints: usize,
    _token: LivelinessToken,
}

/// The token of an endpoint, which ends when it is dropped.
pub struct Announced {
    roll: Arc<Roll>,
    pub gid: Gid,
    node: String,
    _token: LivelinessToken,
}

impl Roll {
    pub fn new(session: zenoh::Session, domain: u32, own: &str) -> Self {
        let own = format!("/{own}");
        Self { session, domain, own, nodes: Mutex::default(), next_id: AtomicU64::new(1) }
    }

    pub fn session(&self) -> &zenoh::Session {
        &self.session
    }

    pub fn domain(&self) -> u32 {
        self.domain
    }

    /// Shows the own node until the end of the session.
    pub fn enter(&self) -> zenoh::Result<()> {
        self.join(&self.own).map(drop)
    }

    /// Announces an endpoint as one of the node with this full name, or of the own node if the name
    /// cannot be one.
    pub fn announce(self: &Arc<Self>, role: Role, topic: &Topic, node: &str) -> zenoh::Result<Announced> {
        let node = if is_node(node) { node } else { &self.own };
        let node_id = self.join(node)?;
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let Topic { name, kind, hash, qos } = topic.clone();
        let endpoint = Endpoint { name, kind, hash: Some(hash), qos };
        let token = Token { endpoint: Some(endpoint), ..self.token(node, node_id, id, role) };
        match self.session.liveliness().declare_token(token.to_string()).wait() {
            Ok(declared) => {
                Ok(Announced { roll: self.clone(), gid: token.gid(), node: node.to_owned(), _token: declared })
            }
            Err(error) => {
                self.leave(node);
                Err(error)
            }
        }
    }

    fn join(&self, node: &str) -> zenoh::Result<u64> {
        let mut nodes = self.nodes.lock();
        if let Some(shown) = nodes.get_mut(node) {
            shown.endpoints += 1;
            return Ok(shown.id);
        }
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let token = self.token(node, id, id, Role::Node).to_string();
        let token = self.session.liveliness().declare_token(token).wait()?;
        nodes.insert(node.to_owned(), OpenNode { id, endpoints: 1, _token: token });
        Ok(id)
    }

    fn leave(&self, node: &str) {
        let mut nodes = self.nodes.lock();
        if let Some(shown) = nodes.get_mut(node) {
            shown.endpoints -= 1;
            if shown.endpoints == 0 {
                nodes.remove(node);
            }
        }
    }

    fn token(&self, full: &str, node_id: u64, id: u64, role: Role) -> Token {
        let (namespace, node) = full.rsplit_once('/').unwrap_or_default();
        let namespace = if namespace.is_empty() { "/" } else { namespace };
        Token {
            domain: self.domain,
            session: self.session.zid().to_string(),
            node_id,
            id,
            role,
            enclave: "/".into(),
            namespace: namespace.to_owned(),
            node: node.to_owned(),
            endpoint: None,
        }
    }
}

impl Drop for Announced {
    fn drop(&mut self) {
        self.roll.leave(&self.node);
    }
}

/// Whether a text is the full name of a node. Remote names may be hostile.
fn is_node(full: &str) -> bool {
    let part = |part: &str| !part.is_empty() && part.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_');
    full.len() <= 255 && full.strip_prefix('/').is_some_and(|rest| rest.split('/').all(part))
}

#[cfg(test)]
#[path = "../tests/unit/roll.rs"]
mod tests;
