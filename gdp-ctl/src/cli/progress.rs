//! Shows what a command waits for.

use std::time::Duration;

use gdp_util::escape::Escaped;
use indicatif::{ProgressBar, ProgressStyle};

/// Interval between two pictures of the spinner.
const TICK: Duration = Duration::from_millis(120);

/// Awaits `done`. Meanwhile shows `what` and the seconds on stderr, if it is a terminal.
pub async fn while_waiting<T>(what: &str, done: impl Future<Output = T>) -> T {
    let spinner = ProgressBar::new_spinner().with_message(Escaped(what).to_string());
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} ({elapsed})") {
        spinner.set_style(style);
    }
    spinner.enable_steady_tick(TICK);
    let done = done.await;
    spinner.finish_and_clear();
    done
}
