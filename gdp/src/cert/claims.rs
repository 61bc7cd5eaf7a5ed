//! What each kind of certificate states. Times are Unix seconds, both ends included.

use super::CertError;
use crate::name::Name;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fmt;

/// More domains than one name is ever meant for.
pub const MAX_SCOPE: usize = 64;

/// When something holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Validity {
    pub not_before: u64,
    pub not_after: u64,
}

impl Validity {
    /// For what is bounded in another way, as a statement is by its serial and its attachment.
    pub const ALWAYS: Self = Self { not_before: 0, not_after: u64::MAX };

    pub fn check(&self, now: u64) -> Result<(), CertError> {
        if now < self.not_before {
            return Err(CertError::NotYetValid { from: self.not_before, now });
        }
        if now > self.not_after {
            return Err(CertError::Expired { at: self.not_after, now });
        }
        Ok(())
    }

    fn check_order(&self) -> Result<(), CertError> {
        let Self { not_before, not_after } = self;
        if not_before > not_after {
            return Err(CertError::Malformed(format!("begins at {not_before}, after it ends at {not_after}")));
        }
        Ok(())
    }
}

/// One kind of certificate or statement.
pub trait Claims: Serialize + DeserializeOwned {
    /// What people call it.
    const KIND: &'static str;
    /// Between `-----BEGIN ` and `-----` in its text form.
    const LABEL: &'static str;
    /// Content type and external AAD of the signature; differs for each kind and version.
    const CONTEXT: &'static str;

    fn validity(&self) -> Validity;

    /// Bounds that the types do not express.
    fn check_bounds(&self) -> Result<(), CertError> {
        self.validity().check_order()
    }
}

/// How a name's messages are delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    Multicast,
    Anycast,
    Unicast,
}

/// Owner → entity: may publish or serve the name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdCert {
    pub name: Name,
    pub entity: Name,
    pub mode: Mode,
    /// Domains the name may be known in; none named means only the domain it is advertised in.
    pub scope: Vec<Name>,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for AdCert {
    const KIND: &'static str = "AdCert";
    const LABEL: &'static str = "GDP AD CERT";
    const CONTEXT: &'static str = "application/vnd.gdp.ad-cert.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        if self.scope.len() > MAX_SCOPE {
            return Err(CertError::Malformed(format!(
                "scope of {} domains where at most {MAX_SCOPE} are allowed",
                self.scope.len()
            )));
        }
        self.validity().check_order()
    }
}

/// Owner → entity: may subscribe to or call the name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReadGrant {
    pub name: Name,
    pub entity: Name,
    pub not_before: u64,
    pub not_after: u64,
}

impl Claims for ReadGrant {
    const KIND: &'static str = "ReadGrant";
    const LABEL: &'static str = "GDP READ GRANT";
    const CONTEXT: &'static str = "application/vnd.gdp.read-grant.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }
}

/// Entity → switch: may carry my traffic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RtCert {
    pub entity: Name,
    pub switch: Name,
    pub not_after: u64,
}

impl Claims for RtCert {
    const KIND: &'static str = "RtCert";
    const LABEL: &'static str = "GDP RT CERT";
    const CONTEXT: &'static str = "application/vnd.gdp.rt-cert.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: 0, not_after: self.not_after }
    }
}

/// What an entity states about a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AdvertOp {
    Publish,
    Subscribe,
    Withdraw,
}

impl fmt::Display for AdvertOp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
            Self::Withdraw => "withdraw",
        })
    }
}

/// An entity's own statement: what it does with the name, at which switch. No switch can make it up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Advert {
    pub op: AdvertOp,
    pub name: Name,
    pub entity: Name,
    pub switch: Name,
    /// Rises with every statement of the entity; the RIB refuses one that is not above the highest it saw.
    pub serial: u64,
    /// Seconds from when the RIB accepts it, on the RIB's clock.
    pub lifetime: u32,
}

impl Claims for Advert {
    const KIND: &'static str = "Advert";
    const LABEL: &'static str = "GDP ADVERT";
    const CONTEXT: &'static str = "application/vnd.gdp.advert.v1+cbor";

    fn validity(&self) -> Validity {
        Validity::ALWAYS
    }
}
