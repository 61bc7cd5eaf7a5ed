use serde::{Deserialize, Serialize};

use crate::cert::{CertError, Claims, Validity};
use crate::name::Name;

const SEALED_LEN: usize = 32 + 65 + 16;

/// Writer → reader: the key of this epoch of the name. It holds until the writer makes another.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyBox {
    pub name: Name,
    pub writer: Name,
    pub reader: Name,
    /// Rises with every epoch of the writer for the name.
    pub epoch: u32,
    /// The epoch key, 32 bytes, sealed for the reader's box key ([`crypto::hpke_seal`]).
    #[serde(with = "crate::cbor::bytes")]
    pub sealed: Vec<u8>,
}

impl Claims for KeyBox {
    const KIND: &'static str = "KeyBox";
    const LABEL: &'static str = "GDP KEY BOX";
    const CONTEXT: &'static str = "application/vnd.gdp.key-box.v1+cbor";

    fn validity(&self) -> Validity {
        Validity::ALWAYS
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        match self.sealed.len() {
            SEALED_LEN => Ok(()),
            len => Err(CertError::Malformed(format!("a sealed key of {len} bytes where {SEALED_LEN} are expected"))),
        }
    }
}
