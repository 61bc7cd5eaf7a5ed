//! What an application configures of a node: its identity and its links.

use std::path::PathBuf;
use std::time::Duration;

use gdp_wire::Name;

use gdp_core::domain::Credentials;
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_link::link::RekeySchedule;

/// How a node finds its switch.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    pub identity: Identity,
    /// One to [`gdp_core::peer::MAX_LANES`], in the order in which they are wanted, each to a
    /// switch of the same domain. Everything goes by the first that is up, and what is to be
    /// [duplicated](super::PublishOptions::duplicate) by the next one as well.
    pub links: Vec<LinkConfig>,
    /// How long [`Node::connect`](super::Node::connect) keeps trying.
    pub connect_timeout: Duration,
    /// When the keys of data frames are replaced.
    pub rekey: RekeySchedule,
    /// A folder in which the node keeps the revocations that it hears of, made if it is not there;
    /// without one, it forgets them when it ends.
    pub state: Option<PathBuf>,
    /// What the node shows of its trust domain. With it, it takes switches of that domain only, and
    /// of those that the domain has issued a PeerCert to; without, any.
    pub credentials: Option<Credentials>,
}

/// One of a node's links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkConfig {
    pub target: LinkTarget,
    /// The name that the switch must prove; without it, any switch at `target` is taken.
    pub switch: Option<Name>,
    /// Bytes a second that topics send by this link at most, of frames with their header; `None`:
    /// what the ways to their readers take.
    pub budget: Option<u64>,
}

impl From<LinkTarget> for LinkConfig {
    fn from(target: LinkTarget) -> Self {
        Self { target, switch: None, budget: None }
    }
}

impl NodeConfig {
    /// One link, to any switch at `link`, waited for 10 s.
    pub fn new(identity: Identity, link: LinkTarget) -> Self {
        let (connect_timeout, rekey) = (Duration::from_secs(10), RekeySchedule::default());
        Self { identity, links: vec![link.into()], connect_timeout, rekey, state: None, credentials: None }
    }
}
