//! Unit tests of `leadership::fence`.

use super::*;

const NOW: Duration = Duration::from_secs(1000);

#[test]
fn a_leader_of_yesterday_is_refused_and_counted() {
    let mut fence = Fence::default();
    fence.reported(7, None);
    assert_eq!([fence.admit(7, NOW), fence.admit(7, NOW)], [Ok(()); 2]);
    assert_eq!(fence.admit(9, NOW), Ok(()), "another was elected, which the topology does not say yet");
    assert_eq!(fence.admit(7, NOW), Err(Fenced { follows: 9, run: 7, is_doubtful: true }));
    fence.reported(9, Some(9));
    let refused = fence.admit(7, NOW).unwrap_err();
    assert!(!refused.is_doubtful && refused.to_string().contains("run 0x9"), "{refused}");
    assert_eq!((fence.refused(), fence.admit(9, NOW)), (2, Ok(())));
}

#[test]
fn runs_may_begin_anew() {
    let mut fence = Fence::default();
    assert_eq!(fence.admit(900, NOW), Ok(()));
    assert!(fence.admit(5, NOW).is_err(), "a clock that went back looks the same");
    fence.reported(5, Some(900));
    assert_eq!((fence.admit(5, NOW), fence.follows()), (Ok(()), Some(5)));
}

#[test]
fn a_false_answer_to_a_report_is_found_out() {
    let mut fence = Fence::default();
    fence.reported(u64::MAX, None);
    assert!(fence.admit(5, NOW).is_err_and(|fenced| fenced.is_doubtful));
    fence.reported(u64::MAX, Some(u64::MAX));
    let soon = NOW + ASK_AGAIN / 2;
    assert!(fence.admit(5, soon).is_err_and(|fenced| !fenced.is_doubtful), "who is over may go on pushing");
    assert!(fence.admit(5, NOW + ASK_AGAIN).is_err_and(|fenced| fenced.is_doubtful));
    fence.reported(5, Some(u64::MAX));
    assert_eq!(fence.admit(5, NOW + ASK_AGAIN), Ok(()));
}

#[test]
fn an_answer_that_comes_late_brings_nobody_back() {
    let mut fence = Fence::default();
    fence.reported(7, None);
    let then = fence.follows();
    assert_eq!(fence.admit(9, NOW), Ok(()));
    fence.reported(7, then);
    assert!(fence.admit(7, NOW).is_err_and(|fenced| fenced.is_doubtful));
    assert_eq!(fence.admit(9, NOW), Ok(()));
}

/// Simulates the leaders of two etcd clusters. The second cluster was set up while the leader of
/// the first still led.
///
/// Leaders push at any time, and accept reports only while they lead. Whatever happens before, the
/// switch follows the last leader in the end. As long as runs rise, it follows no leader after a
/// later one has pushed.
#[test]
fn whoever_is_the_rib_in_the_end_is_followed() {
    let mut random = 1u64;
    let mut below = move |bound: u64| {
        random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (random >> 33) % bound
    };
    for round in 0..2000 {
        let rises = round % 2 == 0;
        let (mut fence, mut report, mut highest) = (Fence::default(), None, 0);
        let runs: Vec<u64> = (1..=3).map(|i| if rises { i * 10 } else { below(40) }).collect();
        let mut leads = 0;
        for _ in 0..below(40) {
            match below(4) {
                // Only the current leader answers.
                0 => report = Some((runs[leads], fence.follows())),
                1 => {
                    if let Some((run, then)) = report.take() {
                        fence.reported(run, then);
                    }
                }
                2 => leads = (leads + below(2) as usize).min(2),
                _ => {
                    let run = runs[below(leads as u64 + 1) as usize];
                    let admitted = fence.admit(run, NOW).is_ok();
                    assert!(!rises || admitted == (run >= fence.follows().unwrap()));
                    if admitted {
                        highest = highest.max(run);
                    }
                    assert!(!rises || Some(highest) <= fence.follows());
                }
            }
        }
        // The last leader is left: it has accepted a report, or does on the next one.
        let last = runs[leads];
        if let Some((run, then)) = report.take() {
            fence.reported(run, then);
        }
        fence.reported(last, fence.follows());
        for dying in &runs[..leads] {
            let _ = fence.admit(*dying, NOW);
        }
        if let Err(fenced) = fence.admit(last, NOW) {
            assert!(fenced.is_doubtful && !rises);
            fence.reported(last, fence.follows());
        }
        assert_eq!((fence.admit(last, NOW), fence.follows()), (Ok(()), Some(last)));
    }
}
