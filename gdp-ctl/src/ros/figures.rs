//! Rate, size and age of messages over a window of the latest messages: the figures of `ros2 topic
//! hz`, `bw` and `delay`.

use std::collections::VecDeque;

/// Statistics of times in nanoseconds: mean, minimum, maximum, standard deviation, and number of
/// values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    pub mean: f64,
    pub min: i64,
    pub max: i64,
    pub deviation: f64,
    pub count: usize,
}

impl Spread {
    fn of(values: &VecDeque<i64>) -> Option<Self> {
        let count = values.len();
        let (min, max) = (*values.iter().min()?, *values.iter().max()?);
        let mean = values.iter().map(|value| *value as f64).sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (*value as f64 - mean).powi(2)).sum();
        Some(Self { mean, min, max, deviation: (squares / count as f64).sqrt(), count })
    }

    /// Returns the text after the first figure, as `ros2 topic hz` and `delay` print it.
    pub fn text(&self) -> String {
        format!(
            "\tmin: {:.3}s max: {:.3}s std dev: {:.5}s window: {}",
            seconds(self.min as f64),
            seconds(self.max as f64),
            seconds(self.deviation),
            self.count
        )
    }
}

/// Converts nanoseconds to seconds.
pub fn seconds(nanos: f64) -> f64 {
    nanos * 1e-9
}

/// The latest values, and whether any is new.
struct Window {
    most: usize,
    values: VecDeque<i64>,
    is_new: bool,
}

impl Window {
    fn new(most: usize) -> Self {
        Self { most, values: VecDeque::new(), is_new: false }
    }

    fn add(&mut self, value: i64) {
        self.values.push_back(value);
        if self.values.len() > self.most {
            self.values.pop_front();
        }
        self.is_new = true;
    }

    /// Returns the statistics, or `None` if there is no new value.
    fn spread(&mut self) -> Option<Spread> {
        std::mem::take(&mut self.is_new).then(|| Spread::of(&self.values)).flatten()
    }
}

/// Times between messages.
pub struct Intervals {
    window: Window,
    last: Option<u64>,
}

impl Intervals {
    /// Creates a window of the latest `most` intervals.
    pub fn new(most: usize) -> Self {
        Self { window: Window::new(most), last: None }
    }

    /// Records a message that arrived at time `now` in nanoseconds.
    pub fn record(&mut self, now: u64) {
        if let Some(last) = self.last {
            self.window.add(now.saturating_sub(last) as i64);
        }
        self.last = Some(now);
    }

    /// Returns the statistics, if a message has arrived since the last call.
    pub fn spread(&mut self) -> Option<Spread> {
        self.window.spread()
    }
}

/// Ages of messages.
pub struct Delays(Window);

impl Delays {
    /// Creates a window of the latest `most` messages.
    pub fn new(most: usize) -> Self {
        Self(Window::new(most))
    }

    /// Records a message of this age in nanoseconds. The age is negative if the sender's clock is
    /// ahead.
    pub fn record(&mut self, age: i64) {
        self.0.add(age);
    }

    pub fn is_empty(&self) -> bool {
        self.0.values.is_empty()
    }

    /// Returns the statistics, if a message has arrived since the last call.
    pub fn spread(&mut self) -> Option<Spread> {
        self.0.spread()
    }
}

/// Sizes of messages in bytes, and their arrival times.
pub struct Sizes {
    most: usize,
    messages: VecDeque<(u64, usize)>,
}

/// Figures of the messages in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bandwidth {
    pub bytes_per_s: f64,
    pub count: usize,
    pub mean: f64,
    pub min: usize,
    pub max: usize,
}

impl Sizes {
    /// Creates a window of the latest `most` messages.
    pub fn new(most: usize) -> Self {
        Self { most, messages: VecDeque::new() }
    }

    pub fn record(&mut self, now: u64, bytes: usize) {
        self.messages.push_back((now, bytes));
        if self.messages.len() > self.most {
            self.messages.pop_front();
        }
    }

    /// Returns the figures from the first message of the window until now; `None` for fewer than
    /// two messages.
    pub fn bandwidth(&self, now: u64) -> Option<Bandwidth> {
        let (first, count) = (self.messages.front()?.0, self.messages.len());
        let time = seconds(now.saturating_sub(first) as f64);
        if count < 2 || time <= 0.0 {
            return None;
        }
        let sizes = || self.messages.iter().map(|(_, bytes)| *bytes);
        let (total, min, max) = (sizes().sum::<usize>() as f64, sizes().min()?, sizes().max()?);
        Some(Bandwidth { bytes_per_s: total / time, count, mean: total / count as f64, min, max })
    }
}

impl Bandwidth {
    /// Returns the text as `ros2 topic bw` prints it. All sizes have the unit of the first.
    pub fn text(&self) -> String {
        let unit = |bytes: f64| match self.bytes_per_s {
            few if few < 1e3 => format!("{bytes:.0} B"),
            some if some < 1e6 => format!("{:.2} KB", bytes / 1e3),
            _ => format!("{:.2} MB", bytes / 1e6),
        };
        let [rate, mean, min, max] = [self.bytes_per_s, self.mean, self.min as f64, self.max as f64].map(unit);
        format!("{rate}/s from {} messages\n\tMessage size mean: {mean} min: {min} max: {max}", self.count)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros/figures.rs"]
mod tests;
