//! P-256 keys and the entities that hold them. Private keys are stored in PKCS#8 PEM files of mode
//! 0600. They never appear in a log and stay in memory no longer than their owner. A line before
//! the PEM block, such as `kind: proxy`, states the kind of the entity that the key is for.

use crate::card::NameCard;
use crate::crypto::{Backend, CryptoError, PUBLIC_KEY_LEN, SIGNATURE_LEN, Signer};
use crate::file_kind::FileKind;
use crate::keys::BoxKey;
use crate::name::{Metadata, Name, NameProof};
use crate::secret_file::SecretFileError;
pub use crate::verify_key::VerifyKey;
use crate::{crypto, name, secret_file};
use p256::SecretKey;
use p256::elliptic_curve::sec1::ToSec1Point;
use p256::pkcs8::{DecodePrivateKey, EncodePrivateKey, LineEnding};
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use zeroize::Zeroizing;

/// Maximum bytes of a key file. A PEM file of a P-256 key has about 240 bytes.
const MAX_KEY_FILE: usize = 4096;

/// Start of the line with the entity's kind, in the explanatory text before the key (RFC 7468 §2).
const KIND: &str = "kind: ";
const MAX_KIND: usize = 32;

/// Private P-256 key. Clones share one copy, which is cleared with the last of them.
#[derive(Clone)]
pub struct SigningKey(Arc<Inner>);

struct Inner {
    secret: SecretKey,
    public: [u8; PUBLIC_KEY_LEN],
    signer: Signer,
    box_key: BoxKey,
}

impl SigningKey {
    pub fn generate() -> Result<Self, CryptoError> {
        loop {
            let candidate = Zeroizing::new(crypto::random::<32>()?);
            // One in 2^32 candidates is not below the group order.
            if let Ok(secret) = SecretKey::from_slice(candidate.as_slice()) {
                return Self::from_secret(secret);
            }
        }
    }

    /// Reads a PKCS#8 PEM file. Refuses a file that others may read or write.
    pub fn load(path: &Path) -> Result<Self, SecretFileError> {
        Ok(KeyFile::load(path)?.key)
    }

    /// Writes a new PKCS#8 PEM file of mode 0600. Never overwrites an existing file.
    pub fn save_new(&self, path: &Path) -> Result<(), SecretFileError> {
        self.save_after("", path)
    }

    /// Loads `path`, or creates it with a new key. If two processes create it at once, both get the
    /// same key.
    pub fn load_or_generate(path: &Path) -> Result<Self, SecretFileError> {
        Self::load_or_save_after("", path)
    }

    /// Writes a new file with an explanation before the key.
    fn save_after(&self, explanation: &str, path: &Path) -> Result<(), SecretFileError> {
        let pem = self.0.secret.to_pkcs8_pem(LineEnding::LF).map_err(|e| SecretFileError::malformed(path, e))?;
        let text = Zeroizing::new([explanation, &pem].concat());
        secret_file::create(path, text.as_bytes())
    }

    fn load_or_save_after(explanation: &str, path: &Path) -> Result<Self, SecretFileError> {
        match Self::load(path) {
            Err(e) if e.is_not_found() => {}
            result => return result,
        }
        let key = Self::generate().map_err(|e| SecretFileError::malformed(path, e))?;
        match key.save_after(explanation, path) {
            Ok(()) => Ok(key),
            Err(SecretFileError::Exists(_)) => Self::load(path),
            Err(e) => Err(e),
        }
    }

    /// Returns the public key, SEC1 compressed.
    pub fn public(&self) -> [u8; PUBLIC_KEY_LEN] {
        self.0.public
    }

    pub fn verify_key(&self) -> VerifyKey {
        VerifyKey(self.0.public)
    }

    /// Signs by ECDSA with SHA-256 and returns `r ‖ s`. The caller must separate domains: a message
    /// signed for one purpose must not be a valid input for another.
    pub fn sign(&self, message: &[u8]) -> Result<[u8; SIGNATURE_LEN], CryptoError> {
        self.0.signer.sign(message)
    }

    /// Returns a signer of the chosen back end.
    pub fn signer(&self, backend: Backend) -> Result<Signer, CryptoError> {
        backend.signer(&self.pkcs8_der())
    }

    /// Returns the key as PKCS#8 DER, for a TLS certificate of this key.
    pub fn pkcs8_der(&self) -> Zeroizing<Vec<u8>> {
        pkcs8_der(&self.0.secret)
    }

    /// Returns the scalar, to be sent in an invitation.
    pub(crate) fn secret_bytes(&self) -> Zeroizing<[u8; 32]> {
        Zeroizing::new(self.0.secret.to_bytes().into())
    }

    /// Returns the key with this scalar (big-endian).
    ///
    /// # Errors
    ///
    /// [`CryptoError::BadPrivateKey`] for zero and for scalars that are not below the group order.
    pub fn from_secret_bytes(bytes: &[u8; 32]) -> Result<Self, CryptoError> {
        Self::from_secret(SecretKey::from_slice(bytes).map_err(|_| CryptoError::BadPrivateKey)?)
    }

    fn from_secret(secret: SecretKey) -> Result<Self, CryptoError> {
        let point = secret.public_key().to_sec1_point(true);
        let public = point.as_bytes().try_into().map_err(|_| CryptoError::BadPrivateKey)?;
        let signer = Backend::RustCrypto.signer(&pkcs8_der(&secret))?;
        let scalar: Zeroizing<[u8; 32]> = Zeroizing::new(secret.to_bytes().into());
        let box_key = BoxKey::derive(&scalar)?;
        Ok(Self(Arc::new(Inner { secret, public, signer, box_key })))
    }
}

/// Encodes the key. A valid P-256 key has a fixed shape of about 140 bytes, so this cannot fail.
fn pkcs8_der(secret: &SecretKey) -> Zeroizing<Vec<u8>> {
    secret.to_pkcs8_der().expect("a P-256 key always has a PKCS#8 form").to_bytes()
}

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SigningKey(public {})", hex::encode(self.0.public))
    }
}

/// Private key as read from a file.
pub struct KeyFile {
    pub key: SigningKey,
    /// Kind of the entity that the key is for, if the file states it.
    pub kind: Option<String>,
}

impl KeyFile {
    /// Reads a file as [`SigningKey::load`] does.
    pub fn load(path: &Path) -> Result<Self, SecretFileError> {
        let malformed = |reason: String| SecretFileError::malformed(path, reason);
        let content = secret_file::read(path, MAX_KEY_FILE)?;
        let text = std::str::from_utf8(&content).map_err(|_| malformed("not a PEM file".into()))?;
        let (explanation, pem) = text.split_at(text.find("-----BEGIN ").unwrap_or_default());
        let secret = SecretKey::from_pkcs8_pem(pem).map_err(|_| match FileKind::of(text) {
            Some(kind) if kind != FileKind::Key => malformed(format!("it is {kind}, not a private key")),
            _ => malformed(
                "not a P-256 private key in PKCS#8 PEM form; `openssl pkcs8 -topk8 -nocrypt` converts other forms"
                    .into(),
            ),
        })?;
        let key = SigningKey::from_secret(secret).map_err(|e| malformed(e.to_string()))?;
        let kind = explanation.lines().find_map(|line| line.strip_prefix(KIND)).map(str::trim);
        Ok(Self { key, kind: kind.filter(|kind| is_kind(kind)).map(str::to_owned) })
    }

    /// Returns the entity of the stated kind, or of `default` if the file states none.
    pub fn identity_or(self, default: &str) -> Identity {
        Identity::new(self.key, self.kind.as_deref().unwrap_or(default))
    }
}

fn is_kind(text: &str) -> bool {
    let is_letter = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || b"_-".contains(&c);
    (1..=MAX_KIND).contains(&text.len()) && text.bytes().all(is_letter)
}

fn explanation(kind: &str) -> String {
    format!("{KIND}{kind}\n")
}

/// Entity: a proxy, switch, RIB or domain. Its name is derived from its own key and its metadata,
/// `{kind: …}`.
#[derive(Clone, Debug)]
pub struct Identity {
    key: SigningKey,
    metadata: Metadata,
    proof: NameProof,
    name: Name,
}

impl Identity {
    /// Creates an identity. `kind` is `switch`, `proxy`, `rib`, `tool`, …
    pub fn new(key: SigningKey, kind: &str) -> Self {
        let metadata = Metadata::from([("kind".to_owned(), kind.to_owned())]);
        let proof = NameProof { owner_key: key.public(), digest: name::inner_digest(&metadata) };
        let name = name::derive(&proof.owner_key, &proof.digest);
        Self { key, metadata, proof, name }
    }

    /// Returns the identity of the domain with this card, if the card is a domain's and `key` may
    /// sign for it: as its owner's, or as that of the successor.
    pub fn of_domain(key: SigningKey, card: &NameCard) -> Option<Self> {
        let (proof, name) = (card.proof(), card.name());
        (card.is_domain() && proof.is_signer(&key.verify_key())).then(|| Self {
            key,
            metadata: card.metadata().clone(),
            proof,
            name,
        })
    }

    pub fn generate(kind: &str) -> Result<Self, CryptoError> {
        Ok(Self::new(SigningKey::generate()?, kind))
    }

    /// Loads the identity whose key is in the PEM file `path`. Creates the file if there is none.
    pub fn load_or_generate(path: &Path, kind: &str) -> Result<Self, SecretFileError> {
        Ok(Self::new(SigningKey::load_or_save_after(&explanation(kind), path)?, kind))
    }

    /// Writes the key and its kind to a new file, as [`SigningKey::save_new`] does.
    pub fn save_new(&self, path: &Path) -> Result<(), SecretFileError> {
        self.key.save_after(&explanation(&self.metadata["kind"]), path)
    }

    pub fn key(&self) -> &SigningKey {
        &self.key
    }

    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    pub fn proof(&self) -> NameProof {
        self.proof
    }

    pub fn name(&self) -> Name {
        self.name
    }

    /// Returns the key for HPKE and for key agreement.
    pub fn box_key(&self) -> &BoxKey {
        &self.key.0.box_key
    }

    /// Returns the public key of [`Self::box_key`], SEC1 compressed.
    pub fn box_public(&self) -> [u8; PUBLIC_KEY_LEN] {
        self.box_key().public()
    }
}

#[cfg(test)]
#[path = "../tests/unit/identity.rs"]
mod tests;
