//! Requests to the join service, and its replies.

use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_core::cert::{AdCert, Delegation, Enrollment, Invite, Issued, Membership, ReadGrant, Signed, TopicsOf};
use gdp_core::identity::VerifyKey;
use serde::{Deserialize, Serialize};

use crate::directory::CatalogName;

/// Maximum size of a request or reply, in bytes.
const MAX_MESSAGE: usize = 64 << 10;

/// A request of an entity to the join service of its domain. The fabric proves who calls.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum JoinRequest {
    /// Enters the caller in the directory, or replaces its entry.
    Join(Box<Join>),
    /// Asks the domain to make the caller a member, or whether it has.
    Apply(Box<Application>),
    /// Removes the caller from the directory.
    Leave,
}

/// What a machine without an invitation asks for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Application {
    /// The machine's key for the invitation that it asks for.
    pub key: VerifyKey,
    pub label: String,
    pub expose: Vec<String>,
    pub import: Vec<TopicsOf>,
    pub read: Vec<TopicsOf>,
}

/// An invitation to the key of an [`Application`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Approval {
    pub invite: Signed<Invite>,
    pub enrollment: Signed<Enrollment>,
    /// Delegation to the key: its holder may call the join service.
    pub call: Signed<Delegation>,
}

/// Decision about an application.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Decision {
    Approved(Box<Approval>),
    Denied,
}

/// Evidence and catalog of a new member.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Join {
    pub membership: Membership,
    pub enrollment: Signed<Enrollment>,
    pub catalog: Option<OfferedCatalog>,
}

/// A member's catalog, with the right to let other members read it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OfferedCatalog {
    pub name: CatalogName,
    /// Right of the member to publish the catalog, from the catalog's owner.
    pub right: Signed<AdCert>,
    /// Delegation to the join service's key. It covers the list of the member's topics, and no
    /// topic.
    pub delegation: Signed<Delegation>,
}

/// The reply of the join service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum JoinReply {
    /// The caller is in the directory and may read it.
    Joined {
        directory: Box<Issued<ReadGrant>>,
        call: Box<Issued<ReadGrant>>,
    },
    Left,
    /// The application waits for a person.
    Pending,
    Approved(Box<Approval>),
    /// The reason of a refusal, for people.
    Refused(String),
}

impl JoinRequest {
    pub fn to_bytes(&self) -> Result<Vec<u8>, CborError> {
        cbor::encode(self)
    }

    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CborError> {
        cbor::decode(bytes, MAX_MESSAGE)
    }
}

impl JoinReply {
    pub fn to_bytes(&self) -> Result<Vec<u8>, CborError> {
        cbor::encode(self)
    }

    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CborError> {
        cbor::decode(bytes, MAX_MESSAGE)
    }
}
