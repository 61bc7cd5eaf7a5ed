//! Unit tests of `cli::entity`.

use super::*;

#[test]
fn an_entity_is_a_name_a_key_file_or_a_prefix() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let robot = Identity::generate("proxy").unwrap();
    robot.save_new(file("robot.pem").as_ref()).unwrap();
    robot.key().save_new(file("bare.pem").as_ref()).unwrap();
    std::fs::write(file("junk"), "junk").unwrap();

    assert_eq!(parse_entity(&robot.name().to_string()), Ok(robot.name()));
    assert_eq!(parse_entity(&file("robot.pem")), Ok(robot.name()));
    assert_eq!(parse_entity_prefix(&file("robot.pem")).unwrap().full(), Some(robot.name()));
    assert_eq!(parse_entity_prefix("75e").unwrap().as_str(), "75e");
    for (text, needles) in [
        ("ROBOTS_NAME", ["64 hex digits", "gdp-ctl key show FILE", "the key's file"]),
        ("75e", ["64 hex digits", "gdp-ctl key show FILE", "the key's file"]),
        (&file("bare.pem"), ["bare.pem does not state its kind", "gdp-ctl key show", "--kind proxy"]),
        (&file("junk"), ["junk", "", ""]),
    ] {
        let error = parse_entity(text).unwrap_err();
        assert!(needles.iter().all(|needle| error.contains(needle)), "{error}");
        assert!(text == "75e" || parse_entity_prefix(text) == Err(error), "{text}");
    }
    assert_eq!(load(file("bare.pem").as_ref(), None).unwrap().name(), robot.name());
    let tool = load(file("robot.pem").as_ref(), Some(EntityKind::Tool)).unwrap();
    assert_eq!(tool.name(), Identity::new(robot.key().clone(), "tool").name());
    assert_eq!(parse_public_key(&file("robot.pem")), Ok(robot.key().verify_key()));
    assert!(parse_public_key("02").unwrap_err().contains("66 hex digits"));
}

#[test]
fn a_prefix_is_of_one_known_name() {
    let names = [[0x75; 32], [0x76; 32], [0x75; 32]].map(Name::from_bytes);
    let find = |prefix: &str| find(&prefix.parse().unwrap(), names.into_iter());
    assert_eq!(find("75").unwrap(), Some(names[0]));
    assert_eq!(find("8").unwrap(), None);
    let several = find("7").unwrap_err().to_string();
    assert!(several.contains(&names[1].to_string()) && several.contains("write more digits"), "{several}");
}
