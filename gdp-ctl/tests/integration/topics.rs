//! `gdp-ctl topic` at a whole daemon, with publishers of the SDK that send rosters as proxies do.

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Output, Stdio};
use std::time::{Duration, Instant, SystemTime};

use gdp::unstable::{Node, NodeConfig, PublishOptions, Publisher, SubscribeOptions};
use gdp_core::cert::{AdCert, Grantee, ReadGrant, Reading, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::{Draft, Encoding};
use gdp_ros::call::{CALL, Epoch, Failure, FailureCode, Reply, Request};
use gdp_ros::compression::Packer;
use gdp_ros::roster::{self, Change, Dialect, Incoming, Kind, Offer, Outgoing, ROSTER};
use gdp_ros::types::Types;
use gdp_wire::Name;
use serde_json::Value;

use crate::owner::Owner;
use crate::switch::{TIMEOUT, config, wait};
use crate::user::{User, expect_described};

const OFFER: Offer = Offer {
    reliable: true,
    transient_local: false,
    depth: 7,
    deadline_ns: 0,
    lifespan_ns: 0,
    liveliness_ns: 0,
    manual_liveliness: false,
};

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_a_publisher_elsewhere_are_shown_in_the_form_of_ros2cli() {
    let site = Site::new(&[("/chatter", "std_msgs/msg/String")]).await;
    let mut talker = site.talker("/chatter", "string data\n").await;
    let talking = tokio::spawn(async move {
        loop {
            talker.send(b"\0\x01\0\0\x06\0\0\0hello\0").await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });

    assert_eq!(site.text(&["topic", "list", "-t"]).await, "/chatter [std_msgs/msg/String]\n");
    let listed = site.text(&["topic", "list", "-v"]).await;
    assert!(listed.starts_with("Published topics:\n * /chatter [std_msgs/msg/String] 1 publisher\n"), "{listed}");
    let listed = site.json(&["topic", "list"]).await;
    assert_eq!(listed["topics"][0]["publishers"].as_array().unwrap().len(), 1);

    let shown = [
        "Type: std_msgs/msg/String\n\nPublisher count: 1\n\n",
        "Endpoint type: PUBLISHER\n",
        "  Reliability: RELIABLE\n  History (Depth): KEEP_LAST (7)\n  Durability: VOLATILE\n  Lifespan: Infinite\n",
        "\n\nSubscription count: 0\n",
    ];
    // The command listens for a limited time, in which the publisher may not have sent its whole
    // roster.
    wait("the publisher to be described", async || {
        let info = site.text(&["topic", "info", "chatter", "-v"]).await;
        shown.iter().all(|needle| info.contains(needle))
    })
    .await;
    assert_eq!(site.json(&["topic", "info", "chatter"]).await["publishers"][0]["depth"], 7);

    assert_eq!(site.text(&["topic", "echo", "/chatter", "--once"]).await, "data: hello\n---\n");
    assert_eq!(site.text(&["topic", "echo", "/chatter", "--once", "--field", "data"]).await, "hello\n---\n");
    let raw = site.text(&["topic", "echo", "/chatter", "--once", "--raw"]).await;
    assert_eq!(raw, "b'\\x00\\x01\\x00\\x00\\x06\\x00\\x00\\x00hello\\x00'\n---\n");
    let prefix = site.owners[0].card.name().to_string()[..12].to_owned();
    assert_eq!(site.json(&["topic", "echo", &prefix, "--once"]).await["message"]["data"], "hello");
    let refusal = site.refusal(&["topic", "echo", "/chatter", "--once", "--field", "dato"]).await;
    assert!(refusal.contains("no field `dato`") && refusal.contains("data"), "{refusal}");

    for (command, needles) in [
        (&["topic", "hz", "/chatter"][..], &["average rate: ", "\tmin: "][..]),
        (
            &["topic", "bw", "/chatter", "-w", "5"],
            &["B/s from 5 messages", "\tMessage size mean: 14 B min: 14 B max: 14 B"],
        ),
        (&["topic", "delay", "/chatter"], &["average delay: ", "\tmin: "]),
    ] {
        let mut following = site.follow(command);
        let lines = following.until(needles[1]);
        assert!(lines.contains(needles[0]) && lines.contains(needles[1]), "{command:?}: {lines}");
        following.interrupt();
    }
    talking.abort();
    site.switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_travels_compressed_is_shown_as_it_was() {
    let site = Site::new(&[("/chatter", "std_msgs/msg/String")]).await;
    let mut talker = site.talker("/chatter", "string data\n").await;
    let text = "hello ".repeat(100);
    let body = [&b"\0\x01\0\0"[..], &601_u32.to_le_bytes(), text.as_bytes(), b"\0"].concat();
    let length = body.len();
    let talking = tokio::spawn(async move {
        let mut packer = Packer::new().unwrap();
        loop {
            let (encoding, packed) = packer.pack(Encoding::Cdr, &body);
            assert!(packed.len() < 100);
            talker.send_in(encoding, packed).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    let shown = site.json(&["topic", "echo", "/chatter", "--once"]).await;
    assert_eq!(shown["message"]["data"], text.as_str());
    let raw = site.json(&["topic", "echo", "/chatter", "--once", "--raw"]).await;
    assert_eq!((&raw["encoding"], raw["raw"].as_str().unwrap().len()), (&2.into(), length.div_ceil(3) * 4));
    let mut following = site.follow(&["-j", "topic", "bw", "/chatter"]);
    let line: Value = serde_json::from_str(following.until("min_bytes").lines().last().unwrap()).unwrap();
    expect_described(&["topic", "bw"], &line);
    assert_eq!((&line["min_bytes"], &line["max_bytes"]), (&length.into(), &length.into()));
    following.interrupt();
    talking.abort();
    site.switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_published_at_the_command_line_arrives_with_its_roster() {
    let site = Site::new(&[("/goal", "geometry_msgs/msg/Point")]).await;
    let owner = &site.owners[0];
    let reader = site.node(Identity::generate("proxy").unwrap()).await;
    let mut subscription =
        reader.subscribe(owner.card.proof(), owner.grant(reader.name()), SubscribeOptions::as_offered()).await.unwrap();
    let text = site.text(&["topic", "pub", "-1", "/goal", "geometry_msgs/Point", "{x: 1.5, z: -2}"]).await;
    assert_eq!(text, "publisher: beginning loop\npublishing #1: geometry_msgs.msg.Point(x=1.5, y=0.0, z=-2.0)\n");

    let (mut incoming, mut joined, mut left, mut message) = (Incoming::default(), None, false, None);
    while !left {
        let got = tokio::time::timeout(TIMEOUT, subscription.recv()).await.unwrap().unwrap();
        if got.encoding != ROSTER {
            message = Some(got);
            continue;
        }
        let events = incoming.receive(Instant::now(), got);
        let changes = events.into_iter().flat_map(|event| match event {
            roster::RosterEvent::Changes(changes) => changes,
            other => panic!("{other:?}"),
        });
        for change in changes {
            match change {
                Change::Joined { number, kind, offers, .. } => joined = Some((number, kind, offers)),
                Change::Left { .. } | Change::Silent { .. } => left = true,
            }
        }
    }
    let ((number, kind, offers), message) = (joined.unwrap(), message.unwrap());
    assert_eq!((&*kind.name, kind.hash.len(), offers.reliable), ("geometry_msgs/msg/Point", 32, true));
    assert_eq!(roster::number(&message.origin), Some(number));
    let cdr = ["00010000", "000000000000f83f", "0000000000000000", "00000000000000c0"].concat();
    assert_eq!((message.encoding, hex(&message.body)), (Encoding::Cdr, cdr));

    for (arguments, needle) in [
        (&["/goal", "geometry_msgs/Point", "{w: 1}"][..], "no field `w`; its fields are: x, y, z"),
        (
            &["/goal", "std_msgs/String", "{data: hi}"],
            "/goal is of geometry_msgs/msg/Point, and not of std_msgs/String",
        ),
        (&["/goal", "my_robot/Unheard"], "--definitions"),
        (&["/none", "geometry_msgs/Point"], "no name card of a topic /none"),
    ] {
        let refusal = site.refusal(&[&["topic", "pub", "-1"], arguments].concat()).await;
        assert!(refusal.contains(needle), "{arguments:?}: {refusal}");
    }
    site.switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_has_no_grant_is_told_how_to_get_one_and_who_waits_in_vain_that_nobody_publishes() {
    let site = Site::new(&[("/chatter", "std_msgs/msg/String"), ("/other", "std_msgs/msg/String")]).await;
    let silent = site.output(&["topic", "echo", "/chatter", "--timeout", "5"]).await;
    let error = String::from_utf8_lossy(&silent.stderr).into_owned();
    assert_eq!(silent.status.code(), Some(1), "{error}");
    assert!(error.contains("topic [/chatter] does not appear to be published yet"), "{error}");
    std::fs::remove_file(site.user.file("keyring/1.grant")).unwrap();
    let refusal = site.refusal(&["topic", "echo", "/other"]).await;
    assert!(refusal.contains("gdp-ctl grant add") && refusal.contains(&site.entity.to_string()), "{refusal}");
    std::fs::remove_file(site.user.file("keyring/id.pem")).unwrap();
    assert!(site.refusal(&["topic", "hz", "/chatter"]).await.contains("gdp-ctl key generate"));
    site.switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_elsewhere_is_called_in_the_form_of_ros2cli() {
    let site = Site::new(&[("/light", "std_srvs/srv/SetBool")]).await;
    assert_eq!(site.text(&["service", "list", "-t"]).await, "/light [std_srvs/srv/SetBool]\n");
    let owner = &site.owners[0];
    let node = site.node(Identity::generate("proxy").unwrap()).await;
    let mut server = node.serve(owner.card.proof(), owner.ad(node.name()).into()).await.unwrap();
    let serving = tokio::spawn(async move {
        let (epoch, types) = (Epoch(7), Types::load([]).unwrap());
        let kind = Kind { dialect: Dialect::Ros2, name: "std_srvs/srv/SetBool".into(), hash: vec![] };
        while let Some(call) = server.recv().await {
            let reply = match Request::from_bytes(call.body()).unwrap() {
                Request::Describe => Reply::Description(epoch, types.describe_service(kind.clone())),
                Request::Call { body, .. } if body[4] == 1 => {
                    Reply::Answer(bytes::Bytes::from_static(b"\0\x01\0\0\x01\0\0\0\x03\0\0\0on\0"))
                }
                _ => Reply::Failure(Failure::new(FailureCode::Refused, "it stays on")),
            };
            call.reply(CALL, &reply.to_bytes().unwrap()).await.unwrap();
        }
    });

    let text = site.text(&["service", "call", "/light", "std_srvs/srv/SetBool", "{data: true}"]).await;
    let request = "requester: making request: std_srvs.srv.SetBool_Request(data=True)";
    let response = "response:\nstd_srvs.srv.SetBool_Response(success=True, message='on')";
    assert_eq!(text, format!("{request}\n\n{response}\n"));
    let value = site.json(&["service", "call", "light", "std_srvs/srv/SetBool", "data: true"]).await;
    assert_eq!((&value["response"]["success"], &value["response"]["message"]), (&true.into(), &"on".into()));
    for (arguments, needle) in [
        (&["std_srvs/srv/SetBool", "{data: false}"][..], "it stays on"),
        (&["std_srvs/srv/Trigger"], "/light is of std_srvs/srv/SetBool, and not of std_srvs/srv/Trigger"),
        (&["std_srvs/srv/SetBool", "{dato: true}"], "no field `dato`; its fields are: data"),
    ] {
        let refusal = site.refusal(&[&["service", "call", "/light"], arguments].concat()).await;
        assert!(refusal.contains(needle), "{arguments:?}: {refusal}");
    }
    serving.abort();
    site.switch.stop().await;
}

/// A daemon, and a user with a keyring for topics.
struct Site {
    switch: Running,
    user: User,
    entity: Name,
    owners: Vec<Owner>,
}

impl Site {
    async fn new(topics: &[(&str, &str)]) -> Self {
        let user = User::new();
        let switch = start(config(user.folder.path(), "ctl")).await.unwrap();
        let keyring = user.file("keyring");
        std::fs::create_dir(&keyring).unwrap();
        let key = SigningKey::generate().unwrap();
        key.save_new(&keyring.join("id.pem")).unwrap();
        let entity = Identity::new(key, "proxy").name();
        let mut owners = Vec::new();
        for (i, (topic, kind)) in topics.iter().enumerate() {
            let what = if kind.contains("/srv/") { "service" } else { "topic" };
            let owner = Owner::of_type(what, topic, kind);
            owner.card.save_new(&keyring.join(format!("{i}.card"))).unwrap();
            std::fs::write(keyring.join(format!("{i}.grant")), owner.grant(entity).to_pem()).unwrap();
            std::fs::write(keyring.join(format!("{i}.ad")), owner.ad(entity).to_pem()).unwrap();
            owners.push(owner);
        }
        Self { switch, user, entity, owners }
    }

    async fn node(&self, identity: Identity) -> Node {
        let link = format!("udp://{}", self.switch.udp_addr().unwrap()).parse().unwrap();
        Node::connect(NodeConfig::new(identity, link)).await.unwrap()
    }

    async fn talker(&self, topic: &str, definition: &str) -> Talker {
        let owner = self.owners.iter().find(|owner| owner.card.get("topic") == Some(topic)).unwrap();
        let node = self.node(Identity::generate("proxy").unwrap()).await;
        let publisher =
            node.publish(owner.card.proof(), owner.ad(node.name()).into(), PublishOptions::reliable()).await.unwrap();
        let kind = Kind { dialect: Dialect::Ros2, name: owner.card.get("type").unwrap().into(), hash: vec![] };
        let mut roster = Outgoing::new(kind, Some(definition.into()));
        roster.joined((), "", OFFER);
        Talker { publisher, roster, _node: node }
    }

    fn command(&self, arguments: &[&str]) -> std::process::Command {
        let mut command = self.user.command(arguments);
        command.env("GDP_KEYRING", self.user.file("keyring"));
        command
    }

    /// Runs a command in a separate thread, because the daemon runs in this process and must not
    /// block.
    async fn output(&self, arguments: &[&str]) -> Output {
        let mut command = self.command(arguments);
        tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
    }

    async fn text(&self, arguments: &[&str]) -> String {
        let output = self.output(arguments).await;
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    async fn json(&self, arguments: &[&str]) -> Value {
        let text = self.text(&[&["-j"], arguments].concat()).await;
        let value: Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{arguments:?}: {error}: {text}"));
        expect_described(arguments, &value);
        value
    }

    async fn refusal(&self, arguments: &[&str]) -> String {
        let output = self.output(arguments).await;
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {error}");
        error
    }

    fn follow(&self, arguments: &[&str]) -> Following {
        let mut child = self.command(arguments).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Following { child, lines }
    }
}

/// A publisher that behaves like a proxy's publisher for a ROS publisher.
struct Talker {
    publisher: Publisher,
    roster: Outgoing<()>,
    _node: Node,
}

impl Talker {
    async fn send(&mut self, body: &[u8]) {
        self.send_in(Encoding::Cdr, body).await;
    }

    async fn send_in(&mut self, encoding: Encoding, body: &[u8]) {
        self.roster.announce(Instant::now(), &self.publisher).unwrap();
        let origin = roster::origin(self.roster.number(&()).unwrap());
        self.publisher.send_batch(&[Draft { origin: &origin, ..Draft::new(encoding, body) }]).await.unwrap();
    }
}

/// A command that runs until it is interrupted.
struct Following {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Following {
    /// Returns the output up to a line that contains `needle`.
    fn until(&mut self, needle: &str) -> String {
        let mut text = String::new();
        while !text.contains(needle) {
            assert!(self.lines.read_line(&mut text).unwrap() > 0, "it ended: {text}");
        }
        text
    }

    fn interrupt(&mut self) {
        // SAFETY: kill takes two numbers. The child has not been waited for, so the process id is
        // still its own.
        unsafe { libc::kill(self.child.id() as i32, libc::SIGINT) };
        assert!(self.child.wait().unwrap().success(), "^C is no failure");
    }
}

impl Drop for Following {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

impl Owner {
    fn of_type(kind: &str, topic: &str, of: &str) -> Self {
        let key = SigningKey::generate().unwrap();
        let card = gdp_core::card::NameCard::create(key.verify_key(), kind, topic, of, None).unwrap();
        Self { key, card }
    }

    fn grant(&self, entity: Name) -> Reading {
        let (name, to, not_after) = (self.card.name(), Grantee::Entity(entity), tomorrow());
        issue(&self.key, &ReadGrant { name, to, serial: 1, not_before: 0, not_after }).unwrap().into()
    }

    fn ad(&self, entity: Name) -> gdp_core::cert::Signed<AdCert> {
        let (name, scope) = (self.card.name(), Vec::new());
        issue(&self.key, &AdCert { name, entity, scope, serial: 1, not_before: 0, not_after: tomorrow() }).unwrap()
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn tomorrow() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs() + 24 * 3600
}
