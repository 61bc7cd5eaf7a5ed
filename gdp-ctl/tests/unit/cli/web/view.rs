//! Lists of the page are bounded, and what needs a look is not behind the bound.

use serde_json::json;

use super::super::problems::tests::healthy;
use super::*;

fn named(number: u8) -> Name {
    Name::from_bytes([number; 32])
}

#[test]
fn many_names_are_bounded_with_the_busiest_and_labelled_first() {
    let (mut status, ..) = healthy();
    status["rib"]["names"] = json!(5000);
    status["busiest"] = json!([{"name": named(200), "frames": 64}, {"name": named(201), "frames": 640},
        {"name": named(202), "frames": 6400}]);
    let status: StatusReply = serde_json::from_value(status).unwrap();
    let roles = Roles { writers: vec![named(1)], readers: (1..=9).map(named).collect(), is_service: false };
    let mut roles: BTreeMap<_, _> = (0..=210).map(|number| (named(number), roles.clone())).collect();
    // The name of an endpoint is the busiest, and still not the first.
    roles.remove(&named(202));
    let attached = Some(BTreeMap::new());
    let mut names = NamesInUse { roles, attached, is_complete: true };
    let labels = Labels([(named(150), "/chatter\u{202e}".to_owned())].into());
    let shown = name_lines(&status, &names, &labels);
    assert_eq!((shown.rows.len(), shown.more), (MAX_ROWS, 4900));
    let first: Vec<_> = shown.rows.iter().take(4).map(|row| (row.name.name.clone(), row.frames)).collect();
    let expected = [(201, Some(640)), (200, Some(64)), (150, None), (0, None)];
    assert_eq!(first, expected.map(|(number, frames)| (named(number).to_string(), frames)));
    assert_eq!((shown.rows[0].readers.rows.len(), shown.rows[0].readers.more), (3, 6));
    assert!(shown.rows.iter().all(|row| row.kind == "topic"), "there are enough others");
    // Where the RIB has more names than are known here, it may be any kind.
    names.is_complete = false;
    let first = &name_lines(&status, &names, &labels).rows[0];
    assert_eq!((first.name.name.clone(), first.kind), (named(202).to_string(), "–"));
    assert_eq!(shown.rows[2].name.label.as_deref(), Some("/chatter\\u{202e}"));
}

#[test]
fn a_crowded_map_shows_this_switch_and_those_without_a_path() {
    let (_, mut topology, _) = healthy();
    let own = named(0x77);
    let lost = named(255);
    let switch = |name: Name, cost: Option<u64>| {
        let back = json!([{"switch": own, "cost": 5, "silent": false}]);
        json!({"switch": name, "bit": null, "cost": cost, "next": null, "run": 1, "number": 1, "rib": false,
            "borders": [], "neighbours": if cost.is_some() { back } else { json!([]) }})
    };
    let others = (0..80).map(|number| switch(named(number), Some(5))).chain([switch(lost, None)]);
    let near: Vec<_> = (0..80).map(|number| json!({"switch": named(number), "cost": 5, "silent": false})).collect();
    let mut this = switch(own, Some(0));
    this["neighbours"] = json!(near);
    topology["switches"] = json!(others.chain([this]).collect::<Vec<_>>());
    let topology: TopologyReply = serde_json::from_value(topology).unwrap();
    let (nodes, edges) = map(&topology, &NamesInUse::default(), &Labels::default());
    assert_eq!((nodes.rows.len(), nodes.more), (MAX_NODES, 22));
    assert!(nodes.rows[0].own && !nodes.rows[1].reached && nodes.rows[1].switch.name == lost.to_string());
    assert!(nodes.rows[2..].iter().all(|node| node.reached));
    // Links of switches that are not shown would have one end.
    assert_eq!(edges.len(), MAX_NODES - 2);
    assert!(edges.iter().all(|edge| edge.state == "up"));
}

#[test]
fn a_link_that_only_one_end_states_is_half_down() {
    let (_, mut topology, _) = healthy();
    topology["switches"][1]["neighbours"] = json!([]);
    let topology = serde_json::from_value(topology).unwrap();
    let (_, edges) = map(&topology, &NamesInUse::default(), &Labels::default());
    assert_eq!(edges.iter().map(|edge| edge.state).collect::<Vec<_>>(), ["half"]);
}

#[test]
fn members_that_need_a_look_come_first() {
    let member = |label: &str, state: &'static str| crate::cli::home::MemberOutput {
        label: label.into(),
        state,
        entity: None,
        fingerprint: None,
        expose: vec!["/camera/**".into()],
        import: vec![],
        read: vec![],
        until: 0,
        renews_until: 0,
    };
    let states = [("a", "online"), ("b", "revoked"), ("c", "pending"), ("d", "offline"), ("e", "online")];
    let members = states.map(|(label, state)| member(label, state)).into();
    let shown = robots(&RobotsOutput { members }, &Labels::default());
    assert_eq!(shown.rows.iter().map(|row| row.label.as_str()).collect::<String>(), "dcaeb");
}
