//! The keys of a domain over its life: memberships renew themselves while the domain's key is
//! offline, its successor takes its place, and three switches with twenty robots get a new key.

use std::fs;

use anyhow::{Context, Result, ensure};
use gdp_core::cert::Membership;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::Value;

use super::fleet::Scene;

const SWITCHES: [(&str, &str, u8); 2] = [("switch2", "e2", 2), ("switch3", "e3", 3)];

/// Seconds for which a membership lasts in these tests.
const LIFETIME: &str = "12s";

#[test]
fn memberships_renew_themselves_while_the_key_of_the_domain_is_offline() -> Result<()> {
    let mut scene = Scene::build()?;
    scene.start(&["up", "--at", "127.0.0.1", "--no-ros", "--lifetime", LIFETIME])?;
    let line = scene.ctl(&["invite", "robot7", "--expose", "/chatter", "--within", "4s"])?;
    let guest = scene.ctl(&["invite", "guest", "--expose", "/chatter", "--within", "4s", "--for", "16s"])?;
    for (label, line) in [("robot7", &line), ("guest", &guest)] {
        scene.join(label, line)?;
    }
    fs::create_dir(scene.path("stick"))?;
    fs::rename(scene.path("home/domain.pem"), scene.path("stick/domain.pem"))?;
    let mut robot = scene.run("robot7")?;
    robot.wait_until("the directory", TIMEOUT, is_attached)?;

    // Beyond the end of the first membership, and of the first renewal.
    let until = |file: &str| -> Result<u64> {
        Ok(Membership::from_pem(&fs::read_to_string(scene.path(file))?)?.until_unverified()?)
    };
    let (first, of_switch) = (until("robot7/membership")?, until("home/switch.member")?);
    wait_for("two renewals", TIMEOUT * 2, || {
        robot.check_alive()?;
        let (now, switch) = (until("robot7/membership")?, until("home/switch.member")?);
        Ok((now > first + 6 && switch > of_switch + 12).then_some(()))
    })
    .with_context(|| robot.report())?;
    let state = |label: &str| -> Result<Value> {
        let rows = scene.robots()?;
        let row = rows.iter().find(|row| row["label"] == label);
        Ok(row.with_context(|| format!("{label} of {rows:?}"))?["state"].clone())
    };
    ensure!(state("robot7")? == "online");
    ensure!(!robot.stderr().contains("lost the link"), "the link stays: {}", robot.report());
    // Who was invited for sixteen seconds is no member then.
    wait_for("the guest's end", TIMEOUT, || {
        let state = state("guest")?;
        Ok((state != "online" && state != "offline").then_some(()))
    })?;

    // The server starts again without the key, which only signs what is new.
    drop(robot);
    scene.stop()?;
    scene.start(&["up", "--no-ros"])?;
    scene.run("robot7")?.wait_until("the directory", TIMEOUT, is_attached)?;
    let invite = ["invite", "robot8", "--expose", "/chatter"];
    scene.refused(&invite, "--key")?;
    let stick = scene.path("stick/domain.pem");
    scene.ctl(&[&invite[..], &["--key", &stick]].concat())?;

    // The key is lost. Its successor signs for the domain, whose name stays.
    fs::remove_file(&stick)?;
    let successor = scene.path("home/successor.pem");
    let line = scene.ctl(&["invite", "robot9", "--expose", "/chatter", "--key", &successor])?;
    scene.join("robot9", &line)?;
    scene.ctl(&["revoke", "robot9", "--key", &successor])?;
    scene.refuses("robot9")
}

#[test]
fn three_switches_and_twenty_robots_get_another_key_of_their_domain() -> Result<()> {
    let mut scene = Scene::build()?;
    // The switches' ends of the cables have no XDP program, which those of a veth would need.
    scene.start(&["up", "--at", "127.0.0.1", "--no-ros", "--no-xdp"])?;
    let mut switches = Vec::new();
    for (label, interface, net) in SWITCHES {
        switches.push(Switch::start(&scene, label, interface, net)?);
    }
    // Two commands for each robot: one on the server, one on the robot.
    for n in 1..=20 {
        let label = format!("robot{n}");
        let invite = ["invite", &label, "--expose", "/chatter"];
        let line = match switches.get(n % 3) {
            Some(switch) => scene.ctl(&[&invite[..], &["--at", &switch.at(), "--switch", &switch.name]].concat())?,
            None => scene.ctl(&invite)?,
        };
        scene.join(&label, &line)?;
    }
    ensure!(scene.joined()? == 20);
    // One at each switch runs.
    let labels = ["robot3", "robot4", "robot5"];
    let mut robots = labels.map(|label| scene.run(label)).into_iter().collect::<Result<Vec<_>>>()?;
    for robot in &mut robots {
        robot.wait_until("the directory", TIMEOUT, is_attached)?;
    }
    scene.ctl(&["revoke", "robot6"])?;
    scene.refuses("robot6")?;

    let old = scene.path("old.pem");
    fs::copy(scene.path("home/domain.pem"), &old)?;
    scene.refused(&["admin", "rotate", "--key", &old], "is not the successor")?;
    let rotated: Value = serde_json::from_str(&scene.ctl(&["-j", "admin", "rotate"])?)?;
    ensure!(rotated["members"].as_array().is_some_and(|members| members.len() == 19), "{rotated}");
    let signer = |label: &str| -> Result<String> {
        let text = fs::read_to_string(scene.path(&format!("{label}/membership")))?;
        Ok(Membership::from_pem(&text)?.signer_unverified()?.to_string())
    };
    for label in labels {
        wait_for("the new membership", TIMEOUT, || Ok((rotated["key"] == signer(label)?).then_some(())))?;
    }
    // The domain's other switches are admitted again, and take the file while they run.
    for switch in &switches {
        let membership = scene.path(&format!("{}.member", switch.label));
        let (key, card) = (scene.path("home/domain.pem"), scene.path("home/domain.card"));
        let admit = ["domain", "admit", "--key", &key, "--card", &card, &switch.name, "--role", "switch"];
        scene.ctl(&[&admit[..], &["-o", &membership]].concat())?;
        fs::rename(membership, scene.path(&format!("{}/membership", switch.label)))?;
    }
    wait_for("the switches' memberships", TIMEOUT, || {
        let renewed = |switch: &Switch| switch.process.stderr().contains("took renewed papers");
        Ok(switches.iter().all(renewed).then_some(()))
    })
    .with_context(|| switches.iter().map(|switch| switch.process.report()).collect::<String>())?;
    scene.ctl(&["admin", "rotate", "--retire"])?;

    // What the first key signs or signed does not hold, and what runs goes on.
    scene.refused(&["invite", "robot30", "--expose", "/a", "--key", &old], "retired")?;
    scene.refuses_for("robot9", "retired")?;
    let line = scene.ctl(&["invite", "robot21", "--expose", "/chatter"])?;
    scene.join("robot21", &line)?;
    for (label, robot) in labels.iter().zip(&mut robots) {
        robot.check_alive()?;
        ensure!(!robot.stderr().contains("lost the link"), "{label} keeps its link: {}", robot.report());
    }
    for label in labels {
        drop(robots.remove(0));
        scene.run(label)?.wait_until("the directory", TIMEOUT, is_attached)?;
    }
    Ok(())
}

fn is_attached(proxy: &Process) -> Option<()> {
    proxy.stderr().contains("what=directory").then_some(())
}

/// A further switch of the domain, in a network of its own.
struct Switch {
    label: &'static str,
    name: String,
    net: u8,
    process: Process,
    _at: Namespace,
}

impl Switch {
    /// Joins by the two commands of the administrator and of the switch.
    fn start(scene: &Scene, label: &'static str, interface: &str, net: u8) -> Result<Self> {
        let at = Namespace::create(label)?;
        let end = |namespace, interface, number| End { namespace, interface, mac: [2, 0, 0, 0, net, number] };
        veth(&end(&at, "u0", 1), &end(&scene.server, interface, 2), 1500)?;
        at.ip(&["addr", "add", &format!("10.8.{net}.2/24"), "dev", "u0"])?;
        scene.server.ip(&["addr", "add", &format!("10.8.{net}.1/24"), "dev", interface])?;
        let first: Value = serde_json::from_str(&scene.ctl(&["-j", "status"])?)?;
        let first = first["name"].as_str().context("the switch's name")?.to_owned();
        let (key, card, dialled) =
            (scene.path("home/domain.pem"), scene.path("home/domain.card"), format!("udp://10.8.{net}.1:31415"));
        let invite = ["domain", "invite", "--key", &key, "--card", &card, "--role", "switch", "--at", &dialled];
        let line = scene.ctl(&[&invite[..], &["--switch", &first]].concat())?;

        let folder = scene.path(label);
        let mut join = at.command(scene.tools.gdp_ctl()?)?;
        let joined = execute(join.args(["-j", "domain", "join", line.trim(), "-o", &folder]))?;
        let joined: Value = serde_json::from_str(&joined)?;
        let name = joined["name"].as_str().context("a name")?.to_owned();
        let config = format!("{folder}/gdp.yaml");
        let more = "socket: ctl.sock\ndata_plane: userspace\n";
        fs::write(&config, fs::read_to_string(&config)? + more)?;
        let mut serve = at.command(scene.tools.gdp_ctl()?)?;
        serve.args(["serve", "--config", &config]);
        let process = Process::spawn(label, serve, scene.files.path())?;
        wait_for("the link to the first switch", TIMEOUT, || {
            let links: Value = serde_json::from_str(&scene.ctl(&["-j", "link", "list"])?)?;
            let links = links["links"].as_array().context("links")?;
            Ok(links.iter().any(|link| link["peer"] == name.as_str()).then_some(()))
        })
        .with_context(|| process.report())?;
        Ok(Self { label, name, net, process, _at: at })
    }

    fn at(&self) -> String {
        format!("udp://10.8.{}.2:31415", self.net)
    }
}
