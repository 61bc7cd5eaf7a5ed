//! A robot with two links, each over a cable that can be cut, to two switches or to one:
//!
//! ```text
//!          ┌ wlan0 ─ w0 wire w1 ─ l0 ┐       ┌────────── s1 (RIB) ─ c0 ──── e0 cloud
//!  robot ──┤                         ├─ XDP ─┤            │ x0
//!          └ wwan0 ─ m0 wire m1 ─ l1 ┘       └── s2, or ──┘
//! ```

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::unstable::{LinkState, PublishOptions, SubscribeOptions};
use gdp_core::identity::Identity;
use gdp_faults::Faults;
use gdp_tests::Tools;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::own;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_tests::wire::Wire;
use serde_json::{Value, json};

use crate::flows::{Flow, Heard, Party, Topic};
use crate::patient::patient;

const MS: u64 = 1_000_000;

/// One-way delays: the Wi-Fi is fast, the mobile network is slow. Neither loses frames until it is
/// cut.
const WIFI: u64 = 3 * MS;
const LTE: u64 = 15 * MS;

/// Duration of a cut.
const CUT: Duration = Duration::from_secs(3);

/// Interval between two messages of a topic, and their bytes: two frames. Messages that a reader
/// gets on each of two links are smaller. They must fit the smaller link; the writer cannot know of
/// it.
const PERIOD: Duration = Duration::from_millis(20);
const SIZE: usize = 2000;
const SMALL: usize = 1000;

/// Bound on gaps of messages on two links. They do not wait until a cut is noticed.
const NO_GAP: Duration = Duration::from_millis(400);

/// Least time in which a cut is noticed: five echoes of 40 ms, one of which is sent just after it.
/// The message that is sent last before the next link is used is a period younger.
const NOTICED: Duration = Duration::from_millis(130);

#[test]
fn with_two_switches_nothing_is_missed_while_either_link_is_cut() -> Result<()> {
    loses_nothing(2)
}

#[test]
fn with_one_switch_nothing_is_missed_while_either_link_is_cut() -> Result<()> {
    loses_nothing(1)
}

/// Topics on two links have no gap; those on one link move to the other, and lost messages are
/// repaired.
fn loses_nothing(switches: usize) -> Result<()> {
    let site = Site::build(switches)?;
    let (robot, cloud) = (site.robot()?, site.cloud()?);
    robot.wait_for_links(|links| links[0].main && links.iter().all(|link| link.state == LinkState::Up))?;
    let twice = |options| PublishOptions { duplicate: true, ..options };
    let from_robot = [
        Topic::open(&robot, &cloud, &[], twice(PublishOptions::reliable()), SubscribeOptions::reliable())?,
        Topic::open(&robot, &cloud, &[], twice(PublishOptions { history: 1024, ..patient().0 }), patient().1)?,
        Topic::open(&robot, &cloud, &[], PublishOptions::reliable(), SubscribeOptions::reliable())?,
    ];
    let by_each = SubscribeOptions { duplicate: true, ..SubscribeOptions::reliable() };
    let to_robot = [
        Topic::open(&cloud, &robot, &[], PublishOptions::reliable(), by_each)?,
        Topic::open(&cloud, &robot, &[], PublishOptions::reliable(), SubscribeOptions::reliable())?,
    ];
    let topics: Vec<Topic> = from_robot.into_iter().chain(to_robot).collect();
    let sizes = [SIZE, SIZE, SIZE, SMALL, SIZE];
    let flows: Vec<Flow> =
        topics.into_iter().zip(sizes).map(|(topic, size)| Flow::start(topic, size, PERIOD)).collect();
    let watch = Watch::begin();
    let heard = |flows: &[Flow]| flows.iter().map(Flow::heard).min().unwrap_or(0);
    let until = |what: &str, count: usize| {
        wait_for(what, TIMEOUT, || Ok((heard(&flows) >= count).then_some(()))).with_context(|| site.report())
    };
    until("messages by both links", 100)?;
    for lane in [0, 1] {
        site.cut(lane);
        robot.wait_for_links(|links| links[lane].state != LinkState::Up && links[1 - lane].main)?;
        let so_far = heard(&flows);
        until("messages while a link is cut", so_far + 50)?;
        robot
            .wait_for_links(|links| links[0].main && links.iter().all(|link| link.state == LinkState::Up))
            .with_context(|| site.report())?;
        let so_far = heard(&flows);
        until("messages by both links again", so_far + 50)?;
    }
    // The delay that this machine's other load caused.
    let late = watch.end();
    let results = flows.into_iter().map(Flow::finish).collect::<Result<Vec<_>>>()?;
    for (i, result) in results.iter().enumerate() {
        let Heard { slowest, counters, .. } = result;
        let sequences: Vec<u64> = result.messages.iter().map(|(sequence, _)| *sequence).collect();
        let all = sequences.iter().copied().eq(1..=sequences.len() as u64);
        ensure!(all, "topic {i}: not each once and in order: {sequences:?}, {counters:?}");
        ensure!(sequences.len() as u64 == result.sent, "topic {i}: {} of {}", sequences.len(), result.sent);
        ensure!(counters.abandoned + counters.overtaken + counters.expired == 0, "topic {i}: {counters:?}");
        if [0, 1, 3].contains(&i) {
            ensure!(*slowest < NO_GAP + late, "topic {i}: a message took {slowest:?}; {late:?}, {counters:?}");
        } else {
            eprintln!("topic {i}: a message took {slowest:?} as it moved to the other link");
            ensure!((NOTICED..CUT + late).contains(slowest), "topic {i}: it moved over and was repaired: {slowest:?}");
        }
    }
    ensure!(robot.node.links().iter().all(|link| link.copies_dropped == 0), "{:?}", robot.node.links());
    site.wires.iter().try_for_each(Wire::check)
}

/// Measures how long threads wait for a CPU on this machine.
struct Watch {
    stop: Arc<AtomicBool>,
    worst: Option<JoinHandle<Duration>>,
}

impl Watch {
    fn begin() -> Self {
        const NAP: Duration = Duration::from_millis(10);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let watching = move || {
            let mut worst = Duration::ZERO;
            while !stopped.load(Ordering::Relaxed) {
                let began = Instant::now();
                std::thread::sleep(NAP);
                worst = worst.max(began.elapsed().saturating_sub(NAP));
            }
            worst
        };
        Self { stop, worst: Some(std::thread::spawn(watching)) }
    }

    /// Ends the measurement and returns the longest delay.
    fn end(mut self) -> Duration {
        self.stop.store(true, Ordering::Relaxed);
        self.worst.take().map_or(Duration::ZERO, |worst| worst.join().expect("no panic"))
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

#[test]
fn what_comes_twice_is_counted_and_dropped() -> Result<()> {
    for switches in [1, 2] {
        let site = Site::build(switches)?;
        let (robot, cloud) = (site.robot()?, site.cloud()?);
        robot.wait_for_links(|links| links[0].main && links.iter().all(|link| link.state == LinkState::Up))?;
        let out = PublishOptions { duplicate: true, ..PublishOptions::reliable() };
        let by_each = SubscribeOptions { duplicate: true, ..SubscribeOptions::reliable() };
        let mut topics = [
            Topic::open(&robot, &cloud, &[], out, SubscribeOptions::reliable())?,
            Topic::open(&robot, &cloud, &[], PublishOptions::reliable(), SubscribeOptions::reliable())?,
            Topic::open(&cloud, &robot, &[], PublishOptions::reliable(), by_each)?,
            Topic::open(&cloud, &robot, &[], PublishOptions::reliable(), SubscribeOptions::reliable())?,
        ];
        const COUNT: u64 = 100;
        for i in 1..=COUNT {
            for topic in &mut topics {
                topic.send()?;
                ensure!(topic.hear()? == i, "each once");
            }
        }
        // A small body and its proof are one segment.
        let segments = COUNT;
        for (i, topic) in topics.iter().enumerate() {
            let expected = if i % 2 == 0 { segments } else { 0 };
            let duplicates = || topic.subscription.counters().inbound.duplicates;
            wait_for("all copies", TIMEOUT, || Ok((duplicates() >= expected).then_some(())))
                .with_context(|| format!("topic {i}: {:?} {:?}", topic.subscription.counters(), robot.node.links()))?;
            let (sent, counters) = (topic.publisher.counters().topic, topic.subscription.counters().inbound);
            ensure!(sent.repeated == 0 && counters.duplicates == expected, "topic {i}: {sent:?} {counters:?}");
        }
        let links = robot.node.links();
        ensure!(links[1].copies_sent >= COUNT && links[0].copies_sent == 0, "{links:?}");
    }
    Ok(())
}

#[test]
fn a_link_through_an_interface_that_is_made_anew_comes_back() -> Result<()> {
    let mut site = Site::build(2)?;
    let robot = site.robot()?;
    robot.wait_for_links(|links| links.iter().all(|link| link.state == LinkState::Up))?;
    site.places[0].ip(&["link", "del", "wwan0"])?;
    robot.wait_for_links(|links| links[1].state != LinkState::Up)?;
    site.lay_second()?;
    robot.wait_for_links(|links| links[1].state == LinkState::Up).with_context(|| site.report())
}

/// Switches, the robot's two cables, and space for two nodes.
struct Site {
    wires: Vec<Wire>,
    switches: Vec<Process>,
    places: [Namespace; 2],
    folder: tempfile::TempDir,
    count: usize,
    /// The cables' namespace and the switches'. Last field: the others must drop before their
    /// networks do.
    networks: Vec<Namespace>,
}

fn end<'a>(namespace: &'a Namespace, interface: &'a str, number: u8) -> End<'a> {
    End { namespace, interface, mac: [2, 0, 0, 0, 0, number] }
}

fn delayed(delay: u64) -> [Faults; 2] {
    [(); 2].map(|()| Faults { delay, ..Faults::default() })
}

impl Site {
    fn build(count: usize) -> Result<Self> {
        let [robot, air, s1, s2, cloud] = ["robot", "air", "s1", "s2", "cloud"].map(Namespace::create);
        let (robot, air, s1, s2, cloud) = (robot?, air?, s1?, s2?, cloud?);
        let second = if count == 2 { &s2 } else { &s1 };
        veth(&end(&robot, "wlan0", 1), &end(&air, "w0", 2), 1500)?;
        veth(&end(&air, "w1", 3), &end(&s1, "l0", 4), 1500)?;
        veth(&end(&air, "m1", 7), &end(second, "l1", 8), 1500)?;
        veth(&end(&s1, "x0", 9), &end(&s2, "x0", 10), 1500)?;
        veth(&end(&s1, "c0", 11), &end(&cloud, "e0", 12), 1500)?;
        // By its routes alone, the robot would search for the second switch on the first link.
        robot.ip(&["addr", "add", "10.8.0.2/24", "dev", "wlan0"])?;
        second.ip(&["addr", "add", "10.8.0.1/24", "dev", "l1"])?;
        let wires = vec![Wire::start(&air, ["w0", "w1"], delayed(WIFI), 1)?];
        let folder = tempfile::Builder::new().prefix("gdp-links-").tempdir()?;
        let (switches, places, networks) = (Vec::new(), [robot, cloud], vec![air]);
        let mut site = Self { wires, switches, places, folder, count, networks };
        site.lay_second()?;
        let (first_name, second_name) = (site.key(1)?, site.key(2)?);
        let one = json!({
            "interfaces": if count == 1 { vec!["l0", "l1", "c0"] } else { vec!["l0", "x0", "c0"] },
            "udp": if count == 1 { json!("10.8.0.1:31415") } else { json!(null) },
            "rib": true,
            "neighbours": if count == 1 { vec![] } else { vec![json!({"interface": "x0", "switch": second_name})] },
        });
        site.serve(1, &s1, one)?;
        if count == 2 {
            let toward = json!({"interface": "x0", "switch": first_name});
            let two = json!({
                "interfaces": ["l1", "x0"],
                "udp": "10.8.0.1:31415",
                "rib": false,
                "neighbours": [toward],
                "uplink": toward,
            });
            site.serve(2, &s2, two)?;
        }
        site.networks.extend([s1, s2]);
        Ok(site)
    }

    /// Creates the robot's second interface and its cable.
    fn lay_second(&mut self) -> Result<()> {
        let (robot, air) = (&self.places[0], &self.networks[0]);
        veth(&end(robot, "wwan0", 5), &end(air, "m0", 6), 1500)?;
        robot.ip(&["addr", "add", "10.8.0.3/24", "dev", "wwan0"])?;
        self.wires.truncate(1);
        self.wires.push(Wire::start(air, ["m0", "m1"], delayed(LTE), 2)?);
        Ok(())
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// Creates a switch's key and returns its name.
    fn key(&self, number: usize) -> Result<String> {
        let mut command = own(Tools::beside_this_test()?.gdp_ctl()?);
        command.args(["key", "generate", "--kind", "switch", "-j"]).arg(self.path(&format!("s{number}.pem")));
        let made: Value = serde_json::from_str(&execute(&mut command)?)?;
        made["name"].as_str().map(str::to_owned).context("its name")
    }

    fn serve(&mut self, number: usize, at: &Namespace, mut config: Value) -> Result<()> {
        let tools = Tools::beside_this_test()?;
        let file = |extension: &str| self.path(&format!("s{number}.{extension}"));
        config["identity"] = json!(file("pem"));
        config["socket"] = json!(file("sock"));
        config["data_plane"] = json!("xdp");
        config["bpffs"] = json!(null);
        fs::write(file("yaml"), config.to_string())?;
        let mut command = at.command(tools.gdp_ctl()?)?;
        command.args(["serve", "--config"]).arg(file("yaml")).env("GDP_EBPF_OBJECT", tools.ebpf_object()?);
        self.switches.push(Process::spawn(&format!("s{number}"), command, self.folder.path())?);
        Ok(())
    }

    fn robot(&self) -> Result<Party> {
        connect(&self.places[0], &["eth://wlan0", "udp://10.8.0.1:31415%wwan0"])
    }

    fn cloud(&self) -> Result<Party> {
        connect(&self.places[1], &["eth://e0"])
    }

    /// Drops everything for three seconds from now on.
    fn cut(&self, lane: usize) {
        let delay = [WIFI, LTE][lane];
        let partitions = vec![(0, CUT.as_nanos() as u64)];
        self.wires[lane].change([(); 2].map(|()| Faults {
            delay,
            partitions: partitions.clone(),
            ..Faults::default()
        }));
    }

    fn report(&self) -> String {
        let switches = self.switches.iter().map(Process::report).collect::<String>();
        format!("{} switches\n{switches}", self.count)
    }
}

fn connect(at: &Namespace, to: &[&str]) -> Result<Party> {
    Party::connect(at, Identity::generate("proxy")?, to, None)
}
