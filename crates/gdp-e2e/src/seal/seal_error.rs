//! Errors of a writer that seals messages.

use super::message::MAX_ORIGIN;
use super::wire::MAX_BATCH;
use gdp_core::crypto::CryptoError;

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SealError {
    #[error("frame payloads of {max_payload} bytes are too small: {need} are needed; raise the link's MTU")]
    PayloadTooSmall { max_payload: usize, need: usize },
    #[error("a message of {len} bytes needs more than 2^32 segments of {size} bytes")]
    MessageTooLarge { len: usize, size: usize },
    #[error("a batch of {0} messages where at most {MAX_BATCH} may share a signature")]
    BatchTooLarge(usize),
    #[error("an origin of {0} bytes where at most {MAX_ORIGIN} are allowed")]
    OriginTooLong(usize),
    #[error("this session has used all its sequence numbers; start a new one")]
    SequenceExhausted,
    #[error("there is no key to seal with yet; set that of an epoch")]
    NoEpoch,
    #[error("epoch {epoch} does not follow epoch {current}; the numbers of epochs only rise")]
    EpochGoesBack { epoch: u32, current: u32 },
    #[error("the key of epoch {0} has sealed as much as it may; begin another epoch")]
    EpochExhausted(u32),
    #[error("message {sequence} cannot be sealed under cut {cut}: {why}")]
    Cut { sequence: u64, cut: u16, why: &'static str },
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}
