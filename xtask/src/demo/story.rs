//! Prints the story of a demo, and computes the figures that all demos share.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_tests::fabric::{TOPIC, TYPE};
use gdp_tests::peers::{self, Received};
use serde::Serialize;
use serde_json::Value;

use crate::demo::options::TEXT;

/// The latency from a talker's `write` to a listener's callback, in microseconds.
#[derive(Serialize)]
pub struct Latency {
    pub p50: f64,
    pub p90: f64,
    pub p99: f64,
    pub max: f64,
}

impl Latency {
    pub fn of(received: &[Received]) -> Self {
        let mut sorted: Vec<Duration> = received.iter().map(|message| message.latency).collect();
        sorted.sort();
        let at = |percent| peers::percentile(&sorted, percent).as_nanos() as f64 / 1000.0;
        Self { p50: at(50.0), p90: at(90.0), p99: at(99.0), max: at(100.0) }
    }
}

/// Returns the number of messages that arrived intact.
pub fn arrived(received: &[Received]) -> u64 {
    received.iter().filter(|m| m.intact).map(|m| m.sequence).collect::<BTreeSet<_>>().len() as u64
}

/// The words searched for in a captured frame, and those found (none).
#[derive(Serialize)]
pub struct Seen {
    pub looked_for: Vec<String>,
    pub found: Vec<String>,
}

impl Seen {
    pub fn look(frame: &[u8]) -> Self {
        let words = [TOPIC, TYPE, TEXT, "chatter", "std_msgs", "String", "hello"];
        let found = words.iter().filter(|word| contains(frame, word.as_bytes()));
        Self { looked_for: words.map(String::from).into(), found: found.map(|word| word.to_string()).collect() }
    }
}

fn contains(haystack: &[u8], needle: &[u8]) -> bool {
    haystack.windows(needle.len()).any(|window| window.eq_ignore_ascii_case(needle))
}

pub fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The printed story of a demo.
pub struct Story {
    pub silent: bool,
}

impl Story {
    pub fn say(&self, line: &str) {
        if !self.silent {
            println!("{line}");
        }
    }

    pub fn name(&self, name: &str) {
        self.say(&format!("\nThe topic {TOPIC} ({TYPE}) of this owner is now, and for ever, called\n  {name}"));
        self.say("  = SHA-256(\"gdp/name/1\" ‖ owner's public key ‖ SHA-256(metadata)); the switches see only this");
    }

    pub fn message(&self, message: &Received) {
        let micros = message.latency.as_micros();
        self.say(&format!(
            "  message {:>6}  {:>8} B  {micros:>6} µs after it was written",
            message.sequence, message.bytes
        ));
    }

    pub fn result(&self, sent: u64, received: u64, latency: &Latency) {
        let Latency { p50, p90, p99, max } = latency;
        self.say(&format!("\n{sent} sent, {received} received, {} lost", sent - received));
        self.say(&format!("One way, DDS to DDS: p50 {p50:.0} µs, p90 {p90:.0} µs, p99 {p99:.0} µs, max {max:.0} µs"));
    }

    /// Prints a frame that was captured at `place`. Its GDP header begins at `start`.
    pub fn capture(&self, place: &str, seen: &Seen, frame: &[u8], start: usize) {
        self.say(&format!("\nOne frame {place} ({} bytes):", frame.len()));
        let parts = [
            ("around it", 0..start),
            ("header", start..start + 32),
            ("destination name", start + 32..start + 64),
            ("source name", start + 64..start + 96),
            ("sealed", start + 96..frame.len()),
        ];
        for (what, range) in parts {
            for (i, line) in frame.get(range).unwrap_or_default().chunks(32).enumerate() {
                let hex: String = line.iter().map(|byte| format!("{byte:02x}")).collect();
                self.say(&format!("  {:<17} {hex}", if i == 0 { what } else { "" }));
            }
        }
        let words = seen.looked_for.join(", ");
        match seen.found.as_slice() {
            [] => self.say(&format!("Looked for {words}: nothing of it is there.")),
            found => self.say(&format!("FOUND IN CLEAR: {}", found.join(", "))),
        }
    }
}
