//! Unit tests of `capabilities`.

use super::*;

#[test]
fn the_kernel_says_the_same_in_proc() {
    let status = std::fs::read_to_string("/proc/thread-self/status").expect("status");
    let line = |key| status.lines().find_map(|line| line.strip_prefix(key)).expect("a line").trim().to_owned();
    let sets = Sets::read().expect("capget");
    assert_eq!(format!("{:016x}", sets.effective), line("CapEff:"));
    assert_eq!(format!("{:016x}", sets.permitted), line("CapPrm:"));
}

#[test]
fn sys_admin_stands_for_what_it_was_before() {
    assert!(includes(bit(SYS_ADMIN), BPF) && includes(bit(SYS_ADMIN), PERFMON));
    assert!(!includes(bit(SYS_ADMIN), NET_ADMIN) && !includes(bit(BPF), PERFMON));
}

/// Runs in a separate thread, which ends with its dropped capabilities.
#[test]
fn what_is_not_kept_is_lost_for_good() {
    let lost = std::thread::spawn(|| {
        keep_only(&[]).expect("less is always permitted");
        let sets = Sets::read().expect("capget");
        let again = Sets { effective: bit(NET_RAW), permitted: bit(NET_RAW) }.write();
        ((sets.effective, sets.permitted), again.is_err(), missing(&SWITCH).len())
    });
    assert_eq!(lost.join().expect("no panic"), ((0, 0), true, 4));
}
