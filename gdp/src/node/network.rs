//! Detects when this machine changes networks, from the kernel's notifications about interfaces,
//! addresses and routes.
//!
//! QUIC would notice only after seconds of silence. [`super::supervisor`] looks up the path to an
//! address and waits until it changes. Only Linux is asked.

#[cfg(target_os = "linux")]
mod linux;
#[cfg(not(target_os = "linux"))]
mod other;

use std::net::IpAddr;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{sleep, timeout};

#[cfg(target_os = "linux")]
pub use self::linux::HostNetwork;
#[cfg(not(target_os = "linux"))]
pub use self::other::HostNetwork;

/// Delay before the next query after an error or a timeout.
const ASK_AGAIN: Duration = Duration::from_secs(1);

/// Minimum interval of queries that notifications trigger, because notifications may arrive in
/// bursts.
pub const BETWEEN: Duration = Duration::from_millis(5);

/// The path from this machine to an address, as far as the kernel reports it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "only Linux says how an address is reached"))]
pub enum NetworkPath {
    By(Exit),
    /// There is no path.
    Nowhere,
    /// The path could not be determined. The caller has to try.
    Unknown,
}

/// An exit from this machine. With the same source and router it may still be another network, if
/// the carrier was lost in between.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exit {
    interface: u32,
    /// The number of carrier changes of the interface.
    carrier: u64,
    source: Option<IpAddr>,
    router: Option<IpAddr>,
}

/// Returns the result of `look` when it differs from `before`. An unknown path does not count as a
/// difference. If `before` is unknown, the first known path replaces it. `changes` notifies of
/// possible differences.
pub async fn until_other<F: Future<Output = NetworkPath>>(
    mut changes: watch::Receiver<()>,
    mut before: NetworkPath,
    look: impl Fn() -> F,
) -> NetworkPath {
    loop {
        changes.mark_unchanged();
        let now = look().await;
        let changed = async {
            sleep(BETWEEN).await;
            if changes.changed().await.is_err() {
                std::future::pending().await
            }
        };
        match now {
            NetworkPath::Unknown => _ = timeout(ASK_AGAIN, changed).await,
            now if before == NetworkPath::Unknown || before == now => {
                before = now;
                changed.await;
            }
            now => return now,
        }
    }
}

/// Waits as [`until_other`] does, but until there is a path. The path must differ from the last
/// path, or the last lookup must have found none.
pub async fn until_led<F: Future<Output = NetworkPath>>(
    changes: watch::Receiver<()>,
    before: NetworkPath,
    look: impl Fn() -> F,
) {
    let mut way = before;
    loop {
        way = until_other(changes.clone(), way, &look).await;
        if let NetworkPath::By(_) = way {
            return;
        }
    }
}
