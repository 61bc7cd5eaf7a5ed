//! Which run of the RIB this switch follows. A later leader of several replicas has a higher one (of its [term](super::term)), as has a
//! RIB that started later, so what somebody says whose time is over is refused from the moment on that a later one has said
//! anything. Sans-IO.
//!
//! Runs may begin anew below: a clock went back, etcd was set up anew, or a RIB that ran alone became several replicas. So that a
//! switch is not stuck with a number that nobody reaches, it follows whichever RIB takes its report: that is where the topology says
//! that the RIB is now, and a replica says so only after etcd has said that it leads. Should both claim to be there, it asks again.

use std::time::Duration;

/// Between two reports that nothing but a refusal is the reason for.
const ASK_AGAIN: Duration = Duration::from_secs(30);

/// What a RIB said that is not the one that is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this switch follows run {follows:#x} of the RIB; the term of run {run:#x} is over")]
pub struct Fenced {
    pub follows: u64,
    pub run: u64,
    /// The switch is to report again, to find out who is the RIB: it was this one when it last did, or it was told something false.
    pub is_doubtful: bool,
}

#[derive(Debug, Default)]
pub struct Fence {
    follows: Option<u64>,
    /// The run that has taken this switch's last report.
    reported: Option<u64>,
    /// When a refusal was last a reason to report.
    asked: Option<Duration>,
    refused: u64,
}

impl Fence {
    /// The run that is followed, once there is one.
    pub fn follows(&self) -> Option<u64> {
        self.follows
    }

    /// How often something was refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Whether what a RIB of this run says is to be taken. `now`: on a clock that does not go back.
    pub fn admit(&mut self, run: u64, now: Duration) -> Result<(), Fenced> {
        match self.follows {
            Some(follows) if run < follows => {
                self.refused += 1;
                let is_long_ago = self.asked.is_none_or(|asked| now >= asked + ASK_AGAIN);
                let is_doubtful = self.reported == Some(run) || is_long_ago;
                self.asked = if is_doubtful { Some(now) } else { self.asked };
                Err(Fenced { follows, run, is_doubtful })
            }
            _ => {
                self.follows = Some(run);
                Ok(())
            }
        }
    }

    /// The RIB of this run has taken a report that was sent when `then` was followed. If another has said something since, that
    /// may be the later one.
    pub fn reported(&mut self, run: u64, then: Option<u64>) {
        self.reported = Some(run);
        if self.follows == then || self.follows < Some(run) {
            self.follows = Some(run);
        }
    }
}

#[cfg(test)]
mod tests {
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

    /// Leaders of two clusters of etcd, of which the second was set up while the first one's still led: they push as they like, and
    /// take reports only while they lead. Whatever happens before, the one that is left is followed in the end; and as long as runs
    /// rise, nobody is once a later one has pushed.
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
                    // Only the one that leads answers.
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
            // The last one is left: it has taken a report, or does when it is asked to.
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
}
