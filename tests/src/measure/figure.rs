//! Results: measurements and how they compare. These types are the JSON of `bench … --json`; a
//! change of their meaning raises [`VERSION`]. `table` and `plot` render them for people.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;

/// Version of the JSON.
const VERSION: u32 = 2;

#[derive(Serialize)]
pub struct Report {
    v: u32,
    kernel: String,
    cpus: usize,
    figures: Vec<Figure>,
}

/// Measurements of one unit that were taken in turn, and their ratios.
#[derive(Serialize)]
pub struct Figure {
    pub name: &'static str,
    pub title: String,
    pub unit: Unit,
    pub measures: Vec<Measure>,
    pub ratios: Vec<Ratio>,
    /// For the plot: series that each contain the previous one, and the name of what each adds.
    #[serde(skip)]
    pub stacked: Vec<(&'static str, &'static str)>,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    FramesPerSecond,
    NamesPerSecond,
    MessagesPerSecond,
    /// Rates of the subject in the title: thousands, or few.
    PerSecond,
    EachSecond,
    BytesPerSecond,
    Bytes,
    /// Few bytes: of one item among many.
    BytesEach,
    Nanoseconds,
    Milliseconds,
    /// Seconds of CPU time.
    SecondsPerGigabyte,
}

/// The result of one contender: median, lowest and highest of the rounds.
#[derive(Serialize)]
pub struct Measure {
    /// The contender.
    pub series: &'static str,
    /// The case, the same for all contenders in the comparison.
    pub case: String,
    #[serde(flatten)]
    pub spread: Spread,
    /// Share of the frames sent, if they are followed to their end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost_percent: Option<f64>,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// One value per round.
    #[serde(skip)]
    pub rounds: Vec<f64>,
}

/// The ratio of `series` to `over`. It uses the rounds' ratios, because other load on the machine
/// affects both.
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

/// The aim, and whether the median reached it.
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

    /// Adds the ratio of two series in each case that both have. `aim`: the case's aim, if it has
    /// one.
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

    /// Sets the aim of a series in a case, in the figure's unit.
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
    /// Summarises the rounds. `rounds`: at least one value.
    pub fn new(series: &'static str, case: impl Into<String>, rounds: Vec<f64>) -> Self {
        let spread = Spread::of(rounds.iter().copied());
        Self { series, case: case.into(), spread, lost_percent: None, verdict: None, rounds }
    }
}

impl Spread {
    /// Returns the spread of at least one value.
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

    /// Formats the aim for people.
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
    /// Formats a value with its unit for people; a column of numbers has [`Self::name`] as its
    /// heading.
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
