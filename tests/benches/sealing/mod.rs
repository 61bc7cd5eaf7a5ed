//! A writer and a reader of one name that know each other, without a network.

use anyhow::{Result, ensure};
use gdp_core::crypto::Backend;
use gdp_core::identity::Identity;
use gdp_core::keys::EpochKey;
use gdp_e2e::seal::{Reader, ReaderLimits, Writer};
use gdp_wire::Name;

/// Payload bytes of a frame on a link of 1500 B.
pub const PAYLOAD: usize = 1400;

const EPOCH: u32 = 1;

/// Returns both, and the writer's entity.
pub fn pair(backend: Backend) -> Result<(Writer, Reader, Name)> {
    let (name, identity, key) = (Name::from_bytes([7; 32]), Identity::generate("proxy")?, EpochKey::generate()?);
    let from = identity.name();
    let mut writer = Writer::new(name, from, identity.key().clone(), backend)?;
    writer.set_epoch(EPOCH, &key)?;
    let mut reader = Reader::new(name, backend, ReaderLimits::default());
    reader.authorise(from, identity.key().verify_key())?;
    let vouched = reader.set_key(&from, EPOCH, key).and_then(|()| reader.confirm_session(&from, writer.session(), 1));
    ensure!(vouched.is_ok(), "{vouched:?}");
    Ok((writer, reader, from))
}
