//! Two people: one starts a server and invites a robot, the other joins with the printed line.
//! Robot and laptop are behind NAT, so their ROS graphs and the server's do not meet by multicast.
//!
//! ```text
//!   robot:w0 ──── i0:nat:o0 ──── e0:server:a0 ──── o0:nat:i0 ──── w0:alice
//!   192.168.5.7     10.9.0.2     10.9.0.1          10.9.1.2       192.168.5.7
//! ```

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::Tools;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::wait::TIMEOUT;
use serde_json::Value;

const AT: &str = "10.9.0.1";

/// The port of the join service's metrics.
const JOIN_METRICS: u16 = 9406;

#[test]
fn a_robot_joins_in_two_commands_each_and_both_directions_flow() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.invite_as_in_readme("robot7")?;
    let joined = Instant::now();
    scene.join("robot7", &line)?;
    assert_eq!((scene.at_server, scene.at_members), (2, 1), "commands: up, invite; join");

    let robot = &scene.robot.inside;
    let _talker = scene.talk(robot, "rt/chatter", 64, 20.0)?;
    let mut hears = scene.listen(&scene.server, "rt/robot7/chatter")?;
    first(&mut hears)?;
    println!("first message {} ms after join", joined.elapsed().as_millis());
    let _camera = scene.talk(robot, "rt/camera/image", 900_000, 15.0)?;
    first(&mut scene.listen(&scene.server, "rt/robot7/camera/image")?).context("the camera")?;
    let _commands = scene.talk(&scene.server, "rt/robot7/cmd_vel", 64, 20.0)?;
    first(&mut scene.listen(robot, "rt/cmd_vel")?).context("the commands")?;

    // What nobody invited the robot to expose does not arrive, although the topic is there.
    let _secret = scene.talk(robot, "rt/secret", 64, 20.0)?;
    let secret = scene.listen(&scene.server, "rt/robot7/secret")?;
    std::thread::sleep(Duration::from_secs(2));
    ensure!(!has_message(&secret), "a topic that was not exposed");

    let robots = scene.robots()?;
    ensure!(state_of(&robots, "robot7")? == "online" && state_of(&robots, "server")? == "online", "{robots}");
    let metrics = scene.join_metrics()?;
    ensure!(metrics.contains("gdp_join_members{state=\"joined\"} 2"), "{metrics}");
    ensure!(metrics.contains("gdp_join_replies_total{outcome=\"joined\"}"), "{metrics}");
    Ok(())
}

#[test]
fn a_member_is_revoked_by_its_label_and_its_line_is_worth_nothing() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.invite("robot7", &["--expose", "/chatter"])?;
    let refused = scene.ctl(&["invite", "robot7", "--expose", "/chatter"]);
    ensure!(refused.unwrap_err().to_string().contains("gdp-ctl revoke robot7"), "a label names one member");
    scene.join("robot7", &line)?;
    let _talker = scene.talk(&scene.robot.inside, "rt/chatter", 64, 20.0)?;
    let mut hears = scene.listen(&scene.server, "rt/robot7/chatter")?;
    first(&mut hears)?;

    let stolen = scene.try_join("thief", &line, &scene.alice.inside)?;
    ensure!(stolen.contains("has admitted") || stolen.contains("admits one"), "a used line: {stolen}");

    scene.ctl(&["revoke", "robot7"])?;
    let silent = Instant::now() + TIMEOUT;
    let mut count = hears.json_lines().len();
    loop {
        std::thread::sleep(Duration::from_secs(3));
        let now = hears.json_lines().len();
        if now == count {
            break;
        }
        count = now;
        ensure!(Instant::now() < silent, "a revoked robot is still carried");
    }
    ensure!(state_of(&scene.robots()?, "robot7")? == "revoked");
    // It is published again, because no daemon may have answered before.
    let again = scene.ctl(&["revoke", "robot7"])?;
    ensure!(again.contains("revocation 1"), "{again}");
    let unknown = scene.ctl(&["revoke", "robot9"]).unwrap_err().to_string();
    ensure!(unknown.contains("gdp-ctl robots"), "{unknown}");
    // The label is free again.
    scene.invite("robot7", &["--expose", "/chatter"]).map(drop)
}

#[test]
fn a_laptop_reads_what_it_was_invited_to_and_a_member_leaves() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.invite("robot7", &["--expose", "/chatter,/camera/**"])?;
    scene.join("robot7", &line)?;
    let line = scene.invite_as_in_readme("alice")?;
    scene.join("alice", &line)?;
    let robot = &scene.robot.inside;
    let _chatter = scene.talk(robot, "rt/chatter", 64, 20.0)?;
    let _camera = scene.talk(robot, "rt/camera/image", 900_000, 15.0)?;
    let chatter = scene.listen(&scene.alice.inside, "rt/robot7/chatter")?;
    first(&mut scene.listen(&scene.alice.inside, "rt/robot7/camera/image")?)?;
    std::thread::sleep(Duration::from_secs(2));
    ensure!(!has_message(&chatter), "alice may read the camera only");

    let mut alice = scene.members.pop().context("alice's proxy")?;
    alice.stop(TIMEOUT)?;
    scene.reads_with_what_joining_wrote()?;
    let mut command = scene.alice.inside.command(scene.tools.gdp_proxy()?)?;
    let left = execute(command.args(["leave", "--dir"]).arg(scene.files.path().join("alice")))?;
    ensure!(left.contains("no longer lists"), "{left}");
    ensure!(!scene.files.path().join("alice/membership").exists(), "its files are gone");
    let rows = scene.robots()?;
    ensure!(
        rows["members"]
            .as_array()
            .is_some_and(|rows| rows.iter().all(|row| { row["label"] != "alice" || row["entity"].is_null() })),
        "{rows}"
    );
    Ok(())
}

/// Without a proxy on her machine: the programs have her key.
#[test]
fn programs_of_a_member_read_a_robots_topic_by_its_label() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.invite("robot7", &["--expose", "/chatter"])?;
    scene.join("robot7", &line)?;
    let line = scene.invite("alice", &["--read", "robot7:/chatter"])?;
    execute(scene.join_command("alice", &line, &scene.alice.inside)?.arg("--no-run"))?;
    let _talker = scene.talk(&scene.robot.inside, "rt/chatter", 64, 20.0)?;
    // From here on, the robot lists the topic.
    first(&mut scene.listen(&scene.server, "rt/robot7/chatter")?)?;

    let in_rust = scene.reads_in_rust("/robot7/chatter")?;
    ensure!(in_rust.len() >= 64, "{} bytes", in_rust.len());
    let unknown = scene.reads_in_rust("/robot9/chatter").unwrap_err().to_string();
    ensure!(unknown.contains("no member has the label robot9"), "{unknown}");
    let in_python = scene.reads_in_python("/robot7/chatter")?;
    ensure!(in_python == in_rust.len(), "{in_python} bytes, and {} in Rust", in_rust.len());
    Ok(())
}

#[test]
fn a_robot_without_an_invitation_of_its_own_waits_for_approval() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.ctl(&["invite"])?;
    let mut robot = scene.apply("robot8", &line, &scene.robot.inside)?;
    let fingerprint = shown_fingerprint(&mut robot)?;
    robot.wait_until("its application", TIMEOUT, |_| {
        let rows = scene.robots().ok()?;
        let row = rows["members"].as_array()?.iter().find(|row| row["label"] == "robot8")?.clone();
        (row["state"] == "pending" && row["fingerprint"] == *fingerprint && row["expose"][0] == "/chatter")
            .then_some(())
    })?;
    let mut thief = scene.apply("robot9", &line, &scene.alice.inside)?;
    let other = shown_fingerprint(&mut thief)?;
    ensure!(other != fingerprint, "another machine");
    thief.wait_until("its application", TIMEOUT, |_| scene.ctl(&["deny", "robot9"]).ok())?;
    thief.wait_until("the denial", TIMEOUT, |thief| thief.stderr().contains("denied").then_some(()))?;

    let mistyped = scene.typed(&["approve", "robot8"], &format!("{other}\n"))?;
    ensure!(mistyped.contains("nothing is approved"), "{mistyped}");
    ensure!(scene.typed(&["approve", "robot8"], &format!("{fingerprint}\n"))?.contains("is approved"));
    robot.wait_until("the membership", TIMEOUT, |robot| robot.stdout().contains("Joined as robot8").then_some(()))?;
    let _talker = scene.talk(&scene.robot.inside, "rt/chatter", 64, 20.0)?;
    first(&mut scene.listen(&scene.server, "rt/robot8/chatter")?)?;
    let again = scene.ctl(&["approve", "robot8", "--yes"]).unwrap_err().to_string();
    ensure!(again.contains("gdp-ctl robots"), "{again}");
    Ok(())
}

#[test]
fn a_server_that_starts_again_goes_on_with_its_members() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.up()?;
    let line = scene.invite("robot7", &["--expose", "/chatter"])?;
    scene.join("robot7", &line)?;
    let _talker = scene.talk(&scene.robot.inside, "rt/chatter", 64, 20.0)?;
    first(&mut scene.listen(&scene.server, "rt/robot7/chatter")?)?;
    scene.up.take().context("the server")?.stop(TIMEOUT)?;
    scene.up()?;
    let said = scene.up.as_ref().context("the server")?.stdout();
    ensure!(said.contains("as it was, with 1 members"), "{said}");
    first(&mut scene.listen(&scene.server, "rt/robot7/chatter")?).context("after the restart")
}

pub struct Scene {
    // Fields drop in this order: programs, network, files.
    pub up: Option<Process>,
    pub members: Vec<Process>,
    pub server: Namespace,
    pub robot: BehindNat,
    alice: BehindNat,
    pub tools: Tools,
    /// Commands that the people have typed.
    at_server: usize,
    at_members: usize,
    pub files: tempfile::TempDir,
}

/// A machine behind NAT.
pub struct BehindNat {
    pub inside: Namespace,
    pub nat: Namespace,
}

impl BehindNat {
    /// Connects a machine to the server's interface, over the network `10.9.NET.0/24`.
    pub fn new(label: &str, server: &Namespace, interface: &str, net: u8) -> Result<Self> {
        let (inside, nat) = (Namespace::create(label)?, Namespace::create("nat")?);
        let end = |namespace, interface, number| End { namespace, interface, mac: [2, 0, 0, 0, net, number] };
        veth(&end(&inside, "w0", 1), &end(&nat, "i0", 2), 1500)?;
        veth(&end(&nat, "o0", 3), &end(server, interface, 4), 1500)?;
        for (side, command) in [
            (&inside, "addr add 192.168.5.7/24 dev w0".to_owned()),
            (&nat, "addr add 192.168.5.1/24 dev i0".to_owned()),
            (&nat, format!("addr add 10.9.{net}.2/24 dev o0")),
            (&nat, format!("route add default via 10.9.{net}.1")),
            (server, format!("addr add 10.9.{net}.1/24 dev {interface}")),
            (&inside, "route add default via 192.168.5.1".to_owned()),
        ] {
            side.ip(&command.split(' ').collect::<Vec<_>>())?;
        }
        nat.masquerade("i0")?;
        inside.enable_loopback_multicast()?;
        Ok(Self { inside, nat })
    }
}

impl Scene {
    pub fn build() -> Result<Self> {
        let server = Namespace::create("server")?;
        server.enable_loopback_multicast()?;
        let robot = BehindNat::new("robot", &server, "e0", 0)?;
        let alice = BehindNat::new("alice", &server, "a0", 1)?;
        let (tools, files) = (Tools::beside_this_test()?, tempfile::tempdir()?);
        Ok(Self { up: None, members: vec![], server, robot, alice, tools, at_server: 0, at_members: 0, files })
    }

    /// Returns a command of the administrator, on the server.
    fn at_server(&self, arguments: &[&str]) -> Result<Command> {
        let mut command = self.server.command(self.tools.gdp_ctl()?)?;
        command.env("GDP_HOME", self.files.path().join("home")).env("GDP_SOCKET", self.files.path().join("ctl.sock"));
        command.args(arguments);
        Ok(command)
    }

    fn up(&mut self) -> Result<()> {
        self.up_with(&[])
    }

    pub fn up_with(&mut self, options: &[&str]) -> Result<()> {
        self.at_server += 1;
        let mut command = self.at_server(&[&["up", "--at", AT], options].concat())?;
        command.env("GDP_JOIN_METRICS", JOIN_METRICS.to_string());
        let mut up = Process::spawn("up", command, self.files.path())?;
        up.wait_until("the domain", TIMEOUT * 2, |up| up.stdout().contains("Next").then_some(()))?;
        self.up = Some(up);
        Ok(())
    }

    /// Returns what the join service answers to Prometheus.
    fn join_metrics(&self) -> Result<String> {
        let _inside = self.server.enter()?;
        let mut stream = TcpStream::connect(("127.0.0.1", JOIN_METRICS))?;
        stream.write_all(b"GET /metrics HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(answer)
    }

    pub fn ctl(&self, arguments: &[&str]) -> Result<String> {
        execute(&mut self.at_server(arguments)?)
    }

    pub fn invite(&mut self, label: &str, what: &[&str]) -> Result<String> {
        self.at_server += 1;
        self.ctl(&[&["invite", label], what].concat())
    }

    /// Invites with the command that README shows for this label.
    fn invite_as_in_readme(&mut self, label: &str) -> Result<String> {
        let command = format!("server$ sudo gdp-ctl invite {label} ");
        let readme = include_str!("../../../README.md");
        let options = readme.lines().find_map(|line| line.strip_prefix(&command)).context("a command in README")?;
        let options: Vec<_> = options.split(' ').map(|option| option.trim_matches('\'')).collect();
        self.invite(label, &options)
    }

    /// Joins on the machine of this label, and leaves the proxy running there.
    pub fn join(&mut self, label: &str, line: &str) -> Result<()> {
        self.at_members += 1;
        let at = if label == "alice" { &self.alice.inside } else { &self.robot.inside };
        let mut member = Process::spawn(label, self.join_command(label, line, at)?, self.files.path())?;
        member.wait_until("the membership", TIMEOUT, |member| member.stdout().contains("Leave").then_some(()))?;
        self.members.push(member);
        Ok(())
    }

    /// Tries to join, and returns what the program says when it fails.
    pub fn try_join(&self, label: &str, line: &str, at: &Namespace) -> Result<String> {
        let mut command = self.join_command(label, line, at)?;
        let done = command.arg("--no-run").stdin(Stdio::null()).output()?;
        ensure!(!done.status.success(), "joined: {}", String::from_utf8_lossy(&done.stdout));
        Ok(String::from_utf8_lossy(&done.stderr).into_owned())
    }

    pub fn join_command(&self, label: &str, line: &str, at: &Namespace) -> Result<Command> {
        let mut command = at.command(self.tools.gdp_proxy()?)?;
        command.args(["join", "--dir"]).arg(self.files.path().join(label)).env("GDP_INVITATION", line);
        for proxy in ["HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"] {
            command.env_remove(proxy);
        }
        Ok(command)
    }

    /// Starts to ask for membership with the line for applicants.
    fn apply(&self, label: &str, line: &str, at: &Namespace) -> Result<Process> {
        let mut command = self.join_command(label, line, at)?;
        command.args(["--label", label, "--expose", "/chatter"]);
        Process::spawn(label, command, self.files.path())
    }

    /// Reads from the command line at alice's, without her proxy and without any further file.
    fn reads_with_what_joining_wrote(&self) -> Result<()> {
        let command = |arguments: &[&str]| -> Result<Command> {
            let mut command = self.alice.inside.command(self.tools.gdp_ctl()?)?;
            command.args(arguments).arg("--keyring").arg(self.files.path().join("alice"));
            command.env("GDP_SOCKET", "/nowhere/ctl.sock");
            Ok(command)
        };
        let refused = |arguments: &[&str]| -> Result<String> {
            let done = command(arguments)?.output()?;
            ensure!(done.status.code() == Some(1), "{arguments:?}: {done:?}");
            Ok(String::from_utf8_lossy(&done.stderr).into_owned())
        };
        let listed = execute(&mut command(&["topic", "list"])?)?;
        ensure!(listed.trim() == "/robot7/camera/image", "{listed}");
        let measuring = command(&["topic", "hz", "/robot7/camera/image"])?;
        let mut measuring = Process::spawn("alice-hz", measuring, self.files.path())?;
        measuring.wait_until("a rate", TIMEOUT, |hz| hz.stdout().contains("average rate").then_some(()))?;
        measuring.stop(TIMEOUT)?;

        let secret = refused(&["topic", "echo", "/robot7/chatter", "--once"])?;
        ensure!(secret.contains("robot7 lists no topic /chatter for alice, but /robot7/camera/image"), "{secret}");
        ensure!(secret.contains("gdp-ctl invite alice --read 'robot7:/chatter'"), "{secret}");
        let unknown = refused(&["topic", "hz", "/robot9/chatter"])?;
        ensure!(unknown.contains("no member has the label robot9") && unknown.contains("robot7"), "{unknown}");
        let nobody = refused(&["topic", "hz", "chatter"])?;
        ensure!(nobody.contains("not a topic of a member, which is written /LABEL/TOPIC"), "{nobody}");
        Ok(())
    }

    /// Returns the payload of the next message that a program of alice's reads, with the SDK for
    /// Rust.
    fn reads_in_rust(&self, topic: &str) -> Result<Vec<u8>> {
        // The threads of the runtime and of the SDK are in the namespace of this one.
        let _inside = self.alice.inside.enter()?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let reading = async {
            let session = gdp::open(gdp::Config::new(self.files.path().join("alice"))).await?;
            let sample = session.subscriber(topic).await?.recv().await?.context("a message")?;
            session.close().await?;
            Ok(sample.payload().to_vec())
        };
        runtime.block_on(async { tokio::time::timeout(TIMEOUT, reading).await })?
    }

    /// Returns the length of the payload of the next message, with the SDK for Python.
    fn reads_in_python(&self, topic: &str) -> Result<usize> {
        let program = "import sys, gdp.blocking\n\
                       with gdp.blocking.open(sys.argv[1]) as session:\n    \
                       print(len(next(iter(session.subscribe(sys.argv[2]))).payload), flush=True)\n";
        let packages = self.files.path().join("packages");
        self.tools.install_python_sdk(&packages)?;
        let mut command = self.alice.inside.command(self.tools.python_of_sdk()?)?;
        command.args(["-c", program]).arg(self.files.path().join("alice")).arg(topic);
        command.env("PYTHONPATH", packages).env("PYTHONDONTWRITEBYTECODE", "1");
        let mut reading = Process::spawn("python", command, self.files.path())?;
        reading.wait_until("a message", TIMEOUT, |reading| reading.stdout().trim().parse().ok())
    }

    /// Runs a command with this input, and returns all that it says.
    fn typed(&self, arguments: &[&str], input: &str) -> Result<String> {
        let mut command = self.at_server(arguments)?;
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        child.stdin.take().context("its input")?.write_all(input.as_bytes())?;
        let done = child.wait_with_output()?;
        Ok(String::from_utf8_lossy(&[done.stdout, done.stderr].concat()).into_owned())
    }

    fn robots(&self) -> Result<Value> {
        Ok(serde_json::from_str(&self.ctl(&["-j", "robots"])?)?)
    }

    pub fn talk(&self, at: &Namespace, topic: &str, size: usize, rate: f64) -> Result<Process> {
        let label = format!("talk{}", topic.replace('/', "-"));
        let (size, rate) = (size.to_string(), rate.to_string());
        let options = ["--no-wait", "--size", &size, "--rate", &rate];
        Process::spawn(&label, self.cyclone(at, "talk", topic, &options)?, self.files.path())
    }

    pub fn listen(&self, at: &Namespace, topic: &str) -> Result<Process> {
        let label = format!("listen{}-{}", topic.replace('/', "-"), at.name());
        Process::spawn(&label, self.cyclone(at, "listen", topic, &[])?, self.files.path())
    }

    fn cyclone(&self, at: &Namespace, verb: &str, topic: &str, options: &[&str]) -> Result<Command> {
        let mut command = at.command(self.tools.python()?)?;
        command.arg(self.tools.cyclone()).args([verb, "--topic", topic]).args(options);
        Ok(command)
    }
}

/// Waits until a machine shows its fingerprint.
fn shown_fingerprint(machine: &mut Process) -> Result<String> {
    machine.wait_until("a fingerprint", TIMEOUT, |machine| {
        let text = machine.stderr();
        Some(text.split_once("Fingerprint: ")?.1.lines().next()?.trim().to_owned())
    })
}

fn has_message(listener: &Process) -> bool {
    listener.json_lines().iter().any(|line| line["event"] == "message")
}

/// Waits for a message.
pub fn first(listener: &mut Process) -> Result<()> {
    listener.wait_until("a message", TIMEOUT, |listener| has_message(listener).then_some(()))
}

fn state_of<'a>(robots: &'a Value, label: &str) -> Result<&'a str> {
    let rows = robots["members"].as_array().context("a list")?;
    let row = rows.iter().find(|row| row["label"] == label);
    match row.and_then(|row| row["state"].as_str()) {
        Some(state) => Ok(state),
        None => bail!("{label} is not listed: {robots}"),
    }
}
