//! Unit tests of `config::unknown`.

use std::path::Path;

use crate::config::Config;

#[test]
fn a_misspelt_key_is_named_with_its_line_and_with_what_was_meant() {
    let text = |topic: &str| {
        format!(
            "version: 1\nidentity: a\nlinks: [{{to: 'eth://r0'}}]\ntopics:\n  - topic: /chatter\n    {topic}\n    \
             card: c\n    cert: d\n"
        )
    };
    let cases = [
        ("dirction: out", "there is no key `dirction`; did you mean `direction`? at line 6, column 5"),
        ("Direction: out", "did you mean `direction`?"),
        ("max_hertz: 5", "did you mean `max_hz`?"),
        ("zzz: out", "there is no key `zzz`; there is topic, graph, type, direction, card,"),
        ("direction: inn", "there is no value `inn`; did you mean `in`? at line 6"),
        ("{direction: out, qos: {dept: 5}}", "did you mean `depth`?"),
    ];
    for (topic, expected) in cases {
        let topic = match topic.strip_prefix('{').and_then(|inner| inner.strip_suffix('}')) {
            Some(inner) => inner.replacen(", ", "\n    ", 1),
            None => topic.into(),
        };
        let refusal = Config::parse(&text(&topic), Path::new("p.yaml")).unwrap_err().to_string();
        assert!(refusal.starts_with("p.yaml: ") && refusal.contains(expected), "{refusal}");
        assert_eq!(refusal.lines().count(), 1);
    }
}
