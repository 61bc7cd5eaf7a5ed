//! The reader's state of one session of a writer.

use super::DropReason;
use super::assembly::Assembly;
use super::window::ReplayWindow;
use gdp_core::crypto::CryptoError;
use gdp_core::keys::SessionKey;
use std::collections::BTreeMap;

/// Sequence and cut. A message with a new cut is assembled separately from the earlier cut.
pub type SegmentPosition = (u64, u16);

pub struct Session {
    pub id: [u8; 16],
    pub keys: SessionKeys,
    /// The delivered messages, of any cut.
    pub window: ReplayWindow,
    pub assemblies: BTreeMap<SegmentPosition, Assembly>,
    /// The first sequence that the writer has confirmed, or `None` if the session is unconfirmed.
    pub from: Option<u64>,
    /// The number of the newest verified heartbeat.
    pub heartbeat: u32,
    /// Time of the last delivery, as the writer's count of deliveries.
    pub last_used: u64,
}

impl Session {
    pub fn new(id: [u8; 16]) -> Self {
        Self {
            id,
            keys: SessionKeys::default(),
            window: ReplayWindow::default(),
            assemblies: BTreeMap::new(),
            from: None,
            heartbeat: 0,
            last_used: 0,
        }
    }

    /// Removes all assemblies of a message, of any cut. Returns the memory they were charged.
    pub fn give_up(&mut self, sequence: u64) -> usize {
        let mut freed = 0;
        while let Some((&place, _)) = self.assemblies.range((sequence, 0)..=(sequence, u16::MAX)).next() {
            freed += self.assemblies.remove(&place).map_or(0, |assembly| assembly.cost);
        }
        freed
    }
}

/// The keys of a session by epoch, at most one per epoch key of the writer.
#[derive(Default)]
pub struct SessionKeys(Vec<(u32, SessionKey)>);

impl SessionKeys {
    /// Returns the key of an epoch; `derive` creates it on first use.
    pub fn of(
        &mut self,
        epoch: u32,
        derive: impl FnOnce() -> Result<SessionKey, CryptoError>,
    ) -> Result<&SessionKey, DropReason> {
        let at = match self.0.iter().position(|(of, _)| *of == epoch) {
            Some(at) => at,
            None => {
                self.0.push((epoch, derive().map_err(|_| DropReason::Internal)?));
                self.0.len() - 1
            }
        };
        Ok(&self.0[at].1)
    }

    pub fn forget(&mut self, epoch: u32) {
        self.0.retain(|(of, _)| *of != epoch);
    }
}
