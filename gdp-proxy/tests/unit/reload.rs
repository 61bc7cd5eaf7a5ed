//! Unit tests of `reload`.

use std::fs;

use super::*;
use crate::material::tests::{Files, watcher};

#[tokio::test]
async fn a_file_that_is_another_is_noticed_once_and_when_it_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (config, card) = (folder.path().join("proxy.yaml"), folder.path().join("t.card"));
    fs::write(&config, "a").unwrap();
    fs::write(&card, "a").unwrap();
    let mut watch = Watch::new(&config, &FileWatcher::start()).unwrap();
    watch.look_at([card.as_path()]);
    assert!(!watch.files.has_changed());
    for file in [&config, &card] {
        fs::write(folder.path().join("new"), "b").unwrap();
        fs::rename(folder.path().join("new"), file).unwrap();
        let changed = tokio::time::timeout(Duration::from_secs(20), watch.changed());
        changed.await.unwrap();
        assert!(!watch.files.has_changed());
    }
    fs::remove_file(&card).unwrap();
    assert!(!watch.files.has_changed());
}

#[tokio::test]
async fn what_was_refused_is_tried_again_when_a_file_that_it_names_is_another_and_from_time_to_time() {
    let (files, soon) = (Files::new(), Duration::from_secs(20));
    let path = files.path("robot.yaml");
    let topic = "{topic: /chatter, direction: out, card: t.card, cert: t.ad}";
    let write = |topics: &str| {
        let text = format!("{{version: 1, identity: id.pem, links: [{{to: 'eth://r0'}}], topics: [{topics}]}}");
        fs::write(&path, text).unwrap();
    };
    write(topic);
    let loaded = Loaded::load(&path, &watcher()).unwrap();
    let mut watch = Watch::new(&path, &FileWatcher::start()).unwrap();
    watch.taken(&loaded);
    write(&topic.replace("t.ad", "new.ad"));
    tokio::time::timeout(soon, watch.changed()).await.unwrap();
    let refusal = loaded.load_again(&path, &watcher()).err().unwrap();
    assert!(watch.refused(&loaded, &refusal) && !watch.refused(&loaded, &refusal), "{refusal}");

    // No file is another one.
    assert!(watch.again.is_some() && !watch.files.has_changed());
    watch.again = Some(Instant::now());
    tokio::time::timeout(soon, watch.changed()).await.unwrap();
    assert!(!watch.refused(&loaded, &refusal), "it is the same that was said");

    fs::copy(files.path("t.ad"), files.path("new.ad")).unwrap();
    watch.again = None;
    tokio::time::timeout(soon, watch.changed()).await.unwrap();
    watch.taken(&loaded.load_again(&path, &watcher()).unwrap());
    assert!(watch.again.is_none());

    // Only another text mends it.
    write("mistake");
    let refusal = loaded.load_again(&path, &watcher()).err().unwrap();
    assert!(watch.refused(&loaded, &refusal) && watch.again.is_none(), "{refusal}");
}

#[test]
fn what_cannot_change_is_named_and_the_rest_is_taken() {
    let files = Files::new();
    let path = files.path("robot.yaml");
    let load = |text: &str| {
        fs::write(&path, text).unwrap();
        Loaded::load(&path, &watcher())
    };
    let text = "{version: 1, identity: id.pem, links: [{to: 'eth://r0'}], graphs: {a: {domain_id: 1}}, topics: [\
                {topic: /chatter, direction: out, card: t.card, cert: t.ad}]}";
    let loaded = load(text).unwrap();
    let cases = [
        ("eth://r0'}", "eth://r1'}", Some("links")),
        ("topics:", "state: s, topics:", Some("state")),
        ("topics:", "definitions: {ros2: [/opt]}, topics:", Some("definitions")),
        ("domain_id: 1", "domain_id: 2", Some("graphs.a")),
        ("{a: {domain_id: 1}}", "{b: {domain_id: 1}}", Some("graphs.a")),
        ("1}}", "1}, b: {domain_id: 2}}", None),
        ("/chatter", "/chitter", None),
        ("out,", "out, priority: 7,", None),
    ];
    for (from, to, expected) in cases {
        let changed = text
            .replacen(from, to, 1)
            .replace("direction", if to.contains("}, b") { "graph: a, direction" } else { "direction" });
        fs::write(&path, changed).unwrap();
        let refusal = loaded.load_again(&path, &watcher()).err().map(|error| error.to_string());
        match (expected, refusal) {
            (None, None) => {}
            (Some(key), Some(said)) if said.contains(&format!("robot.yaml: {key}: cannot change")) => {}
            (_, refusal) => panic!("{to}: {refusal:?}"),
        }
    }
    gdp_core::identity::SigningKey::generate().unwrap().save_new(&files.path("other.pem")).unwrap();
    fs::write(&path, text.replace("id.pem", "other.pem")).unwrap();
    let refusal = loaded.load_again(&path, &watcher()).err().unwrap().to_string();
    assert!(refusal.contains("topics[0].cert"), "{refusal}");
}
