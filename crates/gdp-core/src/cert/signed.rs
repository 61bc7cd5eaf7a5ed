//! Exact bytes of a certificate, and their verification.

use super::block::decode_block;
use super::{Claims, extension};
use crate::cbor;
use crate::cert::error::CertError;
use crate::crypto::{CryptoError, SIGNATURE_LEN};
use crate::identity::SigningKey;
use crate::name::NameProof;
use crate::verify_key::VerifyKey;
use coset::{CoseSign1, CoseSign1Builder, HeaderBuilder, TaggedCborSerializable, iana};
use p256::pkcs8::LineEnding;
use p256::pkcs8::der::pem;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;
use std::marker::PhantomData;

/// Maximum bytes of a certificate. An AdCert with a full scope has about 2.5 kB.
pub const MAX_SIGNED: usize = 4096;

/// Certificate or statement as it was signed. The bytes are sent and stored unchanged, so that
/// everybody verifies the same input. Nothing in it is trusted before [`Signed::verify`].
pub struct Signed<T> {
    bytes: Box<[u8]>,
    claims: PhantomData<fn() -> T>,
}

/// Signs `claims`. The key id of the result is the public key of the signer.
pub fn issue<T: Claims>(key: &SigningKey, claims: &T) -> Result<Signed<T>, CertError> {
    claims.check_bounds()?;
    let unsigned = envelope::<T>(&key.verify_key(), cbor::encode(claims)?);
    let sign = |message: &[u8]| -> Result<Vec<u8>, CryptoError> { Ok(key.sign(message)?.to_vec()) };
    let cose = unsigned.try_create_signature(T::CONTEXT.as_bytes(), sign)?.build();
    let bytes = cose.to_tagged_vec().map_err(malformed)?;
    Signed::from_bytes(bytes)
}

impl<T> Signed<T> {
    /// Wraps received bytes and checks only their length.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self, CertError> {
        if bytes.len() > MAX_SIGNED {
            return Err(CertError::Malformed(format!("{} bytes where at most {MAX_SIGNED} are allowed", bytes.len())));
        }
        Ok(Self { bytes: bytes.into(), claims: PhantomData })
    }

    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }
}

impl<T: Claims> Signed<T> {
    /// Verifies the signature by `key`, and validity and serial at `now` (Unix seconds). Returns
    /// the claims.
    pub fn verify(&self, key: &VerifyKey, now: u64) -> Result<T, CertError> {
        let claims = self.verify_signature(key)?;
        claims.check_time(now)?;
        Ok(claims)
    }

    /// Verifies the signature as [`Self::verify`] does, regardless of time. For showing the claims
    /// of an expired certificate.
    pub fn verify_signature(&self, key: &VerifyKey) -> Result<T, CertError> {
        let (cose, claims) = self.parse()?;
        let signer = &cose.protected.header.key_id;
        if signer != key.as_bytes() {
            return Err(CertError::WrongKey { what: T::KIND, expected: key.to_string(), got: hex::encode(signer) });
        }
        let bad = CertError::BadSignature { what: T::KIND };
        cose.verify_signature(T::CONTEXT.as_bytes(), |signature, message| {
            let signature: &[u8; SIGNATURE_LEN] = signature.try_into().map_err(|_| bad.clone())?;
            key.verify(message, signature).map_err(|error| match error {
                CryptoError::HighS => CertError::HighS { what: T::KIND },
                _ => bad.clone(),
            })
        })?;
        Ok(claims)
    }

    /// Verifies the signature of the owner of `name`, or of the successor that a domain has named.
    /// Disregards the time.
    pub fn verify_for_name(&self, name: &NameProof) -> Result<T, CertError> {
        let signer = self.signer_unverified()?;
        self.verify_signature(&if name.is_signer(&signer) { signer } else { name.verify_key()? })
    }

    /// Returns the public key that is stated as the signer's, unverified.
    pub fn signer_unverified(&self) -> Result<VerifyKey, CertError> {
        Ok(VerifyKey::from_bytes(&self.parse()?.0.protected.header.key_id)?)
    }

    /// Returns the unverified claims, to show them or to find the key for verification.
    pub fn claims_unverified(&self) -> Result<T, CertError> {
        Ok(self.parse()?.1)
    }

    /// Returns the bytes of the unverified payload, which are the same under every signature.
    pub fn payload_unverified(&self) -> Result<Vec<u8>, CertError> {
        Ok(self.parse()?.0.payload.unwrap_or_default())
    }

    /// Parses the bytes. Accepts only the encoding that [`issue`] produces, and unknown fields that
    /// are not critical.
    fn parse(&self) -> Result<(CoseSign1, T), CertError> {
        let cose = CoseSign1::from_tagged_slice(&self.bytes).map_err(|_| {
            CertError::Malformed("not the bytes of a signed statement (COSE_Sign1); copy the whole file again".into())
        })?;
        let header = &cose.protected.header;
        let expected = Some(coset::ContentType::Text(T::CONTEXT.into()));
        if header.content_type != expected {
            let found = match &header.content_type {
                Some(coset::ContentType::Text(text)) => text.as_str(),
                _ => "something else",
            };
            if *found == T::CONTEXT.replace(".v2+", ".v1+") {
                return Err(CertError::OldVersion { what: T::KIND });
            }
            return Err(CertError::Malformed(format!("expected {} ({}), found {found}", T::KIND, T::CONTEXT)));
        }
        let signer = VerifyKey::from_bytes(&header.key_id)
            .map_err(|_| CertError::Malformed("the key id is not a P-256 public key".into()))?;
        let payload = cose.payload.clone().ok_or_else(|| CertError::Malformed("no payload".into()))?;
        let (claims, others): (T, _) = cbor::decode_open(&payload, MAX_SIGNED)?;
        extension::check::<T>(&others)?;
        claims.check_bounds()?;
        let canonical = envelope::<T>(&signer, payload).signature(cose.signature.clone()).build();
        if canonical.to_tagged_vec().map_err(malformed)?[..] != *self.bytes {
            return Err(CertError::Malformed("its COSE headers or encoding are not those of this version".into()));
        }
        Ok((cose, claims))
    }

    /// Returns the text form for files: base64 between `-----BEGIN GDP AD CERT-----` lines (RFC
    /// 7468).
    pub fn to_pem(&self) -> String {
        pem::encode_string(T::LABEL, LineEnding::LF, &self.bytes)
            .expect("the label is fixed and the size is bounded, so there is a text form")
    }

    pub fn from_pem(text: &str) -> Result<Self, CertError> {
        if text.len() > 2 * MAX_SIGNED {
            return Err(CertError::Malformed(format!("{} characters of text are too many", text.len())));
        }
        let signed = Self::from_bytes(decode_block(T::LABEL, text)?)?;
        signed.parse()?;
        Ok(signed)
    }
}

fn envelope<T: Claims>(signer: &VerifyKey, payload: Vec<u8>) -> CoseSign1Builder {
    let protected = HeaderBuilder::new()
        .algorithm(iana::Algorithm::ES256)
        .content_type(T::CONTEXT.into())
        .key_id(signer.as_bytes().to_vec())
        .build();
    CoseSign1Builder::new().protected(protected).payload(payload)
}

fn malformed(error: impl fmt::Display) -> CertError {
    CertError::Malformed(error.to_string())
}

impl<T> Clone for Signed<T> {
    fn clone(&self) -> Self {
        Self { bytes: self.bytes.clone(), claims: PhantomData }
    }
}

impl<T> PartialEq for Signed<T> {
    fn eq(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }
}

impl<T> Eq for Signed<T> {}

impl<T: Claims> fmt::Debug for Signed<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Signed<{}>({} bytes)", T::KIND, self.bytes.len())
    }
}

impl<T> Serialize for Signed<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        cbor::bytes::serialize(&self.bytes, serializer)
    }
}

impl<'de, T> Deserialize<'de> for Signed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_bytes(cbor::bytes::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}
