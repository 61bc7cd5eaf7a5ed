//! Unit tests of `graph`.

use super::*;

fn of(entries: &[(&str, &[&str])]) -> Vec<(String, Vec<String>)> {
    let owned = |nodes: &[&str]| nodes.iter().map(|node| (*node).to_owned()).collect();
    entries.iter().map(|(name, nodes)| ((*name).to_owned(), owned(nodes))).collect()
}

fn set(nodes: &[&str]) -> BTreeSet<String> {
    nodes.iter().map(|node| (*node).to_owned()).collect()
}

#[test]
fn changes_are_what_came_went_and_became_known() {
    let kinds = |kind: &str| BTreeMap::from([("/a".to_owned(), kind.to_owned())]);
    let first = SystemState {
        publishers: of(&[("/a", &["/p"])]),
        subscribers: of(&[("/a", &["/s"]), ("/b", &["/s"])]),
        services: of(&[("/x", &["/p"])]),
    };
    let second = SystemState { subscribers: of(&[("/a", &["/s"])]), services: of(&[("/y", &["/p"])]), ..first.clone() };
    let (first, second) = (Snapshot::new(&first, &kinds("*"), &[]), Snapshot::new(&second, &kinds("a/B"), &[]));
    assert_eq!(first.changes_since(&first), []);
    assert_eq!(first.topics["/a"].kind, None);
    let topic = Topic { kind: Some("a/B".to_owned()), publishers: set(&["/p"]), subscribers: set(&["/s"]) };
    assert_eq!(
        second.changes_since(&first),
        [
            Change::Topic { name: "/a".to_owned(), topic },
            Change::TopicRemoved { name: "/b".to_owned() },
            Change::Service { name: "/y".to_owned(), nodes: set(&["/p"]) },
            Change::ServiceRemoved { name: "/x".to_owned() },
        ]
    );
    assert_eq!(first.changes_since(&Snapshot::default()).len(), 3);
}

#[test]
fn who_is_connected_is_there_though_the_master_has_forgotten_it() {
    let publisher = PublisherInfo {
        uri: "http://p:1/".to_owned(),
        caller_id: "/p".to_owned(),
        kind: "a/B".to_owned(),
        md5sum: "0".repeat(32),
        definition: String::new(),
        latching: false,
    };
    let connected = [("/a".to_owned(), Arc::new(publisher))];
    let snapshot = Snapshot::new(&SystemState::default(), &BTreeMap::new(), &connected);
    let topic = Topic { kind: Some("a/B".to_owned()), publishers: set(&["/p"]), subscribers: BTreeSet::new() };
    assert_eq!(snapshot.topics, BTreeMap::from([("/a".to_owned(), topic)]));
}
