//! Election among the replicas of a domain's RIB, over etcd.
//!
//! One replica leads. It alone is the RIB as long as its lease at etcd lasts. The others follow the
//! stored state and stand for election once there is no leader. The leader confirms a statement
//! only after etcd has stored it.
//!
//! Three rules keep two replicas from leading at once. A leader starts its own timer before it
//! requests the lease, and its timer is shorter than etcd's. It checks the timer on every access to
//! the RIB. And etcd accepts no write of a leader whose term key is gone.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use gdp_core::peer::GRACEFUL_RESTART_TIME;
use gdp_rib::leadership::lease::{MARGIN, TTL, end_of_lease};
use gdp_rib::rib::{Item, Limits, RestoreError, Rib, RibRun, decode_item};
use gdp_wire::Name;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::core::Core;
use super::core::rib_host::run_id;
use super::daemon::Daemon;
use super::replica::{Replica, Stage};
use super::term::{Term, within};
use crate::domain::Used;
use crate::store::client::EtcdClient;
use crate::store::{StoreError, items::Copy, items::ItemChange, items::ItemWriter, items::KeySpace};

/// The interval at which the leader renews its lease, and at which the others look for a leader.
const BEAT: Duration = Duration::from_millis(800);

/// The delay after a failure.
const RETRY: Duration = Duration::from_millis(300);

/// The maximum delay before changes without a waiting client, such as expiry, are stored.
const SWEEP: Duration = Duration::from_millis(250);

/// The lease, etcd revision and term of an elected leader.
struct Elected {
    lease: i64,
    revision: i64,
    term: Arc<Term>,
}

/// Follows the stored state and leads when elected, until the daemon ends or must
/// [resign](Replica::resign).
pub async fn run(daemon: Arc<Daemon>) {
    if let Some(replica) = &daemon.replica {
        follow_and_lead(&daemon, replica).await;
        replica.end();
    }
}

async fn follow_and_lead(daemon: &Arc<Daemon>, replica: &Replica) {
    loop {
        let mut lease = None;
        let elected = tokio::select! {
            elected = stand_by(daemon, replica, &mut lease) => Some(elected),
            () = replica.until(Stage::Resigning) => None,
        };
        let error = match elected {
            Some(Ok((copy, elected))) => lead(daemon, replica, copy, elected).await,
            not_elected => {
                // This replica may have been elected without knowing. Revoking the lease ends that.
                if let Some(lease) = lease {
                    give_up(&mut replica.client(), lease).await;
                }
                not_elected.and_then(Result::err)
            }
        };
        // The replica must resign.
        let Some(error) = error else { return };
        if !matches!(error, StoreError::Compacted) {
            tracing::warn!(%error, "this replica of the RIB is behind");
            daemon.core().rib_host.no_rib = Some(error.to_string());
        }
        sleep(RETRY).await;
    }
}

/// Follows the stored state until this replica is elected. Stores the lease that it stands with in
/// `lease` before it stands.
async fn stand_by(daemon: &Daemon, replica: &Replica, lease: &mut Option<i64>) -> Result<(Copy, Elected), StoreError> {
    let (mut client, keys, own) = (replica.client(), &replica.keys, daemon.name);
    let mut copy = Copy::list(keys, &mut client).await?;
    let mut watch = client.watch(keys.prefix(), copy.revision() + 1).await?;
    loop {
        let is_led = keys.has_leader(&mut client).await?;
        daemon.core().rib_host.no_rib = (!is_led).then(|| "no replica of it leads; one is about to".into());
        if !is_led && let Some(elected) = Elected::stand(keys, &mut client, &own, lease).await? {
            let caught_up = async {
                while copy.revision() < elected.revision {
                    copy.apply(watch.next().await?)?;
                }
                Ok(())
            };
            match timeout(MARGIN, caught_up).await {
                Ok(Ok(())) => return Ok((copy, elected)),
                Ok(Err(error)) => return Err(error),
                // A new listing makes the copy complete again.
                Err(_) => return Err(StoreError::Compacted),
            }
        }
        let look = Instant::now() + BEAT;
        loop {
            tokio::select! {
                events = watch.next() => if copy.apply(events?)? { break },
                () = sleep_until(look) => break,
            }
        }
    }
}

impl Elected {
    async fn stand(
        keys: &KeySpace,
        client: &mut EtcdClient,
        own: &Name,
        stands_with: &mut Option<i64>,
    ) -> Result<Option<Self>, StoreError> {
        let asked = Instant::now();
        let lease = client.grant(TTL.as_secs()).await?;
        *stands_with = Some(lease);
        let term = Arc::new(Term::new(end_of_lease(asked)));
        match keys.stand(client, own, lease).await? {
            Some(revision) => Ok(Some(Self { lease, revision, term })),
            None => {
                // Another replica was elected.
                client.revoke(lease).await?;
                *stands_with = None;
                Ok(None)
            }
        }
    }

    /// Renews the lease until that fails. Returns the reason.
    async fn renew_lease(&self, client: &mut EtcdClient) -> StoreError {
        loop {
            sleep(BEAT).await;
            let asked = Instant::now();
            match client.keep_alive(self.lease).await {
                Ok(true) => {}
                Ok(false) => return StoreError::Fenced,
                Err(error) if self.term.is_over() => return error,
                Err(error) => {
                    tracing::warn!(%error, "the lease of the leading RIB was not renewed");
                    continue;
                }
            }
            if !self.term.extend(end_of_lease(asked)) {
                return StoreError::Fenced;
            }
        }
    }
}

/// Runs the RIB for a term. Returns the reason for its end, or `None` if the replica must resign.
async fn lead(daemon: &Arc<Daemon>, replica: &Replica, copy: Copy, elected: Elected) -> Option<StoreError> {
    let mut client = replica.client();
    let work = async {
        tokio::select! {
            error = elected.renew_lease(&mut client) => error,
            error = serve_term(daemon, replica, copy, &elected) => error,
        }
    };
    let error = tokio::select! {
        error = within(&elected.term, work) => Some(error),
        () = replica.until(Stage::Resigning) => None,
    };
    let why = error.as_ref().map_or_else(|| "this replica resigns".into(), ToString::to_string);
    {
        let mut core = daemon.core();
        // Changes of this term that are not stored by now never will be.
        elected.term.end(&why);
        core.end_term();
    }
    daemon.topology_changed();
    give_up(&mut client, elected.lease).await;
    error
}

/// Revokes the lease, so that the other replicas need not wait for its expiry.
async fn give_up(client: &mut EtcdClient, lease: i64) {
    if let Err(error) = client.revoke(lease).await {
        tracing::debug!(%error, "the lease is over only when its time is");
    }
}

async fn serve_term(daemon: &Arc<Daemon>, replica: &Replica, copy: Copy, elected: &Elected) -> StoreError {
    let (writer, changed) = match take_over(daemon, replica, copy, elected).await {
        Ok(taken) => taken,
        Err(error) => return error,
    };
    write(daemon, &elected.term, writer, changed).await
}

/// Makes the copy the RIB of this daemon. Returns the writer for its changes, and the items to
/// write or remove first.
async fn take_over(
    daemon: &Arc<Daemon>,
    replica: &Replica,
    copy: Copy,
    elected: &Elected,
) -> Result<(ItemWriter, BTreeSet<Item>), StoreError> {
    let known = daemon.revocations.known().unwrap_or_else(|error| {
        tracing::error!(%error, "what is kept here of revocations is of no use; those at etcd count");
        Vec::new()
    });
    let (now, root) = (daemon.core().now(), daemon.name);
    let run = RibRun { id: run_id(elected.revision.unsigned_abs()), settling: now.clock + GRACEFUL_RESTART_TIME };
    // This verifies signatures, perhaps many.
    let restoring = move || {
        let mut rib = Rib::new(root, run, Limits::default());
        rib.open_journal();
        rib.recall(known);
        let taken = rib.revocations_taken();
        let (mut used, mut useless, mut count) = (Vec::new(), BTreeSet::new(), 0);
        for (item, bytes) in copy.items() {
            let restored = match item {
                Item::Invitation(serial) => decode_item::<Used>(bytes).map(|one| {
                    // Expired invitations are removed.
                    if one.serial == *serial && one.until >= now.unix {
                        used.push(one)
                    } else {
                        useless.insert(*item);
                    }
                }),
                item => rib.restore(now, item, bytes),
            };
            match restored {
                Ok(()) => count += 1,
                Err(error) => {
                    tracing::debug!(%item, %error, "left out of what was stored");
                    // A newer replica may lead next, and can read it.
                    if !matches!(error, RestoreError::Version(_)) {
                        useless.insert(*item);
                    }
                }
            }
        }
        rib.restored();
        let changed = rib.take_changed();
        // Unchanged items need no write.
        let differs = |item: &Item| rib.stored(now, item).as_deref() != copy.get(item);
        let changed: Vec<Item> = changed.into_iter().filter(differs).collect();
        useless.extend(changed);
        (rib, copy, used, useless, taken, count)
    };
    let restored = tokio::task::spawn_blocking(restoring).await;
    let Ok((rib, copy, used, changed, taken, count)) = restored else { return Err(StoreError::Fenced) };
    {
        let mut core = daemon.core();
        daemon.revocations.restart(taken);
        if let Some(domain) = &mut core.membership.domain {
            used.into_iter().for_each(|used| domain.invitations.take(used));
        }
        core.lead(rib, elected.term.clone());
    }
    tracing::info!(items = count, left_out = changed.len(), "this replica leads: the RIB is here");
    daemon.topology_changed();
    daemon.report_in_full();
    daemon.send_effects();
    Ok((copy.into_writer(replica.client(), elected.revision), changed))
}

fn unstored(core: &mut Core, changed: &mut BTreeSet<Item>) -> Option<(u64, Vec<ItemChange>)> {
    core.rib_host.unstored(core.clock.now(), core.membership.domain.as_ref(), changed)
}

/// Writes the changes of the RIB, those of all waiting clients at once. Returns the error that ends
/// the term.
async fn write(daemon: &Daemon, term: &Term, mut writer: ItemWriter, mut changed: BTreeSet<Item>) -> StoreError {
    loop {
        let batch = unstored(&mut daemon.core(), &mut changed);
        let Some((last, batch)) = batch else { return StoreError::Fenced };
        if batch.is_empty() && !term.is_awaited(last) {
            term.awaited(SWEEP).await;
            continue;
        }
        match writer.write(&batch).await {
            Ok(()) => {
                changed.clear();
                term.set_writing(false);
                term.done(last);
            }
            Err(error @ (StoreError::Fenced | StoreError::Contended)) => return error,
            Err(error) => {
                tracing::warn!(%error, "what has changed in the RIB is not stored");
                term.failed(last, &error.to_string());
                sleep(RETRY).await;
            }
        }
    }
}
