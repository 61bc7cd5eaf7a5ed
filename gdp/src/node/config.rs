//! The configuration of a node: its identity and its links.

use std::path::PathBuf;
use std::time::Duration;

use gdp_wire::Name;

use gdp_core::domain::Credentials;
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_link::link::RekeySchedule;

/// The configuration of a node.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    pub identity: Identity,
    /// One to [`gdp_core::peer::MAX_LANES`] links in order of preference, all to switches of one
    /// domain. The first link that is up carries all traffic. The next one also carries
    /// [duplicates](super::PublishOptions::duplicate).
    pub links: Vec<LinkConfig>,
    /// Time for which [`Node::connect`](super::Node::connect) retries.
    pub connect_timeout: Duration,
    /// The rekey schedule of data frames.
    pub rekey: RekeySchedule,
    /// A folder for the revocations that the node receives, created if it does not exist. Without a
    /// folder, the node forgets them when it ends.
    pub state: Option<PathBuf>,
    /// The node's credentials in its trust domain. With credentials, the node accepts only switches
    /// of that domain and those with a PeerCert of the domain. Without credentials, it accepts any
    /// switch.
    pub credentials: Option<Credentials>,
}

/// The configuration of one of a node's links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkConfig {
    pub target: LinkTarget,
    /// The name that the switch must prove. Without a name, any switch at `target` is accepted.
    pub switch: Option<Name>,
    /// Rate limit for topics on this link, in bytes per second of frames with headers. `None`: no
    /// limit but the capacity of the paths to their readers.
    pub budget: Option<u64>,
}

impl From<LinkTarget> for LinkConfig {
    fn from(target: LinkTarget) -> Self {
        Self { target, switch: None, budget: None }
    }
}

impl NodeConfig {
    /// Returns a configuration with one link, to any switch at `link`, with a timeout of 10 s.
    pub fn new(identity: Identity, link: LinkTarget) -> Self {
        let (connect_timeout, rekey) = (Duration::from_secs(10), RekeySchedule::default());
        Self { identity, links: vec![link.into()], connect_timeout, rekey, state: None, credentials: None }
    }
}
