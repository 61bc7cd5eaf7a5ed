//! Unit tests of `registration`.

use super::*;

const NODE: &str = "/bridge";

fn key(kind: RegistrationKind) -> Key {
    (kind, "/t".to_owned())
}

fn register(kind: RegistrationKind) -> RegistrationStep {
    RegistrationStep::Register { key: key(kind), kind: "*".to_owned() }
}

fn unregister(kind: RegistrationKind) -> RegistrationStep {
    RegistrationStep::Unregister { key: key(kind) }
}

fn listed(nodes: &[&str]) -> Vec<(String, Vec<String>)> {
    vec![("/t".to_owned(), nodes.iter().map(|node| (*node).to_owned()).collect())]
}

fn registered(kind: RegistrationKind) -> Registrations {
    let mut registrations = Registrations::default();
    registrations.want(key(kind), "*".to_owned());
    registrations.done(&register(kind));
    registrations
}

#[test]
fn what_the_master_forgot_is_registered_again() {
    for kind in [RegistrationKind::Publisher, RegistrationKind::Subscriber, RegistrationKind::Service] {
        let mut registrations = registered(kind);
        assert_eq!((registrations.next(), registrations.pending()), (None, 0));
        let all =
            SystemState { publishers: listed(&["/x", NODE]), subscribers: listed(&[NODE]), services: listed(&[NODE]) };
        assert_eq!(registrations.observe(NODE, &all), 0);
        // A subscriber asks once more because of who publishes.
        registrations.done(&register(kind));
        let others = SystemState { publishers: listed(&["/x", NODE]), subscribers: listed(&["/x"]), services: vec![] };
        let others = if kind == RegistrationKind::Publisher { SystemState::default() } else { others };
        assert_eq!(registrations.observe(NODE, &others), 1, "{kind:?}");
        assert_eq!((registrations.next(), registrations.run_of(&key(kind))), (Some(register(kind)), 1));
    }
}

#[test]
fn a_subscriber_asks_again_when_others_publish() {
    let mut registrations = registered(RegistrationKind::Subscriber);
    let state =
        |nodes: &[&str]| SystemState { publishers: listed(nodes), subscribers: listed(&[NODE]), services: vec![] };
    for nodes in [&["/a"][..], &["/a", "/b"], &["/b"]] {
        assert_eq!(registrations.observe(NODE, &state(nodes)), 0);
        assert_eq!(registrations.next(), Some(register(RegistrationKind::Subscriber)), "{nodes:?}");
        registrations.done(&register(RegistrationKind::Subscriber));
        registrations.observe(NODE, &state(nodes));
        assert_eq!(registrations.next(), None, "{nodes:?}");
    }
    registrations.observe(NODE, &SystemState { publishers: vec![], ..state(&[]) });
    assert_eq!(registrations.next(), Some(register(RegistrationKind::Subscriber)));
    assert_eq!(registrations.run_of(&key(RegistrationKind::Subscriber)), 0, "it was not forgotten");
}

#[test]
fn what_is_wanted_last_counts() {
    let mut registrations = registered(RegistrationKind::Publisher);
    registrations.leave(&key(RegistrationKind::Publisher));
    assert_eq!(registrations.next(), Some(unregister(RegistrationKind::Publisher)));
    registrations.want(key(RegistrationKind::Publisher), "*".to_owned());
    registrations.done(&unregister(RegistrationKind::Publisher));
    assert_eq!(registrations.next(), Some(register(RegistrationKind::Publisher)), "wanted while it was taken back");
    registrations.leave(&key(RegistrationKind::Publisher));
    registrations.done(&register(RegistrationKind::Publisher));
    assert_eq!(registrations.next(), Some(unregister(RegistrationKind::Publisher)), "given up while it was registered");
    registrations.done(&unregister(RegistrationKind::Publisher));
    assert_eq!((registrations.next(), registrations.pending()), (None, 0));
}

#[test]
fn what_is_refused_is_told_and_asked_again_later() {
    let mut registrations = Registrations::default();
    registrations.want(key(RegistrationKind::Publisher), "*".to_owned());
    registrations.refused(&register(RegistrationKind::Publisher), "no".to_owned());
    assert_eq!((registrations.next(), registrations.pending()), (None, 1));
    assert_eq!(registrations.refusals(), [(key(RegistrationKind::Publisher), "no".to_owned())]);
    registrations.observe(NODE, &SystemState::default());
    assert_eq!(registrations.next(), Some(register(RegistrationKind::Publisher)));
}
