//! Unit tests of `log`.

use std::io::Write;
use std::sync::Arc;

use super::*;

#[test]
fn without_rust_log_only_errors_are_logged_of_other_crates() {
    let text = logged(|| {
        tracing::info!(target: "gdp_ctl::serve", "ours");
        tracing::debug!(target: "gdp_proxy", "details");
        tracing::warn!(target: "netlink_proto::handle", "noise");
        tracing::info!(target: "rustdds::network", "noise");
        tracing::error!(target: "quinn", "an error");
    });
    let lines: Vec<_> = text.lines().filter_map(|line| line.split_once("Z ")).map(|(_, line)| line.trim()).collect();
    assert_eq!(lines, ["INFO gdp_ctl::serve: ours", "ERROR quinn: an error"]);
}

#[test]
fn what_a_stranger_wrote_stays_on_its_line_and_is_shown_as_text() {
    let hostile = "a\x1b[31m\n2026 ERROR fake\u{202e}\u{9b}";
    let text = logged(|| {
        let _span = tracing::info_span!("span", peer = hostile, shown = %hostile).entered();
        tracing::info!(reason = %hostile, text = hostile, debug = ?Some(hostile), count = 1, "message {hostile}");
        tracing::info!(hostile);
    });
    assert_eq!(text.lines().count(), 2, "{text}");
    assert!(!text.replace('\n', "").contains(crate::escape::is_control), "{text:?}");
    let escaped = "a\\u{1b}[31m\\n2026 ERROR fake\\u{202e}\\u{9b}";
    for part in [
        format!("span{{peer=\"{escaped}\" shown={escaped}}}"),
        format!("message {escaped} reason={escaped} text=\"{escaped}\" debug=Some(\"{escaped}\") count=1"),
    ] {
        assert!(text.contains(&part), "{text}\nhas no\n{part}");
    }
}

fn logged(what: impl FnOnce()) -> String {
    let output = Buffer::default();
    let filter = EnvFilter::new(DEFAULT_FILTER);
    let subscriber = format(filter, false).with_writer(std::sync::Mutex::new(output.clone())).finish();
    tracing::subscriber::with_default(subscriber, what);
    String::from_utf8(output.0.lock().unwrap().clone()).unwrap()
}

#[derive(Clone, Default)]
struct Buffer(Arc<std::sync::Mutex<Vec<u8>>>);

impl Write for Buffer {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
