//! The command line as users and scripts see it: output, files, exit statuses, and messages that
//! name the remedy.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use crate::switch::TIMEOUT;
use crate::user::User;
use gdp_proto::admin::VERSION;
use gdp_tests::process::terminate;
use gdp_tests::programs::{Executable as _, Program};
use serde_json::Value;

#[test]
fn keys_cards_and_certificates_are_made_without_a_daemon() {
    let user = User::new();
    let owner = user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    let robot = user.json(&["key", "generate", "robot.pem", "--kind", "proxy"]);
    assert_eq!(owner["v"], VERSION);
    assert_eq!(user.json(&["key", "show", "robot.pem", "--kind", "proxy"])["name"], robot["name"]);
    assert_eq!(user.json(&["key", "show", "robot.pem"])["names"]["proxy"], robot["name"]);

    let card = user.card("/chatter");
    let name = card["name"].as_str().unwrap();
    assert_eq!(user.text(&["name", "derive", "chatter.card"]).trim(), name);
    assert_eq!(user.json(&["name", "show", "chatter.card"])["metadata"]["topic"], "/chatter");
    let mut derive =
        vec!["name".to_owned(), "derive".into(), "--owner".into(), owner["public_key"].as_str().unwrap().into()];
    for (key, value) in card["metadata"].as_object().unwrap() {
        derive.extend(["--meta".into(), format!("{key}={}", value.as_str().unwrap())]);
    }
    assert_eq!(user.text(&derive.iter().map(String::as_str).collect::<Vec<_>>()).trim(), name);

    let create = ["name", "create", "--owner", "owner.pem", "--topic", "/scan", "--type", "a/msg/A", "-o", "scan.card"];
    let more = user.json(&[&create[..], &["--meta", "site=hall", "--meta", "floor=2"]].concat());
    assert_eq!((&more["metadata"]["site"], &more["metadata"]["floor"]), (&"hall".into(), &"2".into()));
    assert_eq!(user.text(&["name", "derive", "scan.card"]).trim(), more["name"]);

    let create = ["name", "create", "--owner", "owner.pem", "--topic", "/plan", "--type", "a/srv/A", "-o", "plan.card"];
    let plan = user.json(&[&create[..], &["--kind", "service", "--idempotent"]].concat());
    assert_eq!(plan["metadata"]["idempotent"], "true");

    let create = ["name", "create", "--owner", "owner.pem", "--kind", "catalog", "--topic", "robot1", "-o", "all.card"];
    let catalog = user.json(&create);
    assert_eq!((&catalog["metadata"]["kind"], &catalog["metadata"]["type"]), (&"catalog".into(), &"".into()));

    let entity = robot["name"].as_str().unwrap();
    let add = ["grant", "add", "chatter.card", "--key", "owner.pem", "--entity", entity];
    user.json(&[&add[..], &["--publish", "-o", "chatter.ad"]].concat());
    user.json(&[&add[..], &["--read", "-o", "chatter.grant", "--for", "7d"]].concat());
    let shown = user.json(&["cert", "show", "chatter.ad", "--card", "chatter.card"]);
    assert_eq!((&shown["claims"]["entity"], &shown["verified"]), (&robot["name"], &true.into()));
    assert_eq!(user.json(&["cert", "show", "chatter.grant"])["verified"], false);
}

#[test]
fn what_goes_wrong_is_named_with_its_remedy() {
    let user = User::new();
    user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    user.json(&["key", "generate", "robot.pem", "--kind", "proxy"]);
    user.card("/chatter");
    user.run(&["key", "generate", "open.pem", "--kind", "proxy"]);
    let open = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    std::fs::set_permissions(user.file("open.pem"), open).unwrap();
    std::fs::write(user.file("junk"), "junk").unwrap();
    assert!(Program::Mkfifo.command().arg(user.file("fifo")).status().unwrap().success());
    let zero = "0".repeat(64);
    let add = ["grant", "add", "chatter.card", "--entity", &zero, "-o", "x"];
    let create = |topic, kind, of| {
        ["name", "create", "--owner", "owner.pem", "-o", "new.card", "--topic", topic, "--kind", kind, "--type", of]
    };
    let meta = [&create("/a", "topic", "a/msg/A")[..], &["--meta", "site=\u{202e}"]].concat();
    let idempotent = [&create("/a", "action", "a/action/A")[..], &["--idempotent"]].concat();
    for (arguments, status, needles) in [
        (&["key", "generate", "owner.pem", "--kind", "owner"][..], 1, &["owner.pem"][..]),
        (&idempotent, 1, &["--idempotent", "only a service", "leave it out"]),
        (&["key", "show", "none.pem"], 1, &["none.pem"]),
        (&create("chatter", "topic", "std_msgs/msg/String"), 1, &["--topic", "`chatter`", "leading slash", "/chatter"]),
        (&create("/x\u{1b}[2J", "topic", "std_msgs/msg/String"), 1, &["--topic", "`/x\\u{1b}[2J`"]),
        (
            &create("/a", "topic", "not a type"),
            1,
            &["--type", "`not a type`", "package/msg/Name", "std_msgs/msg/String"],
        ),
        (&create("/a", "service", "std_msgs/msg/String"), 1, &["--type", "type of a service", "package/srv/Name"]),
        (&create("/a", "servce", "std_srvs/srv/SetBool"), 2, &["--kind", "'servce'", "'service'", "catalog"]),
        (&create("robot1", "catalog", "T"), 1, &["--type", "a catalog has no type", "leave --type out"]),
        (&create("/a", "topic", "")[..8], 1, &["a topic has a type", "--type std_msgs/msg/String"]),
        (&meta, 1, &["--meta", "site=\\u{202e}", "control characters"]),
        (&["key", "show", "open.pem"], 1, &["chmod 600"]),
        (&["key", "show", "junk"], 1, &["junk"]),
        (&["key", "show", "chatter.card"], 1, &["chatter.card: it is a name card, not a private key"]),
        (&["name", "show", "junk"], 1, &["junk", "not a name card", "gdp-ctl name create"]),
        (
            &["name", "show", "robot.pem"],
            1,
            &["not a name card", "robot.pem: it is a private key", "gdp-ctl name create"],
        ),
        (
            &[
                "name",
                "create",
                "--owner",
                "owner.pem",
                "--topic",
                "/a",
                "--type",
                "a/msg/B",
                "--meta",
                "topic=/b",
                "-o",
                "x",
            ],
            1,
            &["--meta topic: the key is set already", "leave one out"],
        ),
        (&["cert", "show", "junk"], 1, &["BEGIN GDP AD CERT"]),
        (&["cert", "show", "fifo"], 1, &["fifo", "it is a pipe"]),
        (&["serve", "--config", "fifo"], 1, &["fifo", "it is a pipe"]),
        (&["cert", "show", "chatter.card"], 1, &["chatter.card: it is a name card, not a certificate"]),
        (
            &[&add[..], &["--publish", "--key", "robot.pem"]].concat(),
            1,
            &["robot.pem is not the owner's key of chatter.card (/chatter)", "--delegation"],
        ),
        (&[&add[..], &["--publish", "--read", "--key", "owner.pem"]].concat(), 1, &["make two"]),
        (&[&add[..], &["--key", "owner.pem"]].concat(), 2, &["--publish"]),
        (&[&add[..], &["--read", "--key", "owner.pem", "--delegate", &zero]].concat(), 2, &["--delegate"]),
        (&[&add[..], &["--read", "--key", "owner.pem", "--scope", &zero]].concat(), 2, &["--publish"]),
        (&["grant", "add", "chatter.card", "--read", "--key", "owner.pem", "-o", "x"], 2, &["--entity"]),
        (
            &["grant", "add", "chatter.card", "--read", "--key", "owner.pem", "-o", "x", "--role", "operator"],
            2,
            &["--domain"],
        ),
        (&["grant", "list", "none.card"], 1, &["none.card"]),
        (&["grant", "revoke", "chatter.card"], 1, &["nothing of", "is revoked yet"]),
        (&["grant", "revoke", "chatter.card", "7"], 1, &["only the owner revokes", "--key"]),
        (&["grant", "revoke", "chatter.card", "7", "--key", "robot.pem"], 1, &["robot.pem is not the owner"]),
        (&["grant", "revoke", "chatter.card", "junk", "--key", "owner.pem"], 1, &["junk", "not a certificate"]),
        (&["grant", "revoke", "chatter.card", "--entity", &zero, "--key", "owner.pem"], 1, &["nothing was granted to"]),
        (
            &["grant", "revoke", "chatter.card", "--entity", "75e", "--key", "owner.pem"],
            1,
            &["nothing was granted to 75e"],
        ),
        (&["grant", "revoke", "chatter.card", "--entity", "ROBOT", "--key", "owner.pem"], 2, &["64 hex", "key show"]),
        (&["grant", "renew", "chatter.card", "--key", "owner.pem"], 1, &["no valid grant", "gdp-ctl grant add"]),
        (&["grant", "renew", "junk", "--key", "owner.pem"], 1, &["junk", "not a certificate"]),
        (&["grant", "renew", "--key", "owner.pem"], 2, &["<FILE|CARD>"]),
        (&["domain", "admit", "--key", "d.pem", &zero, "--role", "rib", "--days", "7", "-o", "x"], 2, &["--days"]),
        (
            &["domain", "invite", "--key", "d.pem", "--role", "arm", "--at", "edge:31415"],
            2,
            &["did you mean udp://edge:31415?"],
        ),
        (
            &["domain", "admit", "--key", "d.pem", "ROBOT", "--role", "rib", "-o", "x"],
            2,
            &["64 hex digits", "key show"],
        ),
        (&["advertise", "chatter.card", "--key", "robot.pem"], 1, &["needs the owner's certificate", "grant add"]),
        (&["query", "not-hex"], 1, &["neither a file nor the beginning of a name"]),
        (&["status"], 3, &["no daemon answers", "gdp-ctl serve", "A robot needs none", "--switch udp://HOST"]),
        (&["query", "75e"], 3, &["no daemon answers"]),
        (&["trace", "75e"], 3, &["no daemon answers"]),
        (&["ping", "75e", "-c", "1"], 3, &["no daemon answers"]),
        (&["ping", "75e", "-i", "0"], 2, &["is not a number of seconds from 0.02 to 3600"]),
        (&["peer", "list"], 3, &["no daemon answers"]),
        (&["monitor"], 3, &["no daemon answers"]),
        (&["topology", "--names"], 2, &["--dot"]),
        (&["advertise", "chatter.card", "--key", "owner.pem"], 3, &["no daemon answers"]),
        (&["fib", "dump"], 3, &["no daemon answers"]),
        (&["frobnicate"], 2, &["frobnicate"]),
        (
            &["grant", "add", "chatter.card", "--read", "--key", "owner.pem", "--entity", "75e", "-o", "x"],
            2,
            &["64 hex digits", "gdp-ctl key show FILE", "the key's file"],
        ),
        (&["advertise", "chatter.card", "--key", "owner.pem", "--for", "soon"], 2, &["is not a time"]),
        (&["serve", "--config", "none.yaml"], 1, &["none.yaml"]),
        (&["serve", "--config", "junk"], 1, &["junk"]),
        (&["serve", "--no-xdp", "--data-plane", "xdp"], 2, &["cannot be used with"]),
        (&["serve", "--interface", "e0", "--all-interfaces"], 2, &["cannot be used with"]),
    ] {
        let error = user.refusal(status, arguments);
        for needle in needles {
            assert!(error.contains(needle), "{arguments:?}: {error}");
        }
        assert!(error.matches("os error").count() <= 1, "{arguments:?}: says it twice: {error}");
    }
}

#[test]
fn a_key_states_its_kind_and_stands_for_its_entity() {
    let user = User::new();
    let robot = user.text(&["key", "generate", "robot.pem", "--kind", "proxy"]);
    let shown = user.json(&["key", "show", "robot.pem"]);
    let name = shown["names"]["proxy"].as_str().unwrap();
    assert_eq!(robot, format!("proxy {name} robot.pem\n"));
    assert_eq!(user.text(&["key", "show", "robot.pem"]), robot);
    let tool = shown["names"]["tool"].as_str().unwrap();
    assert_eq!(user.text(&["key", "show", "robot.pem", "--kind", "tool"]), format!("tool {tool} robot.pem\n"));

    // Without its line, the file is as earlier releases wrote it.
    let text = std::fs::read_to_string(user.file("robot.pem")).unwrap();
    std::fs::copy(user.file("robot.pem"), user.file("bare.pem")).unwrap();
    std::fs::write(user.file("bare.pem"), text.strip_prefix("kind: proxy\n").unwrap()).unwrap();
    let bare = user.text(&["key", "show", "bare.pem"]);
    assert!(bare.starts_with("public key  ") && bare.contains(&format!("\nas proxy    {name}\n")), "{bare}");
    assert_eq!(user.text(&["key", "show", "bare.pem", "--kind", "proxy"]), format!("proxy {name} bare.pem\n"));

    user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    user.card("/chatter");
    let add = ["grant", "add", "chatter.card", "--key", "owner.pem", "--read", "-o", "chatter.grant", "--entity"];
    let refused = user.refusal(2, &[&add[..], &["bare.pem"]].concat());
    assert!(refused.contains("bare.pem does not state its kind"), "{refused}");
    assert_eq!(user.json(&[&add[..], &["robot.pem"]].concat())["claims"]["to"]["entity"], name);
}

#[test]
fn help_is_in_groups() {
    let help = User::new().text(&["--help"]);
    let at = |title: &str| help.find(&format!("\n{title}:\n")).unwrap_or_else(|| panic!("{title}: {help}"));
    assert!(at("Everyday") < at("Rights") && at("Rights") < at("Inside") && at("Inside") < at("Options"), "{help}");
    assert!(help.contains("\n  topic        List, measure") && help.contains("Exit status"), "{help}");
}

#[test]
fn a_failure_is_an_object_for_programs() {
    let user = User::new();
    let none = user.failure(3, &["status"]);
    assert_eq!(none["code"], "NoDaemon");
    assert!(none["reason"].as_str().unwrap().contains("no daemon answers at"), "{none}");
    assert!(none["remedy"].as_str().unwrap().starts_with("start one with `gdp-ctl serve`"), "{none}");
    let missing = user.failure(1, &["key", "show", "none.pem"]);
    assert_eq!((&missing["code"], &missing["remedy"]), (&"Failed".into(), &Value::Null));
    let usage = user.failure(2, &["frobnicate"]);
    assert!(usage["code"] == "Usage" && usage["reason"].as_str().unwrap().contains("frobnicate"), "{usage}");
    let no_text = user.command(&["query"]).arg(OsStr::from_bytes(b"\xff")).arg("-j").output().unwrap();
    assert_eq!(no_text.status.code(), Some(2), "{no_text:?}");
    assert!(String::from_utf8_lossy(&no_text.stdout).contains(r#""code":"Usage""#), "{no_text:?}");

    let _daemon = Daemon::start(&user);
    let unknown = user.failure(1, &["trace", &"9".repeat(64)]);
    assert!(unknown["remedy"].as_str().unwrap().contains("ask at a switch"), "{unknown}");
    user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    user.card("/chatter");
    user.json(&["advertise", "chatter.card", "--key", "owner.pem", "--kind", "owner"]);
    user.json(&["withdraw", "chatter.card", "--key", "owner.pem", "--kind", "owner"]);
    let refused = user.failure(1, &["withdraw", "chatter.card", "--key", "owner.pem", "--kind", "owner"]);
    assert_eq!(refused["code"], "NotFound", "{refused}");
}

#[test]
fn the_published_schema_is_printed() {
    let printed: Value = serde_json::from_str(&User::new().text(&["--schema"])).unwrap();
    assert!(printed["properties"]["topic echo"]["properties"]["v"]["const"] == VERSION, "{printed:#}");
}

#[test]
fn a_name_is_advertised_queried_dumped_and_withdrawn() {
    let user = User::new();
    let daemon = Daemon::start(&user);
    user.json(&["key", "generate", "owner.pem", "--kind", "owner"]);
    let robot = user.json(&["key", "generate", "robot.pem", "--kind", "proxy"]);
    let card = user.card("/chatter");
    let name = card["name"].as_str().unwrap();
    let switch = user.json(&["status"])["name"].clone();

    let nobody = user.run(&["query", "chatter.card"]);
    assert_eq!(nobody.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&nobody.stderr).contains("nobody publishes"));

    let done = user.run(&["-j", "advertise", "chatter.card", "--key", "owner.pem", "--kind", "owner", "--for", "5m"]);
    assert!(String::from_utf8_lossy(&done.stderr).contains("no reader yet, so there is no route"), "{done:?}");
    let done: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!((&done["name"], &done["switch"]), (&card["name"], &switch));
    for what in ["chatter.card", name, &name[..5]] {
        let found = user.json(&["query", what]);
        assert_eq!(found["records"][0]["name"], card["name"], "{what}");
        assert_eq!(found["records"][0]["verified"], true);
    }
    // On a machine without a daemon, with a key and a switch.
    std::fs::create_dir(user.file("keys")).unwrap();
    user.json(&["key", "generate", "keys/id.pem", "--kind", "proxy"]);
    let at = format!("udp://{}", user.json(&["status"])["udp"].as_str().unwrap());
    let remote = ["query", "chatter.card", "--switch", &at, "--keyring", "keys", "--socket", "nowhere.sock"];
    assert_eq!(user.json(&remote)["records"][0]["name"], card["name"]);
    let add = ["grant", "add", "chatter.card", "--key", "owner.pem", "--entity", robot["name"].as_str().unwrap()];
    user.json(&[&add[..], &["--publish", "-o", "chatter.ad"]].concat());
    user.json(&["advertise", "chatter.card", "--key", "robot.pem", "--cert", "chatter.ad"]);
    assert_eq!(user.json(&["rib", "dump"])["records"].as_array().unwrap().len(), 2);
    assert_eq!(user.json(&["rib", "dump", "--", &name[..8]])["records"].as_array().unwrap().len(), 2);
    assert_eq!(user.json(&["fib", "dump"])["routes"].as_array().unwrap().len(), 0, "nobody reads it");
    for command in [&["query", &name[..6]][..], &["rib", "dump"], &["fib", "dump"], &["status"]] {
        let text = user.text(command);
        assert!(!text.trim().is_empty() && !text.contains('{'), "{command:?}: {text}");
    }

    let foreign = user.run(&["advertise", "chatter.card", "--key", "owner.pem", "--cert", "chatter.ad"]);
    assert_eq!(foreign.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&foreign.stderr).contains("wrong entity"), "{foreign:?}");

    let other =
        user.run(&["advertise", "chatter.card", "--key", "robot.pem", "--kind", "tool", "--cert", "chatter.ad"]);
    assert!(String::from_utf8_lossy(&other.stderr).contains("add --kind proxy"), "{other:?}");

    user.json(&["withdraw", "chatter.card", "--key", "robot.pem"]);
    let again = user.run(&["withdraw", "chatter.card", "--key", "robot.pem"]);
    assert_eq!(again.status.code(), Some(1), "{again:?}");
    assert_eq!(user.json(&["query", "chatter.card"])["records"].as_array().unwrap().len(), 1);

    let second = user.run(&["serve", "--config", "daemon.yaml"]);
    assert!(String::from_utf8_lossy(&second.stderr).contains("another program already answers"), "{second:?}");
    assert!(daemon.stop().success());
    assert!(!user.file("ctl.sock").exists(), "the socket is removed");
}

#[test]
fn a_socket_left_by_a_crash_is_replaced_and_is_for_its_user_and_group() {
    use std::os::unix::fs::PermissionsExt;
    let user = User::new();
    drop(Daemon::start(&user));
    assert!(user.file("ctl.sock").exists(), "killed, it could not remove it");
    let _daemon = Daemon::start(&user);
    assert_eq!(std::fs::metadata(user.file("ctl.sock")).unwrap().permissions().mode() & 0o777, 0o660);
}

#[test]
fn hostile_admin_clients_get_an_error_and_others_are_served() {
    use std::io::{BufRead, BufReader, Write};
    use std::os::unix::net::UnixStream;
    let user = User::new();
    let _daemon = Daemon::start(&user);
    let mut silent = Vec::new();
    for line in [
        "\n".to_owned(),
        "{}\n".into(),
        "[[[[\n".into(),
        "x".repeat(100_000) + "\n",
        "{\"v\":2,\"op\":\"entity\"}\n".into(),
    ] {
        let mut stream = UnixStream::connect(user.file("ctl.sock")).unwrap();
        // The daemon may close the connection in the middle of an endless line.
        let _ = stream.write_all(line.as_bytes());
        let mut reply = String::new();
        let _ = BufReader::new(&stream).read_line(&mut reply);
        if line.len() < 1000 {
            assert!(reply.contains("\"error\""), "{line:?}: {reply:?}");
        }
        silent.push(stream);
    }
    user.json(&["status"]);
}

/// A daemon in a user's folder, on loopback UDP.
struct Daemon(Child);

impl Daemon {
    fn start(user: &User) -> Self {
        let config =
            "identity: switch.pem\nsocket: ctl.sock\ninterfaces: []\nudp: 127.0.0.1:0\ndata_plane: userspace\n";
        std::fs::write(user.file("daemon.yaml"), config).unwrap();
        let mut command = user.command(&["serve", "--config", "daemon.yaml"]);
        let daemon = Self(command.env_remove("GDP_SOCKET").stderr(Stdio::null()).spawn().unwrap());
        let deadline = Instant::now() + TIMEOUT;
        while !answers(&user.file("ctl.sock")) {
            assert!(Instant::now() < deadline, "the daemon does not answer");
            std::thread::sleep(Duration::from_millis(10));
        }
        daemon
    }

    /// Stops the daemon as a service manager does.
    fn stop(mut self) -> std::process::ExitStatus {
        terminate(&self.0).unwrap();
        self.0.wait().unwrap()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn answers(socket: &Path) -> bool {
    std::os::unix::net::UnixStream::connect(socket).is_ok()
}
