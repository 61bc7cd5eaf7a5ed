//! Issuing and revoking grants as an owner does, with only a key and a card.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixListener;

use crate::user::User;
use gdp_core::card::NameCard;
use gdp_core::cert::{MemberCert, Membership, Revocation, Signed};
use gdp_core::identity::Identity;
use gdp_proto::admin::{Reply, Request, parse_request, reply_line};
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Response};
use serde_json::Value;

#[test]
fn grants_are_remembered_listed_and_taken_back() {
    let (user, [robot, cloud]) = (owner(), ["robot", "cloud"]);
    let (robot, cloud) = (entity(&user, robot), entity(&user, cloud));
    assert_eq!(user.json(&["grant", "list", "chatter.card"])["grants"], Value::Array(vec![]));
    let ad = grant(&user, &["--publish", "--entity", &robot, "-o", "robot.ad"]);
    grant(&user, &["--read", "--entity", &robot, "-o", "robot.grant"]);
    grant(&user, &["--read", "--entity", &cloud, "-o", "cloud.grant", "--for", "1h"]);
    let mode = std::fs::metadata(user.file("chatter.card.grants")).unwrap().permissions().mode();
    assert_eq!(mode & 0o7777, 0o600);

    let listed = user.json(&["grant", "list", "chatter.card"]);
    assert_eq!(states(&listed), ["valid", "valid", "valid"]);
    assert_eq!(listed["grants"][0]["serial"], ad["serial"]);
    assert_eq!(listed["grants"][0]["to"]["entity"], robot.as_str());
    assert!(listed["revocation"].is_null());
    let text = user.text(&["grant", "list", "chatter.card"]);
    assert!(text.contains("until 20") && text.contains("Z, in 365 d") && text.contains("Z, in 60 min"), "{text}");
    assert!(text.contains("robot.ad"), "{text}");

    // Without a daemon, the command records the revocation and reports that it is not published.
    let output = user.run(&["-j", "grant", "revoke", "chatter.card", "--key", "owner.pem", "--entity", &robot]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("no effect yet"), "{said}");
    let revoked: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&revoked["number"], &revoked["published"]), (&1.into(), &false.into()));
    assert_eq!(revoked["revoked"].as_array().unwrap().len(), 2);
    let listed = user.json(&["grant", "list", "chatter.card"]);
    assert_eq!(states(&listed), ["revoked", "revoked", "valid"]);
    assert!(user.refusal(1, &["cert", "show", "robot.ad", "--card", "chatter.card"]).contains("revoked: the AdCert"));
    assert_eq!(user.json(&["cert", "show", "cloud.grant", "--card", "chatter.card"])["verified"], true);
    let shown = user.json(&["cert", "show", "chatter.card.revocation", "--card", "chatter.card"]);
    assert_eq!((&shown["kind"], &shown["verified"]), (&"Revocation".into(), &true.into()));
    assert!(user.refusal(3, &["grant", "revoke", "chatter.card"]).contains("no daemon answers"));

    // Revoke one grant by its file; earlier revocations remain.
    let revoked = user.json(&["grant", "revoke", "chatter.card", "cloud.grant", "--key", "owner.pem"]);
    assert_eq!((&revoked["number"], revoked["revoked"].as_array().unwrap().len()), (&2.into(), 3));
    // Revoke all at once, then issue new grants.
    let all = user.json(&["grant", "revoke", "chatter.card", "--all", "--key", "owner.pem"]);
    assert!(all["number"].as_u64() > Some(1_000_000) && all["revoked"].as_array().unwrap().is_empty(), "{all}");
    grant(&user, &["--read", "--entity", &cloud, "-o", "anew.grant"]);
    let listed = user.json(&["grant", "list", "chatter.card"]);
    assert_eq!(states(&listed), ["revoked", "revoked", "revoked", "valid"]);
    assert_eq!(user.json(&["cert", "show", "anew.grant", "--card", "chatter.card"])["verified"], true);
}

#[test]
fn an_entity_is_revoked_by_its_key_file_or_its_first_digits() {
    let user = owner();
    let (robot, cloud) = (entity(&user, "robot"), entity(&user, "cloud"));
    grant(&user, &["--publish", "--entity", "robot.pem", "-o", "robot.ad"]);
    grant(&user, &["--read", "--entity", "cloud.pem", "-o", "cloud.grant"]);
    let listed = user.json(&["grant", "list", "chatter.card"]);
    assert_eq!(listed["grants"][0]["to"]["entity"], robot.as_str());
    let revoke = |whom: &str| user.json(&["grant", "revoke", "chatter.card", "--key", "owner.pem", "--entity", whom]);
    // Two random names have their first 8 digits in common once in four billion runs.
    assert_eq!(revoke(&cloud[..8])["revoked"].as_array().unwrap().len(), 1);
    assert_eq!(states(&user.json(&["grant", "list", "chatter.card"])), ["valid", "revoked"]);
    revoke("robot.pem");
    assert_eq!(states(&user.json(&["grant", "list", "chatter.card"])), ["revoked", "revoked"]);
}

#[test]
fn a_renewal_has_the_same_rights_and_replaces_the_file() {
    let user = owner();
    let home = Identity::generate("domain").unwrap().name().to_string();
    entity(&user, "robot");
    std::fs::create_dir(user.file("robot")).unwrap();
    let publish = ["--publish", "--entity", "robot.pem", "--scope", &home, "--for", "7d", "-o", "robot/chatter.ad"];
    let first = grant(&user, &publish);
    grant(&user, &["--read", "--role", "arm", "--domain", &home, "-o", "arms.grant"]);
    std::fs::set_permissions(user.file("robot/chatter.ad"), PermissionsExt::from_mode(0o640)).unwrap();
    std::fs::copy(user.file("chatter.card"), user.file("robot/chatter.card")).unwrap();

    // By its file: the card beside it has no ledger, that in this folder has.
    let renew = ["grant", "renew", "--key", "owner.pem"];
    let second = user.json(&[&renew[..], &["robot/chatter.ad"]].concat());
    for key in ["name", "entity", "scope"] {
        assert_eq!(second["claims"][key], first["claims"][key], "{key}");
    }
    let end = |issued: &Value| issued["claims"]["not_after"].as_u64().unwrap();
    assert!((0..60).contains(&(end(&second) - end(&first))), "as long as before: {first} {second}");
    let serial = |issued: &Value| issued["serial"].as_str().unwrap().parse::<u64>().unwrap();
    assert!(serial(&second) > serial(&first));
    let mode = std::fs::metadata(user.file("robot/chatter.ad")).unwrap().permissions().mode();
    assert_eq!(mode & 0o7777, 0o640, "permissions stay");
    let shown = user.json(&["cert", "show", "robot/chatter.ad", "--card", "chatter.card"]);
    assert_eq!((&shown["verified"], &shown["claims"]), (&true.into(), &second["claims"]));

    // By the card: each file once, and longer.
    let text = user.text(&[&renew[..], &["chatter.card", "--for", "30d"]].concat());
    assert_eq!((text.lines().count(), text.matches("Z, in 30 d\n").count()), (2, 2), "{text}");
    assert_eq!(user.json(&["grant", "list", "chatter.card"])["grants"].as_array().unwrap().len(), 5);
    let arms = user.json(&["cert", "show", "arms.grant", "--card", "chatter.card"]);
    assert_eq!((&arms["verified"], &arms["claims"]["to"]["role"]["role"]), (&true.into(), &"arm".into()));

    // A file that went away is told, and what is revoked is not renewed.
    std::fs::remove_file(user.file("arms.grant")).unwrap();
    let output = user.run(&[&renew[..], &["chatter.card"]].concat());
    let warned = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && warned.contains("arms.grant is not renewed"), "{warned}");
    user.json(&["grant", "revoke", "chatter.card", "robot/chatter.ad", "--key", "owner.pem"]);
    let refused = user.refusal(1, &[&renew[..], &["robot/chatter.ad"]].concat());
    assert!(refused.contains("it is revoked") && refused.contains("grant add"), "{refused}");
    std::fs::remove_file(user.file("chatter.card.grants")).unwrap();
    let unknown = user.refusal(1, &[&renew[..], &["robot/chatter.ad"]].concat());
    assert!(unknown.contains("no name card beside it or in this folder has a ledger with it"), "{unknown}");
}

#[test]
fn a_delegate_grants_until_the_owner_takes_that_back() {
    let user = owner();
    let robot = entity(&user, "robot");
    let delegate = user.json(&["key", "generate", "delegate.pem", "--kind", "owner"]);
    let key = delegate["public_key"].as_str().unwrap();
    grant(&user, &["--publish", "--delegate", key, "--for", "1d", "-o", "delegation"]);

    // The delegate uses copies, and records its grants in its own ledger.
    std::fs::copy(user.file("chatter.card"), user.file("copy.card")).unwrap();
    let add = ["grant", "add", "copy.card", "--key", "delegate.pem", "--delegation", "delegation", "--entity", &robot];
    let ad = user.json(&[&add[..], &["--publish", "-o", "robot.ad"]].concat());
    let shown = user.json(&["cert", "show", "robot.ad", "--card", "chatter.card"]);
    assert_eq!((&shown["verified"], &shown["delegation"]["delegate"]), (&true.into(), &key.into()));
    assert_eq!(ad["claims"]["not_after"], shown["delegation"]["not_after"], "not longer than the delegation");
    let renewed = user.json(&["grant", "renew", "robot.ad", "--key", "delegate.pem"]);
    assert_eq!(renewed["claims"]["not_after"], shown["delegation"]["not_after"], "under the same delegation");
    let refused = user.refusal(1, &[&add[..], &["--read", "-o", "robot.grant"]].concat());
    assert!(refused.contains("not delegated") && !user.file("robot.grant").exists(), "{refused}");
    let foreign = ["grant", "add", "copy.card", "--key", "robot.pem", "--delegation", "delegation", "--publish"];
    let refused = user.refusal(1, &[&foreign[..], &["--entity", &robot, "-o", "x"]].concat());
    assert!(refused.contains("for another key"), "{refused}");
    let refused = user.refusal(1, &["grant", "revoke", "copy.card", "robot.ad", "--key", "delegate.pem"]);
    assert!(refused.contains("only the owner revokes"), "{refused}");
    assert_eq!(user.json(&["grant", "list", "copy.card"])["grants"].as_array().unwrap().len(), 2);

    user.json(&["grant", "revoke", "chatter.card", "--delegate", key, "--key", "owner.pem"]);
    let refused = user.refusal(1, &["cert", "show", "robot.ad", "--card", "chatter.card"]);
    assert!(refused.contains("revoked: the Delegation"), "{refused}");
}

#[test]
fn a_grant_to_a_role_is_read_with_the_domains_part_behind_it() {
    let user = owner();
    let domain = Identity::generate("domain").unwrap();
    let reader = Identity::generate("proxy").unwrap();
    let home = domain.name().to_string();
    grant(&user, &["--read", "--role", "operator", "--domain", &home, "-o", "operators.grant"]);
    let listed = user.json(&["grant", "list", "chatter.card"]);
    assert_eq!(listed["grants"][0]["to"]["role"]["role"], "operator");
    let show = |file| user.json(&["cert", "show", file, "--card", "chatter.card"]);
    assert_eq!(show("operators.grant")["verified"], true);

    for (role, refused) in [("operator", None), ("guest", Some("wrong role"))] {
        let (domain_name, entity, role) = (domain.name(), reader.name(), role.to_owned());
        let claims = MemberCert { domain: domain_name, entity, role, serial: 1, not_before: 0, not_after: u64::MAX };
        let member = Membership::issue(&domain, &claims).unwrap();
        let both = std::fs::read_to_string(user.file("operators.grant")).unwrap() + &member.to_pem();
        std::fs::write(user.file("mine.grant"), both).unwrap();
        match refused {
            None => assert_eq!(show("mine.grant")["member"]["entity"], reader.name().to_string()),
            Some(why) => {
                let said = user.refusal(1, &["cert", "show", "mine.grant", "--card", "chatter.card"]);
                assert!(said.contains(why), "{said}");
            }
        }
    }
    let add = ["grant", "add", "chatter.card", "--key", "owner.pem", "--read", "--domain", &home, "-o", "x"];
    let said = user.refusal(1, &[&add[..], &["--role", "Boss!"]].concat());
    assert!(said.contains("a role has 1 to 32 characters"), "{said}");
}

/// The simulated daemon verifies requests, and refuses the second.
#[test]
fn a_revocation_is_published_where_a_daemon_answers() {
    let user = owner();
    let robot = entity(&user, "robot");
    let card = NameCard::load(&user.file("chatter.card")).unwrap();
    let listener = UnixListener::bind(user.file("ctl.sock")).unwrap();
    let proof = card.proof();
    let daemon = std::thread::spawn(move || {
        let refusal = Refusal::new(RefusalCode::ReplayedSerial, "rolled back: revocation 1 does not replace 5");
        let answers = [Reply::Control(Response::Done), Reply::Error(refusal.into())];
        answers.map(|answer| {
            let (stream, _) = listener.accept().unwrap();
            let mut line = Vec::new();
            BufReader::new(&stream).read_until(b'\n', &mut line).unwrap();
            (&stream).write_all(reply_line(&answer).as_bytes()).unwrap();
            parse_request(&line).unwrap()
        })
    });
    let ad = grant(&user, &["--publish", "--entity", &robot, "-o", "robot.ad"]);
    let serial = ad["serial"].as_str().unwrap();
    let done = user.json(&["grant", "revoke", "chatter.card", serial, "--key", "owner.pem"]);
    assert_eq!((&done["number"], &done["published"]), (&1.into(), &true.into()));
    let refused = user.refusal(1, &["grant", "revoke", "chatter.card"]);
    assert!(refused.contains("--all") && refused.contains("rolled back"), "{refused}");

    let expected =
        Revocation { name: card.name(), number: 1, floor: 0, revoked: vec![serial.parse().unwrap()], signer: None };
    for request in daemon.join().unwrap() {
        let Request::Entity { entity: None, request } = request else { panic!("{request:?}") };
        let EntityRequest::Revoke { proof: shown, revocation } = *request else { panic!("{request:?}") };
        assert_eq!((shown, revocation.verify(card.owner_key(), 0)), (proof, Ok(expected.clone())));
    }
}

#[test]
fn commands_at_once_lose_no_grant() {
    let user = owner();
    let robot = entity(&user, "robot");
    std::thread::scope(|scope| {
        for i in 0..8 {
            let (user, robot) = (&user, &robot);
            scope.spawn(move || grant(user, &["--read", "--entity", robot, "-o", &format!("{i}.grant")]));
        }
    });
    let listed = user.json(&["grant", "list", "chatter.card"]);
    let serials: Vec<u64> =
        listed["grants"].as_array().unwrap().iter().map(|g| g["serial"].as_str().unwrap().parse().unwrap()).collect();
    assert!(serials.len() == 8 && serials.is_sorted_by(|a, b| a < b), "{serials:?}");
}

#[test]
fn what_was_tampered_with_is_not_believed() {
    let user = owner();
    let robot = entity(&user, "robot");
    grant(&user, &["--publish", "--entity", &robot, "-o", "robot.ad"]);
    user.json(&["grant", "revoke", "chatter.card", "robot.ad", "--key", "owner.pem"]);
    let file = user.file("chatter.card.revocation");
    let ours = std::fs::read_to_string(&file).unwrap();
    let name = Signed::<Revocation>::from_pem(&ours).unwrap().claims_unverified().unwrap().name;
    let stranger = gdp_core::identity::SigningKey::generate().unwrap();
    let forged =
        gdp_core::cert::issue(&stranger, &Revocation { name, number: 9, floor: 0, revoked: vec![], signer: None })
            .unwrap();
    for (what, text, needle) in
        [("another's", forged.to_pem(), "wrong key"), ("no revocation", "junk".into(), "chatter.card.revocation")]
    {
        std::fs::write(&file, text).unwrap();
        for arguments in
            [&["grant", "list", "chatter.card"][..], &["cert", "show", "robot.ad", "--card", "chatter.card"]]
        {
            let refused = user.refusal(1, arguments);
            assert!(refused.contains(needle), "{what}: {refused}");
        }
    }
    std::fs::write(&file, ours).unwrap();
    for (ledger, needle) in [("{}", "not a ledger"), ("{\"version\":1,\"name\":\"", "not a ledger")] {
        std::fs::write(user.file("chatter.card.grants"), ledger).unwrap();
        assert!(user.refusal(1, &["grant", "list", "chatter.card"]).contains(needle));
    }
    std::fs::set_permissions(user.file("chatter.card.grants"), PermissionsExt::from_mode(0o644)).unwrap();
    assert!(user.refusal(1, &["grant", "list", "chatter.card"]).contains("chmod 600"));
}

/// Returns a user with `owner.pem` and `chatter.card`.
fn owner() -> User {
    let user = User::new();
    user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    user.card("/chatter");
    user
}

/// Creates a key file for an entity and returns the entity's name.
fn entity(user: &User, who: &str) -> String {
    let made = user.json(&["key", "generate", &format!("{who}.pem"), "--kind", "proxy"]);
    made["name"].as_str().unwrap().to_owned()
}

fn grant(user: &User, what: &[&str]) -> Value {
    user.json(&[&["grant", "add", "chatter.card", "--key", "owner.pem"], what].concat())
}

fn states(listed: &Value) -> Vec<&str> {
    listed["grants"].as_array().unwrap().iter().map(|grant| grant["state"].as_str().unwrap()).collect()
}
