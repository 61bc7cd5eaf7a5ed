//! Unit tests of `serve::revocation_store`.

use std::sync::atomic::AtomicUsize;
use std::sync::mpsc;

use tokio::sync::Notify;

use super::*;

#[tokio::test]
async fn many_changes_are_written_together_and_a_write_counts_though_nobody_waits_for_it() {
    let (keeper, writes, started) = (RevocationStore::new(0), Arc::new(AtomicUsize::new(0)), Arc::new(Notify::new()));
    let (go, gate) = mpsc::channel::<()>();
    let gate = Arc::new(parking_lot::Mutex::new(gate));
    let keep = |changes: u64| {
        let (writes, started, gate) = (writes.clone(), started.clone(), gate.clone());
        let write = move |()| {
            writes.fetch_add(1, Ordering::Relaxed);
            started.notify_one();
            // Block until the test drops the other end.
            let _ = gate.lock().recv();
            Ok(())
        };
        keeper.keep(changes, || Some((50, ())), write)
    };
    tokio::select! {
        _ = keep(1) => panic!("it is not written yet"),
        () = started.notified() => {}
    }
    drop(go);
    let kept = futures::future::join_all((1..=50).map(keep)).await;
    assert!(kept.iter().all(Result::is_ok));
    assert_eq!(writes.load(Ordering::Relaxed), 1);
}
