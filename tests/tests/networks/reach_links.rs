//! Links over TLS beside links over UDP: they take over where no UDP passes, they are left again,
//! newest-wins topics stay fresh on them, and hostile clients harm nobody.
//!
//! ```text
//!   robot:w0 ──── i0:nat:o0 ──── e0:server:a0 ──── o0:nat:i0 ──── w0:cloud
//!   192.168.5.7     10.9.0.2     10.9.0.1          10.9.1.2       192.168.5.7
//! ```

use std::io::Write as _;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::unstable::{LinkState, LinkStatus, PublishOptions, SubscribeOptions};
use gdp_core::identity::Identity;
use gdp_daemon::config::{Config, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::Name;

use crate::flows::{Flow, Heard, Party, Topic};
use crate::inside::{Inside, ROOT};
use crate::onboarding::BehindNat;
use crate::reach::{forbid, permit};

const UDP: &str = "udp://10.9.0.1:31415";
const TLS: &str = "tls://10.9.0.1:443";
const WSS: &str = "wss://10.9.0.1:443";
const CLOUD: &str = "udp://10.9.1.1:31415";

const NO_UDP: &str = "meta l4proto udp drop";

/// Interval between two messages, and their bytes.
const PERIOD: Duration = Duration::from_millis(20);
const SIZE: usize = 2000;

#[test]
fn a_link_moves_to_udp_when_it_opens_and_back_and_nothing_reliable_is_lost() -> Result<()> {
    let site = Site::build()?;
    forbid(&site.robot.nat, NO_UDP)?;
    let robot = site.party(&site.robot.inside, &[UDP, TLS, WSS])?;
    robot.wait_for_links(|links| is_main(links, 1) && is_down(links, 2))?;
    let cloud = site.party(&site.cloud.inside, &[CLOUD])?;
    let reliable = || (PublishOptions::reliable(), SubscribeOptions::reliable());
    let open = |from, to| Topic::open(from, to, &[], reliable().0, reliable().1);
    let flows = [open(&robot, &cloud)?, open(&cloud, &robot)?].map(|topic| Flow::start(topic, SIZE, PERIOD));
    flow_on(&flows)?;

    permit(&site.robot.nat)?;
    robot.wait_for_links(|links| is_main(links, 0) && is_down(links, 1))?;
    flow_on(&flows)?;
    let closed = Instant::now();
    forbid(&site.robot.nat, NO_UDP)?;
    robot.wait_for_links(|links| is_main(links, 1))?;
    // Half a second until the silence is noticed, 2 s without a preferred link, and the handshakes.
    eprintln!("over TLS {:?} after UDP was closed", closed.elapsed());
    flow_on(&flows)?;
    eprintln!("gaps: {:?}", flows.each_ref().map(|flow| flow.gap_since(closed)));
    ensure!(robot.node.links()[2].frames_sent == 0, "the WebSocket was not needed: {:?}", robot.node.links());

    for flow in flows {
        let Heard { messages, counters, sent, slowest } = flow.finish()?;
        let sequences: Vec<u64> = messages.iter().map(|(sequence, _)| *sequence).collect();
        ensure!(sequences.iter().copied().eq(1..=sent), "{} of {sent}: {counters:?}", sequences.len());
        eprintln!("{sent} messages, the slowest took {slowest:?}");
    }
    Ok(())
}

/// A switch in the robot's network, as a relay is.
#[test]
fn a_switch_reaches_another_one_over_tls_until_udp_opens() -> Result<()> {
    let site = Site::build()?;
    forbid(&site.robot.nat, NO_UDP)?;
    let (inside, at) = (Inside::new(&site.robot.inside, ROOT)?, "127.0.0.1:31415");
    let address = NeighbourAddress { switch: site.name()?, via: Via::Udp("10.9.0.1:31415".parse()?) };
    let hub = Neighbour { address, cost: None, dial: true, parent: false, tls: Some(TLS.parse()?) };
    let relay = Config::userspace(site.files.path().join("relay.pem"), "0.0.0.0:31415".parse()?);
    let relay = inside.run(start(Config { neighbours: vec![hub], ..relay }))?.context("the relay")?;
    let (robot, cloud) =
        (site.party(&site.robot.inside, &[&format!("udp://{at}")])?, site.party(&site.cloud.inside, &[CLOUD])?);
    let open = |from, to| Topic::open(from, to, &[], PublishOptions::reliable(), SubscribeOptions::reliable());
    let flows = [open(&robot, &cloud)?, open(&cloud, &robot)?].map(|topic| Flow::start(topic, SIZE, PERIOD));
    flow_on(&flows)?;
    let link_to_hub = |form: &str| {
        let links = inside.runtime.block_on(relay.status())["links"].clone();
        let links = links.as_array().cloned().unwrap_or_default();
        links.iter().any(|link| link["role"] == "switch" && link["via"].as_str().is_some_and(|via| via.contains(form)))
    };
    ensure!(link_to_hub("tls://"));
    permit(&site.robot.nat)?;
    wait_for("a link over UDP", TIMEOUT, || Ok(link_to_hub("udp 10.9.0.1").then_some(())))?;
    flow_on(&flows)?;
    for flow in flows {
        let heard = flow.finish()?;
        ensure!(heard.messages.len() as u64 == heard.sent, "{} of {}", heard.messages.len(), heard.sent);
    }
    drop((robot, cloud));
    inside.runtime.block_on(relay.stop());
    Ok(())
}

#[test]
fn newest_wins_topics_stay_fresh_on_a_slow_link_over_tls() -> Result<()> {
    const SLOW: &str = "qdisc add dev w0 root tbf rate 4mbit burst 16kb limit 64kb";
    const FAST: &str = "qdisc del dev w0 root";
    let site = Site::build()?;
    let cloud = site.party(&site.cloud.inside, &[CLOUD])?;
    let mut slowest = Vec::new();
    // Both forms of tunnel have one queue; messages of a WebSocket took longer.
    for link in [UDP, WSS] {
        let robot = site.party(&site.robot.inside, &[link])?;
        let topic = Topic::open(&robot, &cloud, &[], PublishOptions::best_effort(), SubscribeOptions::best_effort())?;
        execute(site.robot.inside.command(Program::Tc)?.args(SLOW.split(' ')))?;
        // Twice what the link carries.
        let flow = Flow::start(topic, 20_000, PERIOD);
        gdp_tests::wait::sleep(Duration::from_secs(7))?;
        execute(site.robot.inside.command(Program::Tc)?.args(FAST.split(' ')))?;
        gdp_tests::wait::sleep(Duration::from_secs(1))?;
        let heard = flow.finish()?;
        let (count, sent) = (heard.messages.len() as u64, heard.sent);
        eprintln!("{link}: {count} of {sent}, the slowest took {:?}: {:?}", heard.slowest, heard.counters);
        ensure!(count < sent, "{link}: the link was slow");
        ensure!(count > sent / 10, "{link}: {count} of {sent}");
        slowest.push(heard.slowest);
    }
    // Without the bounds, the queue would grow to seconds.
    ensure!(slowest[1..].iter().all(|tls| *tls < slowest[0] + Duration::from_secs(3)), "{slowest:?}");
    Ok(())
}

#[test]
fn hostile_tls_clients_harm_nobody() -> Result<()> {
    let site = Site::build()?;
    let robot = site.party(&site.robot.inside, &[TLS])?;
    let cloud = site.party(&site.cloud.inside, &[CLOUD])?;
    let topic = Topic::open(&robot, &cloud, &[], PublishOptions::reliable(), SubscribeOptions::reliable())?;
    let flows = [Flow::start(topic, SIZE, PERIOD)];
    flow_on(&flows)?;
    let hostile = {
        let _inside = site.cloud.inside.enter()?;
        let mut open = Vec::new();
        for number in 0..2000 {
            let mut stream = TcpStream::connect("10.9.1.1:443")?;
            // Nothing, garbage, or half of a ClientHello. The listener may have closed already.
            let _ = match number % 3 {
                0 => Ok(()),
                1 => stream.write_all(&[0xff; 1000]),
                _ => stream.write_all(&[0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3]),
            };
            open.push(stream);
        }
        open
    };
    flow_on(&flows)?;
    let late = site.party(&site.robot.inside, &[WSS])?;
    late.wait_for_links(|links| links[0].state == LinkState::Up)?;
    drop(hostile);
    let third = site.party(&site.cloud.inside, &["tls://10.9.1.1:443"])?;
    third.wait_for_links(|links| links[0].state == LinkState::Up)?;
    let [flow] = flows;
    let heard = flow.finish()?;
    ensure!(heard.messages.len() as u64 == heard.sent, "{:?}", heard.counters);
    Ok(())
}

fn is_main(links: &[LinkStatus], lane: usize) -> bool {
    links[lane].main && links[lane].state == LinkState::Up
}

fn is_down(links: &[LinkStatus], lane: usize) -> bool {
    links[lane].state == LinkState::Down
}

fn flow_on(flows: &[Flow]) -> Result<()> {
    flows.iter().try_for_each(|flow| {
        let so_far = flow.heard();
        wait_for("messages", TIMEOUT, || Ok((flow.heard() >= so_far + 100).then_some(())))
    })
}

struct Site {
    // Fields drop in this order.
    running: Option<(Running, Inside)>,
    _server: Namespace,
    robot: BehindNat,
    cloud: BehindNat,
    files: tempfile::TempDir,
}

impl Site {
    fn build() -> Result<Self> {
        let (server, files) = (Namespace::create("server")?, tempfile::tempdir()?);
        let robot = BehindNat::new("robot", &server, "e0", 0)?;
        let cloud = BehindNat::new("cloud", &server, "a0", 1)?;
        let inside = Inside::new(&server, ROOT)?;
        let any = Config::userspace(files.path().join("switch.pem"), "0.0.0.0:31415".parse()?);
        let relay = Identity::load_or_generate(&files.path().join("relay.pem"), "switch")?.name();
        let address = NeighbourAddress { switch: relay, via: Via::Udp("10.9.0.2:31415".parse()?) };
        let relay = Neighbour { address, cost: None, dial: false, parent: false, tls: None };
        let config = Config { rib: true, neighbours: vec![relay], tls: Some("[::]:443".parse()?), ..any };
        let running = inside.run(start(config))?.context("the switch")?;
        Ok(Self { running: Some((running, inside)), _server: server, robot, cloud, files })
    }

    /// Returns the name of the switch.
    fn name(&self) -> Result<Name> {
        Ok(self.running.as_ref().context("the switch")?.0.name())
    }

    fn party(&self, at: &Namespace, links: &[&str]) -> Result<Party> {
        Party::connect(at, Identity::generate("proxy")?, links, None)
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        if let Some((running, inside)) = self.running.take() {
            inside.runtime.block_on(running.stop());
        }
    }
}
