//! Contenders are measured in turn, round after round: other load on the machine affects all of
//! them. Every other round runs in reverse order, so no contender always follows the same one.

use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressStyle};

use super::figure::Measure;

/// One measurement.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// The value in the figure's unit.
    pub value: f64,
    /// Frames sent, if they are followed to their end; otherwise 0.
    pub sent: u64,
    pub lost: u64,
}

/// A contender that is measured repeatedly.
pub struct Contender<'a> {
    pub series: &'static str,
    pub case: String,
    pub measure: Box<dyn FnMut() -> Result<Sample> + 'a>,
}

impl<'a> Contender<'a> {
    pub fn new(series: &'static str, case: impl Into<String>, measure: impl FnMut() -> Result<Sample> + 'a) -> Self {
        Self { series, case: case.into(), measure: Box::new(measure) }
    }
}

/// Measures all contenders `rounds` times, at least once. Shows the progress if stderr is a
/// terminal.
pub fn alternate(rounds: usize, mut contenders: Vec<Contender<'_>>) -> Result<Vec<Measure>> {
    let mut samples: Vec<Vec<Sample>> = contenders.iter().map(|_| Vec::new()).collect();
    let progress = ProgressBar::new(((rounds.max(1) + 1) * contenders.len()) as u64);
    progress.set_style(ProgressStyle::with_template("{wide_bar} {pos}/{len}, {eta} left: {msg}")?);
    // The first round warms up caches and neighbour tables.
    for round in 0..=rounds.max(1) {
        let mut order: Vec<usize> = (0..contenders.len()).collect();
        if round % 2 == 1 {
            order.reverse();
        }
        for i in order {
            crate::wait::check_interrupt()?;
            let Contender { series, case, measure } = &mut contenders[i];
            progress.set_message(format!("{series}, {case}"));
            let sample = measure().with_context(|| format!("{series}, {case}"))?;
            if round > 0 {
                samples[i].push(sample);
            }
            progress.inc(1);
        }
    }
    progress.finish_and_clear();
    let finished = contenders.into_iter().zip(samples).map(|(Contender { series, case, .. }, samples)| {
        let mut measure = Measure::new(series, case, samples.iter().map(|sample| sample.value).collect());
        let [sent, lost] = [|s: &Sample| s.sent, |s: &Sample| s.lost].map(|of| samples.iter().map(of).sum::<u64>());
        measure.lost_percent = (sent > 0).then(|| 100.0 * lost as f64 / sent as f64);
        measure
    });
    Ok(finished.collect())
}
