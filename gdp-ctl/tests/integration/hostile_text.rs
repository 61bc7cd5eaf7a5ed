//! Cards, certificates and invitations with terminal control characters in their texts. No command
//! prints or writes these characters unescaped.

use gdp_core::card::NameCard;
use gdp_core::identity::SigningKey;
use gdp_util::escape::is_control;

use crate::user::User;

/// ESC, BEL, CSI of C1, bidirectional controls, DEL, and a line feed that would forge a line.
const HOSTILE: &str = "/x\u{1b}]0;pwned\u{7}\u{1b}[2J\u{9b}31m\u{202e}\u{2066}\u{200f}\u{61c}\u{7f}\r\nvalid  yes\t";

/// Returns a user who has received a hostile card.
fn visited() -> User {
    let user = User::new();
    user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    let owner = SigningKey::load(&user.file("owner.pem")).unwrap();
    for (kind, topic) in [("topic", HOSTILE), ("service", HOSTILE), ("topic", "/plain")] {
        let card = NameCard::create(owner.verify_key(), kind, topic, HOSTILE, None).unwrap();
        card.save_new(&user.file(&format!("{kind}{}.card", topic.len()))).unwrap();
    }
    user
}

fn hostile(kind: &str) -> String {
    format!("{kind}{}.card", HOSTILE.len())
}

/// Checks that a command's output is harmless, and returns its lines on stdout.
fn printed(user: &User, arguments: &[&str]) -> Vec<String> {
    let output = user.run(arguments);
    let (stdout, stderr) = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes)).into();
    for text in [&stdout, &stderr] {
        assert!(!text.replace('\n', "").contains(is_control), "{arguments:?}: {text:?}");
    }
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    for line in lines(&stdout).iter().chain(&lines(&stderr)) {
        assert!(!line.starts_with("valid  yes"), "{arguments:?}: a forged line: {stdout}{stderr}");
    }
    lines(&stdout)
}

#[test]
fn a_hostile_card_is_shown_as_text() {
    let user = visited();
    let (topic, service) = (hostile("topic"), hostile("service"));
    let shown = printed(&user, &["name", "show", &topic]);
    assert_eq!(shown.len(), 6, "{shown:?}");
    let escaped =
        "/x\\u{1b}]0;pwned\\u{7}\\u{1b}[2J\\u{9b}31m\\u{202e}\\u{2066}\\u{200f}\\u{61c}\\u{7f}\\r\\nvalid  yes\\t";
    assert!(shown.contains(&format!("topic       {escaped}")), "{shown:?}");
    let listed = printed(&user, &["topic", "list", "-t", "--keyring", "."]);
    assert_eq!(listed, [format!("/plain [{escaped}]"), format!("{escaped} [{escaped}]")]);

    for arguments in [
        &["service", "list", "-t", "--keyring", "."][..],
        &["topic", "info", &topic, "--keyring", "."],
        &["topic", "echo", HOSTILE, "--keyring", "."],
        &["topic", "pub", "/plain", "std_msgs/msg/String", "--keyring", "."],
        &["service", "call", &service, "std_srvs/srv/Trigger", "--keyring", "."],
        &["grant", "add", &topic, "--key", "none.pem", "--read", "--entity", "x", "-o", "x"],
        &["grant", "list", &topic],
        &["domain", "show", &topic],
        &["cert", "show", &topic],
        &["query", &topic],
        &["name", "show", HOSTILE],
        &["-j", "name", "derive", &topic],
        &["-j", "name", "show", HOSTILE],
        &["-j", "name", "show", &topic, HOSTILE],
    ] {
        printed(&user, arguments);
    }
    // The value is unchanged; only its representation is harmless.
    let value = &printed(&user, &["-j", "name", "show", &topic])[0];
    let value: serde_json::Value = serde_json::from_str(value).unwrap();
    assert_eq!(value["metadata"]["topic"], HOSTILE);
}

#[test]
fn a_hostile_invitation_writes_a_harmless_configuration() {
    let user = User::new();
    user.json(&["domain", "init", "-o", "home"]);
    let at = "udp://a',\"budget\",'\u{1b}[2J\u{202e}:31415";
    let invite = ["domain", "invite", "--key", "home/domain.pem", "--role", "robot", "--at", at];
    let token = &printed(&user, &invite)[0];
    let shown = printed(&user, &["domain", "show", token]);
    assert_eq!(shown.len(), 8, "{shown:?}");
    printed(&user, &["domain", "join", token, "-o", "robot"]);
    let written = std::fs::read_to_string(user.file("robot/gdp.yaml")).unwrap();
    assert!(!written.replace('\n', "").contains(is_control), "{written:?}");
    let config: serde_json::Value = serde_saphyr::from_str(&written).unwrap();
    assert_eq!(config["links"], serde_json::json!([{"to": at}]), "{written}");
}
