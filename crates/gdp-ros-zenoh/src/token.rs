//! Liveliness tokens: the key expressions by which nodes and endpoints exist in the graph.
//!
//! ```text
//! @ros2_lv/<domain>/<session>/<node id>/<id>/<role>/<enclave>/<namespace>/<node>
//! @ros2_lv/…/<node>/<name>/<DDS type>/RIHS01_<hash>/<QoS>
//! ```
//!
//! The first form is of nodes, the second of endpoints. In names each `/` is written `%`.

use std::fmt;

use crate::key::TypeHash;
use crate::qos::Qos;

/// First part of all tokens.
pub const ADMIN: &str = "@ros2_lv";

/// Bound on the length of a token in bytes. Names of ROS 2 have at most 255.
pub const MAX_LENGTH: usize = 2048;

/// What rmw_zenoh writes for a type without a hash.
const NO_HASH: &str = "TypeHashNotSupported";

/// The identifier of an entity: XXH3-128 of its token, little-endian.
pub type Gid = [u8; 16];

/// The kind of an entity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    Node,
    Publisher,
    Subscriber,
    Server,
    Client,
}

/// A node, or an endpoint of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    pub domain: u32,
    /// The Zenoh session, in hexadecimal digits.
    pub session: String,
    pub node_id: u64,
    pub id: u64,
    pub role: Role,
    pub enclave: String,
    /// `/` or `/robot`.
    pub namespace: String,
    pub node: String,
    /// What all but nodes have.
    pub endpoint: Option<Endpoint>,
}

/// A publisher, subscriber, server or client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The topic or service, such as `/chatter`.
    pub name: String,
    /// The DDS type, such as `std_msgs::msg::dds_::String_`.
    pub kind: String,
    pub hash: Option<TypeHash>,
    pub qos: Qos,
}

const ROLES: [(Role, &str); 5] =
    [(Role::Node, "NN"), (Role::Publisher, "MP"), (Role::Subscriber, "MS"), (Role::Server, "SS"), (Role::Client, "SC")];

impl Token {
    /// Reads a token, which may be hostile.
    pub fn parse(text: &str) -> Option<Self> {
        if text.len() > MAX_LENGTH {
            return None;
        }
        let mut parts = text.split('/');
        let mut next = || parts.next().filter(|part| !part.is_empty());
        if next()? != ADMIN {
            return None;
        }
        let domain = next()?.parse().ok()?;
        let session = next().filter(|session| session.len() <= 32 && session.bytes().all(is_hex))?.to_owned();
        let (node_id, id) = (next()?.parse().ok()?, next()?.parse().ok()?);
        let role = next()?;
        let (role, _) = ROLES.into_iter().find(|(_, written)| *written == role)?;
        let (enclave, namespace, node) = (name(next()?)?, name(next()?)?, name(next()?)?);
        let endpoint = match role {
            Role::Node => None,
            _ => Some(Endpoint {
                name: name(next()?)?,
                kind: next().filter(|kind| kind.bytes().all(is_of_kind))?.to_owned(),
                hash: TypeHash::parse(next()?),
                qos: Qos::parse(next()?)?,
            }),
        };
        match next() {
            None => Some(Self { domain, session, node_id, id, role, enclave, namespace, node, endpoint }),
            Some(_) => None,
        }
    }

    /// Returns the full name of the node, such as `/robot/driver`.
    pub fn full_node(&self) -> String {
        match self.namespace.as_str() {
            "/" => format!("/{}", self.node),
            namespace => format!("{namespace}/{}", self.node),
        }
    }

    /// Returns the identifier of the entity.
    pub fn gid(&self) -> Gid {
        gid(&self.to_string())
    }
}

/// Returns the identifier of the entity with this token.
pub fn gid(token: &str) -> Gid {
    xxhash_rust::xxh3::xxh3_128(token.as_bytes()).to_le_bytes()
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { domain, session, node_id, id, role, enclave, namespace, node, endpoint } = self;
        let role = ROLES.into_iter().find(|(other, _)| other == role).map_or("", |(_, written)| written);
        let (enclave, namespace, node) = (mangled(enclave), mangled(namespace), mangled(node));
        write!(f, "{ADMIN}/{domain}/{session}/{node_id}/{id}/{role}/{enclave}/{namespace}/{node}")?;
        let Some(Endpoint { name, kind, hash, qos }) = endpoint else { return Ok(()) };
        let hash = hash.map_or_else(|| NO_HASH.to_owned(), |hash| hash.to_string());
        write!(f, "/{}/{kind}/{hash}/{qos}", mangled(name))
    }
}

fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

/// Reads a mangled name. Names of ROS have letters, digits and underscores.
fn name(part: &str) -> Option<String> {
    let is_good = part.bytes().all(|c| c.is_ascii_alphanumeric() || matches!(c, b'_' | b'%' | b'-' | b'.'));
    is_good.then(|| part.replace('%', "/"))
}

fn is_of_kind(c: u8) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, b'_' | b':')
}

fn is_hex(c: u8) -> bool {
    c.is_ascii_hexdigit()
}

#[cfg(test)]
#[path = "../tests/unit/token.rs"]
mod tests;
