//! Unit tests of `config::pattern`.

use super::*;

fn matches(pattern: &str, topic: &str) -> bool {
    is_meant(Thing::Topic, pattern, topic)
}

fn is_meant(thing: Thing, pattern: &str, name: &str) -> bool {
    Pattern::parse(pattern).unwrap().matches(thing, &TopicName::parse(name).unwrap())
}

#[test]
fn a_star_is_of_one_segment_and_two_are_of_any_number() {
    let cases = [
        ("/chatter", "/chatter", true),
        ("/chatter", "/chatter2", false),
        ("/*", "/chatter", true),
        ("/*", "/a/b", false),
        ("/**", "/a/b/c", true),
        ("/camera/**", "/camera", true),
        ("/camera/**", "/camera/left/image_raw", true),
        ("/camera/**", "/cameras/left", false),
        ("/**/image_raw", "/image_raw", true),
        ("/**/image_raw", "/a/b/image_raw", true),
        ("/**/image_raw", "/a/image_raw/b", false),
        ("/*/image_*", "/left/image_raw", true),
        ("/*/image_*", "/left/right/image_raw", false),
        ("/**/left/**/raw", "/left/left/x/raw", true),
        ("/a*b*c", "/abbc", true),
        ("/a*b*c", "/acb", false),
    ];
    for (pattern, topic, expected) in cases {
        assert_eq!(matches(pattern, topic), expected, "{pattern} {topic}");
    }
}

#[test]
fn what_ros_has_for_itself_is_meant_only_by_its_name() {
    for topic in ["/rosout", "/parameter_events", "/_hidden", "/a/_action/status", "/gdp_proxy", "/gdp_proxy_1"] {
        let any = ["/**", "/*", "/*/**", "/r*", "/a/**"].iter().any(|pattern| matches(pattern, topic));
        assert!(!any && matches(topic, topic), "{topic}");
    }
}

#[test]
fn services_that_every_node_has_are_meant_only_by_their_names() {
    let (service, action) = (Thing::Call(What::Service), Thing::Call(What::Action));
    for last in [
        "get_parameters",
        "set_parameters",
        "set_parameters_atomically",
        "describe_parameters",
        "list_parameters",
        "get_parameter_types",
        "get_type_description",
        "get_loggers",
        "set_logger_level",
        "_action/send_goal",
    ] {
        let name = format!("/a/{last}");
        for pattern in ["/**", "/a/**", "/*/*", "/a/get_*", "/a/*_parameters"] {
            assert!(!is_meant(service, pattern, &name), "{pattern} {name}");
        }
        assert!(is_meant(service, &name, &name), "{name}");
        assert_eq!(is_meant(service, &format!("/**/{last}"), &name), !last.contains('/'), "{name}");
    }
    assert!(is_meant(service, "/**", "/a/get_plan") && is_meant(service, "/**", "/get_parameters/now"));
    assert!(is_meant(action, "/**", "/a/get_parameters") && matches("/**", "/a/get_parameters"));
}

#[test]
fn what_is_no_pattern_is_refused() {
    for text in
        ["", "/", "chatter", "/a//b", "/a/", "/a**", "/***", "/[a]", "/a?", "/a b", &format!("/{}", "a".repeat(253))]
    {
        assert!(Pattern::parse(text).is_err(), "{text:?}");
    }
}

/// Against the definition, for all patterns of up to four segments and all names of up to four.
#[test]
fn matching_is_as_defined() {
    fn defined(pattern: &[&str], name: &[&str]) -> bool {
        match pattern {
            [] => name.is_empty(),
            ["**", rest @ ..] => (0..=name.len()).any(|skipped| defined(rest, &name[skipped..])),
            ["*", rest @ ..] => !name.is_empty() && defined(rest, &name[1..]),
            [first, rest @ ..] => name.first() == Some(first) && defined(rest, &name[1..]),
        }
    }
    let all = |parts: &[&'static str]| {
        let mut all: Vec<Vec<&str>> = parts.iter().map(|part| vec![*part]).collect();
        for from in 0.. {
            let Some(begin) = all.get(from).filter(|begin| begin.len() < 4).cloned() else { break };
            all.extend(parts.iter().map(|part| [&begin[..], &[*part]].concat()));
        }
        all
    };
    let mut matched = 0;
    for pattern in all(&["a", "*", "**"]) {
        for name in all(&["a", "b"]) {
            let (text, topic) = (format!("/{}", pattern.join("/")), format!("/{}", name.join("/")));
            assert_eq!(matches(&text, &topic), defined(&pattern, &name), "{text} {topic}");
            matched += usize::from(matches(&text, &topic));
        }
    }
    assert!(matched > 100, "{matched}");
}

#[test]
fn a_hostile_pattern_takes_no_longer_than_another() {
    let pattern = "/*a".to_owned() + &"*a".repeat(100);
    let topic = format!("/{}b", "a".repeat(200));
    assert!(!matches(&pattern, &topic));
}
