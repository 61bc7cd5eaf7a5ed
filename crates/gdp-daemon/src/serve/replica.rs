//! The daemon's state as one of several replicas of its domain's RIB. [`super::election`] runs the
//! replica.

use std::time::Duration;

use tokio::sync::watch;
use tokio::time::timeout;

use crate::config::EtcdConfig;
use crate::store::client::EtcdClient;
use crate::store::{StoreError, items::KeySpace};

/// The maximum wait at shutdown until etcd has recorded the resignation.
const RESIGNATION: Duration = Duration::from_secs(2);

/// A replica's access to the shared store, and its stage.
pub struct Replica {
    /// The client to clone. It sends no request itself.
    client: EtcdClient,
    pub(super) keys: KeySpace,
    stage: watch::Sender<Stage>,
}

/// The stage of a replica's resignation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Active,
    /// The replica must give up leading.
    Resigning,
    /// The replica does not lead, and will not lead again.
    Ended,
}

impl Replica {
    /// Creates the replica. Fails if a configured file is unusable, or etcd support is not built
    /// in.
    pub fn new(config: &EtcdConfig) -> Result<Self, StoreError> {
        let client = EtcdClient::new(&config.endpoints, &config.access)?;
        Ok(Self { client, keys: KeySpace::new(&config.prefix), stage: watch::Sender::new(Stage::Active) })
    }

    /// Resigns, and waits until this replica no longer leads or stands for election. Gives up the
    /// wait after two seconds if etcd does not answer.
    pub async fn resign(&self) {
        self.stage.send_if_modified(|stage| {
            let is_active = *stage == Stage::Active;
            if is_active {
                *stage = Stage::Resigning;
            }
            is_active
        });
        if timeout(RESIGNATION, self.until(Stage::Ended)).await.is_err() {
            tracing::warn!("etcd was not told that this replica leads no more: others wait until its lease is over");
        }
    }

    /// Waits until the replica is at this stage.
    pub async fn until(&self, awaited: Stage) {
        // The sender lives as long as `self`, so this does not fail.
        let _ = self.stage.subscribe().wait_for(|stage| *stage == awaited).await;
    }

    /// Marks the replica as ended: it will not lead again.
    pub fn end(&self) {
        self.stage.send_replace(Stage::Ended);
    }

    pub fn client(&self) -> EtcdClient {
        self.client.clone()
    }
}
