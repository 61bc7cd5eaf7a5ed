//! The SDK of the Global Data Plane: an endpoint publishes, subscribes, serves and calls names.
//!
//! ```no_run
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! # let (identity, card, cert): (gdp::Identity, gdp::NameCard, _) = todo!();
//! let node = gdp::Node::connect(gdp::NodeConfig::new(identity, "eth://r0".parse()?)).await?;
//! let mut publisher = node.publish(card.proof(), cert, gdp::PublishOptions::best_effort()).await?;
//! publisher.send(gdp::Encoding::Bytes, b"hello").await?;
//! # Ok(()) }
//! ```
//!
//! A node is an entity attached to a switch, over one or several links. The node verifies the
//! answers of the switch and its RIB itself. Only certificates of a name's owner decide which
//! entities may write it.
// `print!` and `eprint!` panic when stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod node;

pub use gdp_core::card::NameCard;
pub use gdp_core::cert::{AdCert, Grantee, Issued, Membership, ReadGrant, Reading};
pub use gdp_core::identity::{Identity, SigningKey, VerifyKey};
pub use gdp_core::link_target::{LinkTarget, LinkTargetError};
pub use gdp_core::name::{Name, NamePrefix, NameProof};
pub use gdp_e2e::seal::{Encoding, MessageId};
pub use gdp_wire::ErrorCode;
pub use node::{
    Call, Client, Ended, Feedback, FrameError, ImmediateSender, Instance, LinkConfig, LinkState, LinkStatus,
    MessageSink, Meter, Node, NodeConfig, NodeCounters, NodeError, Overflow, PublishOptions, Publisher,
    PublisherCounters, Reliability, Rotation, SETTLING, Server, Stated, SubscribeOptions, Subscription,
    SubscriptionCounters, Unflushed, Wants,
};
