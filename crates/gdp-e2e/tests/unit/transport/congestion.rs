//! Unit tests of `transport::congestion`.

use super::*;

const RTT: u64 = 20 * MS;

/// A path in steady state at this rate in bytes per second, and the time and bytes since its start.
fn steady(rate: u64) -> (Path, u64, u64) {
    let (mut path, mut now, mut sent) = (Path::new(), 0, 0);
    for _ in 0..200 {
        (now, sent) = (now + RTT, sent + bytes_in(rate, RTT));
        path.on_report(now, &sample(rate, sent));
    }
    assert!(matches!(path.phase, Phase::Steady { .. }), "{:?}", path.phase);
    (path, now, sent)
}

/// A round trip in which everything arrived.
fn sample(rate: u64, sent: u64) -> Sample {
    let delivered = bytes_in(rate, RTT);
    let rate = RateSample { bytes: delivered, interval: RTT, paused: false };
    Sample { rtt: Some(RTT), delivered, rate, acknowledged: sent, sent, ..Sample::default() }
}

/// As in Eifel: what arrived twice was not lost.
#[test]
fn a_reduction_for_needless_requests_is_undone() {
    const RATE: u64 = 10_000_000;
    for is_needless in [true, false] {
        let (mut path, mut now, mut sent) = steady(RATE);
        let before = path.bandwidth();
        let lost = bytes_in(RATE, RTT) / 2;
        for _ in 0..3 {
            (now, sent) = (now + RTT, sent + bytes_in(RATE, RTT));
            path.on_report(now, &Sample { lost, ..sample(RATE, sent) });
        }
        assert!(path.bandwidth() < before * 9 / 10, "{} of {before}", path.bandwidth());
        (now, sent) = (now + RTT, sent + bytes_in(RATE, RTT));
        let needless = if is_needless { 3 * lost } else { lost / 2 };
        path.on_report(now, &Sample { needless, ..sample(RATE, sent) });
        assert_eq!(path.bandwidth() >= before * 9 / 10, is_needless, "{} of {before}", path.bandwidth());
    }
}

/// Its reader had no processor, or its reports were lost.
#[test]
fn a_path_is_known_after_a_silence_in_which_everything_arrived() {
    const RATE: u64 = 10_000_000;
    for has_arrived in [true, false] {
        let (mut path, now, sent) = steady(RATE);
        let before = path.window();
        let under_way = 300_000;
        path.on_silence(under_way);
        assert_eq!(path.window(), INITIAL_WINDOW, "a test whether the path still exists");
        let delivered = if has_arrived { under_way } else { under_way / 2 };
        path.on_report(now + 200 * MS, &Sample { delivered, ..sample(RATE, sent) });
        assert!(!path.is_silent());
        assert_eq!(path.window() >= before, has_arrived, "{} of {before}", path.window());
    }
}
