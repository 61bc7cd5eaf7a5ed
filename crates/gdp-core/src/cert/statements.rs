//! Statements of entities: which switch may carry their traffic, and what they do with a name.

use super::advert_op::AdvertOp;
use super::{Claims, Validity};
use crate::cert::error::CertError;
use crate::crypto::PUBLIC_KEY_LEN;
use crate::name::Name;
use crate::verify_key::VerifyKey;
use serde::{Deserialize, Serialize};

/// Statement of an entity that a switch may carry its traffic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RtCert {
    pub entity: Name,
    pub switch: Name,
    pub not_after: u64,
}

impl Claims for RtCert {
    const KIND: &'static str = "RtCert";
    const LABEL: &'static str = "GDP RT CERT";
    const CONTEXT: &'static str = "application/vnd.gdp.rt-cert.v2+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: 0, not_after: self.not_after }
    }
}

/// Statement of an entity: what it does with the name, at which switch. No switch can forge it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Advert {
    pub op: AdvertOp,
    pub name: Name,
    pub entity: Name,
    pub switch: Name,
    /// Serial that increases with every statement of the entity. The RIB refuses one that is not
    /// above the highest it saw.
    pub serial: u64,
    /// Lifetime in seconds from the RIB's acceptance, on the RIB's clock.
    pub lifetime: u32,
    /// Public key to which content keys for the entity are wrapped: P-256, SEC1 compressed.
    #[serde(with = "crate::cbor::array")]
    pub box_key: [u8; PUBLIC_KEY_LEN],
}

impl Claims for Advert {
    const KIND: &'static str = "Advert";
    const LABEL: &'static str = "GDP ADVERT";
    const CONTEXT: &'static str = "application/vnd.gdp.advert.v2+cbor";

    fn validity(&self) -> Validity {
        Validity::ALWAYS
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        VerifyKey::from_bytes(&self.box_key)
            .map(drop)
            .map_err(|_| CertError::Malformed("the box key is not a P-256 public key".into()))
    }
}
