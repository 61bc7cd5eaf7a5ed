//! Results: what was measured, and how it compares. The JSON of `bench … --json` is these types; a
//! change of their meaning raises [`VERSION`]. How they look to people is in `table` and `plot`.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;

/// Of the JSON.
const VERSION: u32 = 2;

#[derive(Serialize)]
pub struct Report {
    v: u32,
    kernel: String,
    cpus: usize,
    figures: Vec<Figure>,
}

/// What was measured in turn in one unit, and the ratios of that.
#[derive(Serialize)]
pub struct Figure {
    pub name: &'static str,
    pub title: String,
    pub unit: Unit,
    pub measures: Vec<Measure>,
    pub ratios: Vec<Ratio>,
    /// Series of which each is the one before and something more, and what that is: for the plot.
    #[serde(skip)]
    pub stacked: Vec<(&'static str, &'static str)>,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    FramesPerSecond,
    NamesPerSecond,
    MessagesPerSecond,
    /// Of whatever the title says, thousands and few.
    PerSecond,
    EachSecond,
    BytesPerSecond,
    Bytes,
    /// Few: of one of many.
    BytesEach,
    Nanoseconds,
    Milliseconds,
    /// Of CPU time.
    SecondsPerGigabyte,
}

/// What one contender reached: median, lowest and highest of the rounds.
#[derive(Serialize)]
pub struct Measure {
    /// Who.
    pub series: &'static str,
    /// At what, the same for all who are compared.
    pub case: String,
    #[serde(flatten)]
    pub spread: Spread,
    /// Of the frames sent, where they are followed to their end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost_percent: Option<f64>,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// One value a round.
    #[serde(skip)]
    pub rounds: Vec<f64>,
}

/// How many times as much `series` reached as `over`: of the rounds' ratios, because what else the
/// machine does changes both.
#[derive(Serialize)]
pub struct Ratio {
    pub series: &'static str,
    pub over: &'static str,
    pub case: String,
    #[serde(flatten)]
    pub spread: Spread,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
}

/// What was to be reached, and whether the median did.
#[derive(Clone, Copy, Serialize)]
pub struct Verdict {
    pub aim: Aim,
    pub met: bool,
}

#[derive(Clone, Copy, Serialize)]
pub struct Spread {
    pub median: f64,
    pub low: f64,
    pub high: f64,
}

#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Aim {
    AtLeast(f64),
    AtMost(f64),
}

impl Report {
    pub fn new(figures: Vec<Figure>) -> Result<Self> {
        let file = Path::new("/proc/sys/kernel/osrelease");
        let kernel = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        let cpus = std::thread::available_parallelism().context("cannot count the processors")?.get();
        Ok(Self { v: VERSION, kernel: kernel.trim().to_owned(), cpus, figures })
    }
}

impl Figure {
    pub fn new(name: &'static str, title: impl Into<String>, unit: Unit, measures: Vec<Measure>) -> Self {
        Self { name, title: title.into(), unit, measures, ratios: Vec::new(), stacked: Vec::new() }
    }

    /// Adds the ratio of two series in each case that both have. `aim`: of a case, if it has one.
    pub fn compare(self, series: &'static str, over: &'static str, aim: impl Fn(&str) -> Option<Aim>) -> Self {
        self.compare_cases(series, |case| (over, case.to_owned()), aim)
    }

    /// Adds the ratio of each case of a series to one case of another.
    pub fn compare_with(
        self,
        series: &'static str,
        (over, case): (&'static str, &str),
        aim: impl Fn(&str) -> Option<Aim>,
    ) -> Self {
        self.compare_cases(series, |_| (over, case.to_owned()), aim)
    }

    fn compare_cases(
        mut self,
        series: &'static str,
        other: impl Fn(&str) -> (&'static str, String),
        aim: impl Fn(&str) -> Option<Aim>,
    ) -> Self {
        for ours in self.measures.iter().filter(|measure| measure.series == series) {
            let (over, case) = other(&ours.case);
            let Some(theirs) = self.measure(over, &case).filter(|theirs| !std::ptr::eq(*theirs, ours)) else {
                continue;
            };
            let spread = Spread::of(ours.rounds.iter().zip(&theirs.rounds).map(|(ours, theirs)| ours / theirs));
            let verdict = aim(&ours.case).map(|aim| aim.verdict(spread.median));
            self.ratios.push(Ratio { series, over, case: ours.case.clone(), spread, verdict });
        }
        self
    }

    /// What a series is to reach in a case, in the figure's unit.
    pub fn aim(mut self, series: &str, case: &str, aim: Aim) -> Self {
        for measure in self.measures.iter_mut().filter(|measure| measure.series == series && measure.case == case) {
            measure.verdict = Some(aim.verdict(measure.spread.median));
        }
        self
    }

    pub fn stack(mut self, stacked: impl Into<Vec<(&'static str, &'static str)>>) -> Self {
        self.stacked = stacked.into();
        self
    }

    pub fn measure(&self, series: &str, case: &str) -> Option<&Measure> {
        self.measures.iter().find(|measure| measure.series == series && measure.case == case)
    }
}

impl Measure {
    /// `rounds`: at least one value.
    pub fn new(series: &'static str, case: impl Into<String>, rounds: Vec<f64>) -> Self {
        let spread = Spread::of(rounds.iter().copied());
        Self { series, case: case.into(), spread, lost_percent: None, verdict: None, rounds }
    }
}

impl Spread {
    /// Of at least one value.
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        let (middle, last) = (sorted.len() / 2, sorted.len() - 1);
        let median = if sorted.len() % 2 == 1 { sorted[middle] } else { (sorted[middle - 1] + sorted[middle]) / 2.0 };
        Self { median, low: sorted[0], high: sorted[last] }
    }
}

impl Aim {
    fn verdict(self, value: f64) -> Verdict {
        let met = match self {
            Self::AtLeast(least) => value >= least,
            Self::AtMost(most) => value <= most,
        };
        Verdict { aim: self, met }
    }

    /// For people.
    pub fn shown(self, number: impl Fn(f64) -> String) -> String {
        match self {
            Self::AtLeast(least) => format!("≥ {}", number(least)),
            Self::AtMost(most) => format!("≤ {}", number(most)),
        }
    }

    pub fn value(self) -> f64 {
        let (Self::AtLeast(value) | Self::AtMost(value)) = self;
        value
    }
}

impl Unit {
    /// For people; of columns of numbers the name is [`Self::name`].
    pub fn show(self, value: f64) -> String {
        format!("{} {}", self.number(value), self.name())
    }

    pub fn number(self, value: f64) -> String {
        match self {
            Self::FramesPerSecond | Self::NamesPerSecond => format!("{:.3}", value / 1e6),
            Self::MessagesPerSecond | Self::PerSecond => format!("{:.2}", value / 1e3),
            Self::BytesPerSecond | Self::Bytes => format!("{:.1}", value / 1e6),
            Self::Nanoseconds | Self::BytesEach | Self::EachSecond => format!("{value:.1}"),
            Self::Milliseconds | Self::SecondsPerGigabyte => format!("{value:.2}"),
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::FramesPerSecond => "Mpps",
            Self::NamesPerSecond => "M names/s",
            Self::MessagesPerSecond => "k messages/s",
            Self::PerSecond => "k/s",
            Self::EachSecond => "/s",
            Self::BytesPerSecond => "MB/s",
            Self::Bytes => "MB",
            Self::BytesEach => "B",
            Self::Nanoseconds => "ns",
            Self::Milliseconds => "ms",
            Self::SecondsPerGigabyte => "s/GB",
        }
    }
}
