//! How often messages come, how large and how old they are, over a window of the last ones: the
//! figures of `ros2 topic hz`, `bw` and `delay`.

use std::collections::VecDeque;

/// Times in nanoseconds: the mean, the least, the greatest, the standard deviation, and of how
/// many.
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

    /// As `ros2 topic hz` and `delay` go on behind the first figure.
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

/// Of nanoseconds.
pub fn seconds(nanos: f64) -> f64 {
    nanos * 1e-9
}

/// The last values, and whether any is new.
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

    /// Nothing if nothing is new.
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
    /// Of the last `most` intervals.
    pub fn new(most: usize) -> Self {
        Self { window: Window::new(most), last: None }
    }

    /// A message came, at this time of a clock in nanoseconds.
    pub fn record(&mut self, now: u64) {
        if let Some(last) = self.last {
            self.window.add(now.saturating_sub(last) as i64);
        }
        self.last = Some(now);
    }

    /// If a message came since.
    pub fn spread(&mut self) -> Option<Spread> {
        self.window.spread()
    }
}

/// Ages of messages.
pub struct Delays(Window);

impl Delays {
    /// Of the last `most` messages.
    pub fn new(most: usize) -> Self {
        Self(Window::new(most))
    }

    /// A message came that was as old, in nanoseconds; less than nothing if its clock is ahead.
    pub fn record(&mut self, age: i64) {
        self.0.add(age);
    }

    pub fn is_empty(&self) -> bool {
        self.0.values.is_empty()
    }

    /// If a message came since.
    pub fn spread(&mut self) -> Option<Spread> {
        self.0.spread()
    }
}

/// Bytes of messages, and when they came.
pub struct Sizes {
    most: usize,
    messages: VecDeque<(u64, usize)>,
}

/// Of the messages in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bandwidth {
    pub bytes_per_s: f64,
    pub count: usize,
    pub mean: f64,
    pub min: usize,
    pub max: usize,
}

impl Sizes {
    /// Of the last `most` messages.
    pub fn new(most: usize) -> Self {
        Self { most, messages: VecDeque::new() }
    }

    pub fn record(&mut self, now: u64, bytes: usize) {
        self.messages.push_back((now, bytes));
        if self.messages.len() > self.most {
            self.messages.pop_front();
        }
    }

    /// From the first message of the window until now; nothing of fewer than two.
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
    /// As `ros2 topic bw` says it: all sizes in the unit of the first.
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
