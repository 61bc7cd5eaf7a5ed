//! Mistakes in a configuration, and their messages.

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

#[test]
fn each_error_names_its_remedy() {
    let cases = [
        (
            "version: 1\nidentity: a\nlinks: [{to: '127.0.0.1:31415'}]\n",
            "is no link: did you mean udp://127.0.0.1:31415? at line 3",
        ),
        ("version: 1\nlinks:\n\t- to: udp://edge\n", "a tab; use spaces, because YAML allows no tabs here at line 3"),
        ("kind: proxy\n-----BEGIN PRIVATE KEY-----\nAAAA\n", "it is a private key, not a proxy configuration"),
        ("-----BEGIN GDP AD CERT-----\nAAAA\n", "it is a certificate to publish (GDP AD CERT), not a proxy"),
        ("{\"version\": 1, \"owner_key\": \"02\"}\n", "it is a name card, not a proxy configuration"),
    ];
    for (text, expected) in cases {
        let refusal = Config::parse(text, Path::new("p.yaml")).unwrap_err().to_string();
        assert!(refusal.starts_with("p.yaml: ") && refusal.contains(expected), "{refusal}");
        assert_eq!((refusal.lines().count(), refusal.matches(" at line").count() < 2), (1, true), "{refusal}");
    }
}
