//! The daemon's part as one of several replicas of its domain's RIB: whether it stands for
//! election. What it does is in [`super::election`].

use std::time::Duration;

use tokio::sync::watch;
use tokio::time::timeout;

use crate::config::EtcdConfig;
use crate::store::client::EtcdClient;
use crate::store::{StoreError, items::KeySpace};

/// How long the end of a daemon waits for etcd to take note that it leads no more.
const RESIGNATION: Duration = Duration::from_secs(2);

/// A replica's part in what is kept together.
pub struct Replica {
    /// Never asks; copies of it do.
    client: EtcdClient,
    pub(super) keys: KeySpace,
    stage: watch::Sender<Stage>,
}

/// How far a replica is with its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Active,
    /// It is to lead no more.
    Resigning,
    /// It does not lead, and never will.
    Ended,
}

impl Replica {
    /// Fails if a file that the configuration names is of no use, or etcd is not built in.
    pub fn new(config: &EtcdConfig) -> Result<Self, StoreError> {
        let client = EtcdClient::new(&config.endpoints, &config.access)?;
        Ok(Self { client, keys: KeySpace::new(&config.prefix), stage: watch::Sender::new(Stage::Active) })
    }

    /// Returns once it leads no more, and does not stand again; if etcd does not answer, a while
    /// later.
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

    /// Returns once it is at this stage.
    pub async fn until(&self, awaited: Stage) {
        // It ends no earlier than this does.
        let _ = self.stage.subscribe().wait_for(|stage| *stage == awaited).await;
    }

    /// It leads no more, and never will.
    pub fn end(&self) {
        self.stage.send_replace(Stage::Ended);
    }

    pub fn client(&self) -> EtcdClient {
        self.client.clone()
    }
}
