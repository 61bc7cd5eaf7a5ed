//! The program as a shell or systemd sees it: exit codes, what is on stdout and stderr, and that it
//! ends when told to. No switch and no root: what needs those is in the workspace's `tests`.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_proxy::ros2::{Domain, TopicName, TypeName};
use gdp_ros::roster::Offer;
use gdp_tests::dds_domain::lease;
use gdp_tests::process::terminate;
use gdp_tests::programs::{Executable as _, Program, own};
use gdp_util::escape::is_control;

#[test]
fn check_reads_everything_and_says_so() {
    let files = Files::new();
    let output = files.proxy(&["--check"]);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("robot.yaml: good, 1 topics") && said.contains(&files.entity), "{said}");
}

#[test]
fn the_ros_package_makes_what_the_proxy_accepts() {
    let program = PathBuf::from(env!("CARGO_BIN_EXE_gdp-proxy"));
    let executables = program.parent().unwrap();
    assert!(executables.join("gdp-ctl").is_file(), "gdp-ctl is not built: run `cargo build --workspace` first");
    let python = executables.parent().unwrap().join("venv-gdp-ros/bin/python");
    assert!(python.is_file(), "{} does not exist: run `cargo xtask setup`", python.display());
    let domain = lease();
    let mut command = own(python);
    // -B: the source tree stays as it is.
    command.args(["-B", "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "test"]);
    command.current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../ros/gdp_ros"));
    command.env("GDP_BIN", executables).env("ROS_DOMAIN_ID", domain.to_string());
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    assert!(output.status.success() && said.contains(" passed"), "{said}{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_mistake_is_one_line_with_file_key_and_remedy() {
    let files = Files::new();
    fs::write(files.path("chatter.ad"), "no certificate").unwrap();
    let output = files.proxy(&["--check"]);
    assert_eq!((output.status.code(), &output.stdout[..]), (Some(1), &b""[..]));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("robot.yaml: topics[0].cert: ") && said.contains("chatter.ad"), "{said}");
    assert_eq!((said.lines().count(), said.matches("topics[0].cert").count()), (1, 1), "{said}");
}

#[test]
fn a_misspelt_key_is_said_with_its_line_and_what_was_meant() {
    let files = Files::new();
    let text = fs::read_to_string(files.path("robot.yaml")).unwrap();
    fs::write(files.path("robot.yaml"), text.replace("direction", "dirction")).unwrap();
    let output = files.proxy(&["--check"]);
    assert_eq!((output.status.code(), &output.stdout[..]), (Some(1), &b""[..]));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("robot.yaml: there is no key `dirction`; did you mean `direction`? at line 6"), "{said}");
}

#[test]
fn a_file_in_the_wrong_place_is_said_to_be_what_it_is() {
    let files = Files::new();
    let (name, not_before, not_after) = (files.card.name(), 0, u64::MAX);
    let grant = ReadGrant { name, to: Grantee::Entity(name), serial: 1, not_before, not_after };
    fs::write(files.path("chatter.grant"), issue(&files.owner, &grant).unwrap().to_pem()).unwrap();
    let other = AdCert { entity: files.card.name(), ..files.ad.clone() };
    fs::write(files.path("other.ad"), issue(&files.owner, &other).unwrap().to_pem()).unwrap();
    let config = fs::read_to_string(files.path("robot.yaml")).unwrap();
    let add = |right: &str| format!("have the owner run `gdp-ctl grant add CARD --{right} --entity {}", files.entity);
    let publish = add("publish");
    for (from, to, needles) in [
        (
            "cert: chatter.ad",
            "cert: chatter.grant",
            &["chatter.grant: it is a grant to read (GDP READ GRANT), and a certificate to publish", &publish][..],
        ),
        (
            "cert: chatter.ad",
            "cert: other.ad",
            &["other.ad: wrong entity: it was issued to ", "this proxy is", &publish],
        ),
        ("cert: chatter.ad", "cert: robot.pem", &["robot.pem: it is a private key, and a certificate to publish"]),
        (
            "card: chatter.card",
            "card: chatter.ad",
            &["not a name card: ", "chatter.ad: it is a certificate to publish"],
        ),
        ("identity: robot.pem", "identity: chatter.card", &["chatter.card: it is a name card, not a private key"]),
    ] {
        fs::write(files.path("robot.yaml"), config.replace(from, to)).unwrap();
        let output = files.proxy(&["--check"]);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), text.lines().count()), (Some(1), 1), "{text}");
        needles.iter().for_each(|needle| assert!(text.contains(needle), "{to}: {text}"));
    }
}

#[test]
fn the_configuration_is_an_argument_or_an_option() {
    let files = Files::new();
    let run = |arguments: &[&str]| {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-proxy"));
        let output = command.args(arguments).current_dir(files.folder.path()).output().unwrap();
        let [stdout, stderr] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        (output.status.code(), stdout, stderr)
    };
    for arguments in
        [&["robot.yaml", "--check"][..], &["--check", "robot.yaml"], &["--check", "--config", "robot.yaml"]]
    {
        let (status, stdout, stderr) = run(arguments);
        assert!(status == Some(0) && stdout.starts_with("robot.yaml: good"), "{arguments:?}: {stderr}");
    }
    let (status, _, stderr) = run(&["none.yaml"]);
    let folder = files.folder.path().canonicalize().unwrap();
    assert_eq!(status, Some(1));
    assert!(
        stderr.ends_with(&format!("none.yaml: cannot be read: there is no such file in {}\n", folder.display())),
        "{stderr}"
    );
    for arguments in [&["--check"][..], &["robot.yaml", "--config", "robot.yaml"]] {
        let (status, _, stderr) = run(arguments);
        assert!(status == Some(2) && stderr.contains("FILE"), "{arguments:?}: {stderr}");
    }
}

#[test]
fn the_schema_is_printed_without_a_configuration() {
    let output = own(env!("CARGO_BIN_EXE_gdp-proxy")).arg("--schema").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let schema: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(schema["properties"]["expose"].is_object(), "{schema}");
}

#[test]
fn a_dry_run_shows_what_would_cross_under_which_name() {
    let files = Files::new();
    let owner = SigningKey::generate().unwrap();
    owner.save_new(&files.path("owner.pem")).unwrap();
    let catalog = NameCard::create(owner.verify_key(), "catalog", "/robot", "", None).unwrap();
    catalog.save_new(&files.path("catalog.card")).unwrap();
    let mut text = fs::read_to_string(files.path("robot.yaml")).unwrap();
    let domain = lease();
    text += &format!(
        "graphs: {{a: {{domain_id: {domain}}}}}\nexpose: {{owner: owner.pem, catalog: catalog.card, topics: [/a/**], \
         services: [/a/**], deny: [/a/secret]}}\n"
    );
    fs::write(files.path("robot.yaml"), text).unwrap();

    let runtime = tokio::runtime::Runtime::new().unwrap();
    let _entered = runtime.enter();
    let node = Domain::join(domain, "talker").unwrap();
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    let offer = Offer::DEFAULT;
    let topics = ["/a/b", "/a/secret", "/c", "/chatter"];
    let _writers = topics.map(|topic| node.writer(&TopicName::parse(topic).unwrap(), &kind, &offer).unwrap());
    let trigger = TypeName::parse("std_srvs/srv/Trigger").unwrap();
    let services = ["/a/go", "/a/secret"];
    let _servers = services.map(|name| node.server(&TopicName::parse(name).unwrap(), &trigger, None).unwrap());

    // Longer and longer, for a busy machine.
    let mut looks = ["2", "5", "15", "40"].iter().map(|seconds| {
        let output = files.proxy(&["--dry-run", seconds, "-j"]);
        assert!(output.status.success(), "{output:?}");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["entity"], files.entity);
        ["topics", "calls"].map(|key| report[key].as_array().unwrap().clone())
    });
    let has = |rows: &[serde_json::Value], key: &str, names: &[&str]| {
        names.iter().all(|name| rows.iter().any(|row| row[key] == *name))
    };
    let is_all = |[rows, calls]: &[Vec<_>; 2]| has(rows, "topic", &topics) && has(calls, "service", &services);
    let [rows, calls] = looks.find(is_all).unwrap();
    let shown = |topic: &str, key: &str| rows.iter().find(|row| row["topic"] == topic).unwrap()[key].clone();
    let of = |topic: &str| (shown(topic, "direction"), shown(topic, "because").as_str().unwrap().to_owned());
    assert_eq!(of("/chatter"), ("out".into(), "topics[0]".into()));
    assert_eq!(of("/a/b"), ("out".into(), "expose".into()));
    assert_eq!(of("/a/secret"), (serde_json::Value::Null, "deny has /a/secret".into()));
    assert_eq!(of("/c"), (serde_json::Value::Null, "no pattern under topics matches".into()));
    assert_eq!(
        (shown("/a/b", "type"), shown("/a/b", "name").as_str().unwrap().len()),
        ("std_msgs/msg/String".into(), 64)
    );
    assert_eq!(shown("/a/b", "qos"), "Reliable, Volatile");
    let of = |row: &serde_json::Value| {
        ["what", "service", "type", "because"].map(|key| row[key].as_str().unwrap_or_default().to_owned())
    };
    assert_eq!(of(&calls[0]), ["service", "/a/go", "std_srvs/srv/Trigger", "expose"]);
    assert_eq!(of(&calls[1]), ["service", "/a/secret", "std_srvs/srv/Trigger", "deny has /a/secret"]);
    assert_eq!((calls[0]["name"].as_str().unwrap().len(), calls.len()), (64, 2));
}

#[test]
fn what_a_hostile_card_says_is_shown_as_text() {
    let hostile = "/x\u{1b}]0;pwned\u{7}\u{9b}31m\u{202e}\u{2066}\u{61c}\u{7f}\r\nforged";
    let shown = "/x\\u{1b}]0;pwned\\u{7}\\u{9b}31m\\u{202e}\\u{2066}\\u{61c}\\u{7f}\\r\\nforged";
    let files = Files::with_card(hostile, "std_msgs/msg/String");
    let listed = String::from_utf8(files.proxy(&["--dry-run", "1"]).stdout).unwrap();
    assert!(listed.contains(&format!(" as {shown}, topics[0]\n")), "{listed:?}");
    let json = String::from_utf8(files.proxy(&["--dry-run", "1", "-j"]).stdout).unwrap();
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["topics"][0]["called"], hostile);
    let refused = Files::with_card("/chatter", hostile).proxy(&["--check"]);
    assert_eq!((refused.status.code(), &refused.stdout[..]), (Some(1), &b""[..]));
    let refused = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.lines().count(), 1, "{refused}");
    for text in [listed, json, refused] {
        assert!(!text.replace('\n', "").contains(is_control) && !text.contains("\nforged"), "{text:?}");
    }
}

#[test]
fn statistics_that_cannot_be_written_are_a_mistake_said_at_once() {
    let output = Files::new().proxy(&["--stats", "/nonexistent/stats.json"]);
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("/nonexistent/stats.json: cannot be written"), "{said}");
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let output = own(env!("CARGO_BIN_EXE_gdp-proxy")).arg("--confg\u{202e}").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("--confg\\u{202e}") && said.contains("--config"), "{said}");
}

#[test]
fn it_waits_for_a_switch_and_ends_at_sigterm() {
    let files = Files::new();
    let mut child = files.command(&["--stats", files.path("stats").to_str().unwrap()]).spawn().unwrap();
    // SIGTERM before the handler is there would kill it; that it listens shows in /proc.
    let deadline = Instant::now() + Duration::from_secs(60);
    while !catches_sigterm(child.id()) && child.try_wait().unwrap().is_none() && Instant::now() < deadline {
        std::thread::yield_now();
    }
    if catches_sigterm(child.id()) {
        terminate(&child).unwrap();
    } else {
        child.kill().unwrap();
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
}

#[test]
fn a_switch_that_is_not_there_is_said_with_the_reason() {
    for (link, expected) in [
        ("udp://127.0.0.1:9", "no answer yet: nothing listens on UDP 127.0.0.1:9"),
        ("udp://no-such-host.invalid", "no-such-host.invalid"),
    ] {
        let files = Files::new();
        let config = fs::read_to_string(files.path("robot.yaml")).unwrap().replace("udp://127.0.0.1:9", link);
        fs::write(files.path("robot.yaml"), config).unwrap();
        let mut child = files.command(&[]).spawn().unwrap();
        let log = BufReader::new(child.stderr.take().unwrap());
        let line = log.lines().map(Result::unwrap).find(|line| line.contains("no answer yet")).unwrap();
        assert!(line.contains(expected) && line.contains("no answer yet: ") && line.contains("Trying on"), "{line}");
        child.kill().unwrap();
        child.wait().unwrap();
    }
}

#[test]
fn the_soft_limit_on_open_files_is_raised() {
    let files = Files::new();
    let program = files.command(&[]);
    let mut child = Program::Sh
        .command()
        .args(["-c", "ulimit -Sn 256 && exec \"$0\" \"$@\""])
        .arg(program.get_program())
        .args(program.get_args())
        .envs(program.get_envs().filter_map(|(key, value)| Some((key, value?))))
        .spawn()
        .unwrap();
    let limits = || {
        let limits = fs::read_to_string(format!("/proc/{}/limits", child.id())).unwrap_or_default();
        let line = limits.lines().find_map(|line| line.strip_prefix("Max open files")).map(str::to_owned);
        line.map(|line| line.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).unwrap_or_default()
    };
    let deadline = Instant::now() + Duration::from_secs(60);
    // Before, it is the shell, whose limit may be the hard one until `ulimit` ran.
    let is_proxy = || fs::read_to_string(format!("/proc/{}/comm", child.id())).is_ok_and(|name| name == "gdp-proxy\n");
    let is_raised = || is_proxy() && matches!(&limits()[..], [soft, hard, ..] if soft == hard);
    while !is_raised() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(20));
    }
    let raised = is_raised();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(raised, "the soft limit is not the hard one");
}

/// Bit 14 of the mask of caught signals.
fn catches_sigterm(pid: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 << 14 != 0)
}

/// A configuration with one topic, and all that it names; nobody listens on the link.
struct Files {
    folder: tempfile::TempDir,
    entity: String,
    owner: SigningKey,
    card: NameCard,
    ad: AdCert,
}

impl Files {
    fn new() -> Self {
        Self::with_card("/chatter", "std_msgs/msg/String")
    }

    /// What the topic's name card says.
    fn with_card(topic: &str, kind: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = |file: &str| folder.path().join(file);
        let (owner, key) = (SigningKey::generate().unwrap(), SigningKey::generate().unwrap());
        let card = NameCard::create(owner.verify_key(), "topic", topic, kind, None).unwrap();
        let entity = Identity::new(key.clone(), "proxy").name();
        let (name, scope, serial) = (card.name(), vec![], 1);
        let ad = AdCert { name, entity, scope, serial, not_before: 0, not_after: u64::MAX };
        key.save_new(&path("robot.pem")).unwrap();
        card.save_new(&path("chatter.card")).unwrap();
        fs::write(path("chatter.ad"), issue(&owner, &ad).unwrap().to_pem()).unwrap();
        let config = "version: 1\nidentity: robot.pem\nlinks:\n  - to: udp://127.0.0.1:9\ntopics:\n  - {topic: \
                      /chatter, direction: out, card: \
                      chatter.card, cert: chatter.ad}\n";
        fs::write(path("robot.yaml"), config).unwrap();
        let entity = entity.to_string();
        Self { folder, entity, owner, card, ad }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-proxy"));
        command.arg("--config").arg(self.path("robot.yaml")).args(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn proxy(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }
}
