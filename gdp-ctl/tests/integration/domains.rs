//! Domains at the command line, with only a key and a card.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Stdio;

use crate::user::User;
use gdp_daemon::config::Config;
use serde_json::Value;

#[test]
fn members_are_admitted_listed_and_taken_back() {
    let user = User::new();
    let home = user.json(&["domain", "init", "-o", "home"]);
    let mode = |file: &str| std::fs::metadata(user.file(file)).unwrap().permissions().mode() & 0o7777;
    assert_eq!((mode("home/domain.pem"), mode("home/domain.card") & 0o044), (0o600, 0o044));
    assert!(user.refusal(1, &["domain", "init", "-o", "home"]).contains("not overwritten"));
    let switch = key(&user, "s1", "switch");

    let admitted = admit(&user, &switch, "border", "s1.member");
    assert_eq!((&admitted["kind"], &admitted["claims"]["domain"]), (&"MemberCert".into(), &home["name"]));
    let show = ["domain", "show", "s1.member", "--card", "home/domain.card"];
    let shown = user.json(&show);
    assert_eq!((&shown["verified"], &shown["claims"]["role"]), (&true.into(), &"border".into()));
    key(&user, "owner", "owner");
    user.card("/chatter");
    let of_name = user.refusal(1, &["domain", "show", "s1.member", "--card", "chatter.card"]);
    assert!(of_name.contains("wrong domain"), "{of_name}");
    let again = ["domain", "admit", "--key", "home/domain.pem", &switch, "--role", "border", "-o", "s1.member"];
    assert!(user.refusal(1, &again).contains("not overwritten"));
    let role = ["domain", "admit", "--key", "home/domain.pem", &switch, "--role", "Boss!", "-o", "x"];
    assert!(user.refusal(1, &role).contains("a role has 1 to 32 characters"));
    let other = ["domain", "admit", "--key", "s1.pem", &switch, "--role", "switch", "-o", "x"];
    assert!(user.refusal(1, &other).contains("s1.card"), "no domain's key");
    let listed = user.json(&["domain", "show", "home/domain.card"]);
    assert_eq!(states(&listed), ["valid"]);
    assert_eq!(listed["issued"][0]["to"]["member"]["entity"], switch.as_str());
    assert_eq!(mode("home/domain.card.members"), 0o600);

    let output = user.run(&["-j", "domain", "revoke", "--key", "home/domain.pem", "--entity", &switch]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("no effect yet"), "{said}");
    assert!(user.refusal(1, &show).contains("revoked: the MemberCert"));
    assert_eq!(states(&user.json(&["domain", "show", "home/domain.card"])), ["revoked"]);
    // A renewal makes it a member again.
    admit(&user, "s1.pem", "switch", "s1.renewed");
    let shown = user.json(&["domain", "show", "s1.renewed", "--card", "home/domain.card"]);
    assert_eq!(shown["verified"], true);
    let by_digits = user.json(&["domain", "revoke", "--key", "home/domain.pem", "--entity", &switch[..8]]);
    assert_eq!(by_digits["revoked"].as_array().unwrap().len(), 2);
    let nobody = user.refusal(1, &["domain", "revoke", "--key", "home/domain.pem", "--entity", "owner.pem"]);
    assert!(nobody.contains("nothing was issued to") && nobody.contains("gdp-ctl domain show"), "{nobody}");
    let all = user.json(&["domain", "revoke", "--key", "home/domain.pem", "--all"]);
    assert!(all["revoked"].as_array().unwrap().is_empty() && all["number"].as_u64() > Some(1_000_000), "{all}");
    assert_eq!(states(&user.json(&["domain", "show", "home/domain.card"])), ["revoked", "revoked"]);
    assert!(user.refusal(3, &["domain", "revoke", "--key", "home/domain.pem"]).contains("no daemon answers"));
}

#[test]
fn times_are_spans_on_the_command_line_and_dates_in_the_output() {
    let user = User::new();
    user.text(&["domain", "init", "-o", "home"]);
    let domain = user.text(&["key", "show", "home/domain.pem"]);
    assert!(domain.starts_with("domain ") && domain.ends_with(" home/domain.pem\n"), "{domain}");
    let robot = key(&user, "robot", "proxy");
    let admit = ["domain", "admit", "--key", "home/domain.pem", &robot, "--role", "arm", "--for", "3h", "-o", "member"];
    let admitted = user.json(&admit);
    let seconds = |claims: &Value, from: &str, to: &str| claims[to].as_u64().unwrap() - claims[from].as_u64().unwrap();
    assert_eq!(seconds(&admitted["claims"], "not_before", "not_after"), 3 * 3600 + 300);
    let shown = user.text(&["cert", "show", "member"]);
    assert!(shown.contains("not_after   20") && shown.contains("Z, in 3 h\n"), "{shown}");
    assert!(shown.contains("not_before  20") && shown.contains("Z, 5 min ago\n"), "{shown}");

    let invite = ["domain", "invite", "--key", "home/domain.pem", "--role", "arm", "--at", "udp://edge"];
    let line = user.text(&invite);
    let claims = user.json(&["domain", "show", line.trim_end()])["claims"].clone();
    assert_eq!(seconds(&claims, "not_before", "not_after"), 24 * 3600 + 300);
    let member = seconds(&claims, "not_before", "member_until") - 365 * 86400;
    assert!((300..310).contains(&member), "{member}");
    let line = user.text(&[&invite[..], &["--for", "30m", "--member-for", "7d"]].concat());
    let shown = user.text(&["domain", "show", line.trim_end()]);
    assert!(shown.contains("Z, in 30 min\n") && shown.contains("Z, in 7 d\n"), "{shown}");
    let joined = user.text(&["domain", "join", line.trim_end(), "-o", "arm"]);
    assert!(joined.contains("Z, in 7 d: arm/gdp.yaml, to which you add topics or expose"), "{joined}");
}

#[test]
fn domains_let_each_other_do_things() {
    let user = User::new();
    user.json(&["domain", "init", "-o", "home"]);
    let away = user.json(&["domain", "init", "-o", "away"]);
    let away = away["name"].as_str().unwrap();
    let peer = ["domain", "peer", "--key", "home/domain.pem", away, "--rights"];
    let issued = user.json(&[&peer[..], &["peering,visit", "-o", "away.peer"]].concat());
    let rights = serde_json::json!({"peering": true, "transit": false, "visit": true});
    assert_eq!((&issued["claims"]["rights"], &issued["claims"]["peer"]), (&rights, &away.into()));
    let shown = user.json(&["cert", "show", "away.peer", "--card", "home/domain.card"]);
    assert_eq!((&shown["kind"], &shown["verified"]), (&"PeerCert".into(), &true.into()));
    let foreign = user.refusal(1, &["cert", "show", "away.peer", "--card", "away/domain.card"]);
    assert!(foreign.contains("wrong key"), "{foreign}");
    assert!(user.refusal(2, &[&peer[..], &["all", "-o", "x"]].concat()).contains("is no right"));
    user.json(&["domain", "revoke", "--key", "home/domain.pem", "away.peer"]);
    let revoked = user.refusal(1, &["cert", "show", "away.peer", "--card", "home/domain.card"]);
    assert!(revoked.contains("revoked: the PeerCert"), "{revoked}");
    let own = user.json(&["domain", "show", "home/domain.card"])["name"].as_str().unwrap().to_owned();
    let own = ["domain", "peer", "--key", "home/domain.pem", &own, "--rights", "visit", "-o", "x"];
    assert!(user.refusal(1, &own).contains("no peer of its own"));
}

#[test]
fn an_invitation_is_one_line_that_makes_a_member() {
    let user = User::new();
    user.json(&["domain", "init", "-o", "home"]);
    let edge = key(&user, "edge", "switch");
    let invite = ["domain", "invite", "--key", "home/domain.pem", "--role", "switch"];
    let place = ["--at", "udp://192.0.2.7:31415", "--switch", &edge];
    let line = user.text(&[&invite[..], &place].concat());
    let line = line.trim_end();
    assert!(line.starts_with("gdp1") && line.lines().count() == 1 && !line.contains(' '), "{line}");
    assert!(user.refusal(1, &[&invite[..], &place[..2]].concat()).contains("--switch"));
    let by_name = [&invite[..], &["--at", "udp://edge.example", "--switch", &edge]].concat();
    assert!(user.refusal(1, &by_name).contains("dials an address"));

    let shown = user.json(&["domain", "show", line]);
    assert_eq!((&shown["claims"]["role"], &shown["switch"]), (&"switch".into(), &edge.as_str().into()));
    assert!(!user.text(&["domain", "show", line]).contains("gdp1"), "it is not repeated");
    assert!(user.refusal(1, &["domain", "show", &line[..line.len() - 4]]).contains("damaged"));

    // Read the invitation from stdin, so that process lists do not show it.
    let mut join = user.command(&["-j", "domain", "join", "-", "-o", "s2"]);
    let mut join = join.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::io::Write::write_all(&mut join.stdin.take().unwrap(), line.as_bytes()).unwrap();
    let output = join.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let joined: Value = serde_json::from_slice(&output.stdout).unwrap();
    let member = user.json(&["domain", "show", "s2/membership", "--card", "home/domain.card"]);
    assert_eq!((&member["verified"], &member["claims"]["entity"]), (&true.into(), &joined["name"]));
    assert_eq!(member["invite"]["serial"], shown["claims"]["serial"]);

    let config = Config::load(&user.file("s2/gdp.yaml")).unwrap();
    let uplink = &config.neighbours[0].address;
    assert_eq!((uplink.switch.to_string(), uplink.via.to_string()), (edge, "udp 192.0.2.7:31415".into()));
    assert!(config.neighbours[0].dial && !config.rib);
    let files = config.domain.unwrap().files;
    assert_eq!(files.load().unwrap().membership.cert.claims_unverified().unwrap().role, "switch");
    assert_eq!(config.identity, user.file("s2/switch.pem"));
    assert!(user.refusal(1, &["domain", "join", line, "-o", "s2"]).contains("not overwritten"));

    // An invitation for a robot with an existing key.
    let invite = ["domain", "invite", "--key", "home/domain.pem", "--role", "arm", "--at", "udp://edge.example:31415"];
    let robot = key(&user, "robot", "proxy");
    let line = user.text(&invite);
    let joined = user.json(&["domain", "join", line.trim_end(), "-o", "arm", "--identity", "robot.pem"]);
    assert_eq!(joined["name"], robot.as_str());
    let written = std::fs::read_to_string(user.file("arm/gdp.yaml")).unwrap();
    assert!(written.contains("udp://edge.example:31415") && written.contains("domain.card"), "{written}");
    // The domain revokes the invitation, identified by the membership file created from it.
    user.json(&["domain", "revoke", "--key", "home/domain.pem", "arm/membership"]);
    let revoked = user.refusal(1, &["domain", "show", "arm/membership", "--card", "home/domain.card"]);
    assert!(revoked.contains("revoked: the Invite"), "{revoked}");
    assert_eq!(states(&user.json(&["domain", "show", "home/domain.card"])), ["valid", "revoked"]);
}

fn states(listed: &Value) -> Vec<&str> {
    listed["issued"].as_array().unwrap().iter().map(|issue| issue["state"].as_str().unwrap()).collect()
}

/// Creates a key file and returns the name of its entity.
fn key(user: &User, label: &str, kind: &str) -> String {
    let file = format!("{label}.pem");
    assert!(!Path::new(&file).exists());
    user.json(&["key", "generate", &file, "--kind", kind])["name"].as_str().unwrap().to_owned()
}

fn admit(user: &User, entity: &str, role: &str, file: &str) -> Value {
    user.json(&["domain", "admit", "--key", "home/domain.pem", entity, "--role", role, "-o", file])
}
