//! The SDK of the Global Data Plane: a program publishes, subscribes, serves and calls names.
//!
//! ```no_run
//! use futures::StreamExt as _;
//!
//! # async fn example() -> Result<(), gdp::Error> {
//! let session = gdp::open(gdp::Config::from_env()?).await?;
//!
//! let publisher = session.publisher("/chatter").reliable().await?;
//! publisher.put("hello").await?;
//!
//! let mut samples = session.subscriber("/robot7/chatter").await?;
//! while let Some(sample) = samples.next().await {
//!     println!("{:?}", sample?.payload());
//! }
//!
//! let light = session.client("/light").await?;
//! println!("{:?}", light.call("on").await?.payload());
//! session.close().await?;
//! # Ok(()) }
//! ```
//!
//! A [`Session`] is an entity with its private key, attached to a switch. It finds names and rights
//! in a [`Keyring`]: the folder that `gdp-ctl join` or `gdp-proxy join` wrote, or one of name cards
//! and certificates. The owner of a name issues such certificates, here with
//! [`SigningKey::allow_publish`] and [`SigningKey::allow_read`].
//!
//! The session verifies the answers of the switch and its RIB itself, and seals and signs messages.
//! Only certificates of a name's owner decide which entities may write and read it.
//!
//! ROS messages are in the crate `gdp-ros`, which adds `session.ros()`.
// `print!` and `eprint!` panic when stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]
#![deny(missing_docs)]

mod keyring;
#[allow(missing_docs, reason = "the low-level API of this project's programs, in `unstable`")]
mod node;
mod session;

pub use gdp_core::card::NameCard;
pub use gdp_core::cert::{AdCert, AllowPublish, AllowRead, CertError, Grantee, Issued, Membership, ReadGrant, Reading};
pub use gdp_core::identity::{Identity, SigningKey, VerifyKey};
pub use gdp_core::link_target::{LinkTarget, LinkTargetError};
pub use gdp_core::name::{Name, NamePrefix, NameProof};
pub use gdp_e2e::seal::{Encoding, MessageId};
pub use gdp_wire::ErrorCode;
pub use keyring::members::MembersError;
pub use keyring::{FindError, Keyring, KeyringError, MissingRight, RightError};
pub use session::{
    Client, ClientBuilder, Config, Error, IncomingCall, Publisher, PublisherBuilder, Sample, Server, ServerBuilder,
    Session, Subscriber, SubscriberBuilder, open,
};

/// The errors within [`Error`], for programs that tell them apart.
pub mod errors {
    pub use crate::node::{Ended, NodeError, Stated, Unflushed};
    pub use gdp_core::domain::{DomainError, PaperFileError};
    pub use gdp_core::secret_file::SecretFileError;
    pub use gdp_directory::catalog::CatalogError;
    pub use gdp_directory::directory::DirectoryError;
    pub use gdp_e2e::keys::RingError;
    pub use gdp_e2e::seal::SealError;
    pub use gdp_link::link::LinkError;
    pub use gdp_link::port::LinkAddr;
    pub use gdp_link::tunnel::TunnelError;
    pub use gdp_proto::control::{Refusal, RefusalCode};
}

/// The low-level API, for the programs of this project: it changes without notice.
///
/// A [`Node`](unstable::Node) publishes and reads names with cards and certificates that the caller
/// brings, and shows its links, counters and statements.
#[doc(hidden)]
pub mod unstable {
    pub use crate::keyring::{DirectoryRight, called, members};
    pub use crate::node::{
        Call, Client, ClockDifference, Ended, Feedback, FrameError, ImmediateSender, Instance, LinkConfig, LinkState,
        LinkStatus, MessageSink, Meter, Node, NodeConfig, NodeCounters, NodeError, Overflow, PublishOptions, Publisher,
        PublisherCounters, Reliability, Rotation, SETTLING, Server, Stated, SubscribeOptions, Subscription,
        SubscriptionCounters, Unflushed, Wants,
    };
}
