//! The first image of a subscriber that starts while a camera publishes. Both ends are behind NAT.
//!
//! ```text
//!   camera, robot r0 ── w0 nat u0 ── a0 s1 a1 ── u0 nat w0 ── r0 cloud, subscribers
//! ```
//!
//! With `GDP_LATE_STARTS=20` the test makes as many starts, and each has to keep the bar.

use std::fs;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, Switch, TOPIC, TYPE};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::peers::{Traffic, Vendor, listener, talker};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::json;

/// Starts of a subscriber; `GDP_LATE_STARTS` overrides this, and adds [`BAR`].
const STARTS: usize = 4;

/// The longest time from a start to the first image.
const BAR: Duration = Duration::from_secs(2);

/// An image of VGA size, uncompressed.
const IMAGE: usize = 900_000;

const RATE: f64 = 15.0;

/// Every second time the proxy at the subscriber's end starts with it: its host was just turned on.
#[test]
fn the_first_image_of_a_late_subscriber_comes_soon() -> Result<()> {
    let wanted = std::env::var("GDP_LATE_STARTS").ok().and_then(|text| text.parse().ok());
    let mut site = Site::build()?;
    let traffic = Traffic { size: IMAGE, rate: RATE, ..Default::default() };
    let _camera = talker(&site.tools, &site.robot, Vendor::FastDds, &traffic, site.files.path())?;
    let mut slow = Vec::new();
    for start in 0..wanted.unwrap_or(STARTS) {
        let vendor = if start % 4 < 2 { Vendor::FastDds } else { Vendor::Cyclone };
        let with_proxy = start % 2 == 1;
        if with_proxy {
            let mut before = site.proxies.pop().context("the cloud's proxy")?;
            ensure!(before.stop(TIMEOUT)?.success(), "{}", before.report());
            site.proxies.push(site.proxy("cloud")?);
        }
        let mut subscriber = listener(&site.tools, &site.cloud, vendor, &traffic, site.files.path())?;
        subscriber.wait_event("ready", TIMEOUT)?;
        let since = Instant::now();
        let image = subscriber.wait_event("message", TIMEOUT).with_context(|| site.report())?;
        let took = since.elapsed();
        println!("start {start}: {vendor:?}, with its proxy: {with_proxy}, {took:?} to image {}", image["seq"]);
        ensure!(image["intact"] == true && image["bytes"] == IMAGE, "changed: {image}");
        if wanted.is_some() && took > BAR {
            slow.push((start, took));
        }
    }
    ensure!(slow.is_empty(), "longer than {BAR:?}: {slow:?}\n{}", site.report());
    Ok(())
}

/// A running site. Dropping it ends the programs, then deletes the namespaces and files.
struct Site {
    /// The robot's, then the cloud's.
    proxies: Vec<Process>,
    _switch: Switch,
    robot: Namespace,
    cloud: Namespace,
    _routers: [Namespace; 2],
    _middle: Namespace,
    tools: Tools,
    files: tempfile::TempDir,
}

impl Site {
    fn build() -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let middle = Namespace::create("switch")?;
        let [robot, cloud] = [Namespace::create("robot")?, Namespace::create("cloud")?];
        let routers = [Namespace::create("nat-r")?, Namespace::create("nat-c")?];
        for (i, (router, host)) in routers.iter().zip([&robot, &cloud]).enumerate() {
            let end = |namespace, interface, side| End { namespace, interface, mac: [2, 0, 0, 6, i as u8, side] };
            veth(&end(host, "r0", 0), &end(router, "w0", 1), 1500)?;
            veth(&end(router, "u0", 2), &end(&middle, &format!("a{i}"), 3), 1500)?;
            host.ip(&["addr", "add", "192.168.1.7/24", "dev", "r0"])?;
            router.ip(&["addr", "add", "192.168.1.1/24", "dev", "w0"])?;
            router.ip(&["addr", "add", &format!("10.80.{i}.1/24"), "dev", "u0"])?;
            middle.ip(&["addr", "add", &format!("10.80.{i}.2/24"), "dev", &format!("a{i}")])?;
            host.ip(&["route", "add", "default", "via", "192.168.1.1"])?;
            router.masquerade("w0")?;
            host.enable_loopback_multicast()?;
        }
        let files = tempfile::Builder::new().prefix("gdp-late-").tempdir()?;
        let authority = Authority { tools: &tools, folder: files.path() };
        let name = authority.switch("s1")?;
        let config = json!({"interfaces": [], "udp": "0.0.0.0:31415", "data_plane": "userspace", "rib": true});
        let switch = Switch::start(&tools, &middle, files.path(), ("s1", &name), config)?;
        wait_for("the switch", TIMEOUT, || Ok(switch.ctl(&tools, &["status"]).ok()))?;
        authority.topic()?;
        for (i, (label, direction, key, right)) in
            [("robot", "out", "cert", "--publish"), ("cloud", "in", "grant", "--read")].into_iter().enumerate()
        {
            let entity = authority.proxy(label)?;
            authority.grant(label, &entity, &[right])?;
            let config = json!({
                "version": 1, "identity": "key.pem", "links": [{"to": format!("udp://10.80.{i}.2")}],
                "graphs": {"ros2": {"domain_id": 0}},
                "topics": [{
                    "topic": TOPIC, "type": TYPE, "direction": direction,
                    "card": "chatter.card", (key): "chatter.cert",
                }],
            });
            // JSON is YAML.
            fs::write(files.path().join(label).join("proxy.yaml"), config.to_string())?;
        }
        let (_switch, _routers, _middle) = (switch, routers, middle);
        let mut site = Self { proxies: Vec::new(), _switch, robot, cloud, _routers, _middle, tools, files };
        for label in ["robot", "cloud"] {
            let proxy = site.proxy(label)?;
            site.proxies.push(proxy);
        }
        Ok(site)
    }

    fn proxy(&self, label: &str) -> Result<Process> {
        let at = if label == "robot" { &self.robot } else { &self.cloud };
        let mut command = at.command(self.tools.gdp_proxy()?)?;
        command.arg("--config").arg(self.files.path().join(label).join("proxy.yaml"));
        Process::spawn(&format!("{label}-proxy"), command, self.files.path())
    }

    fn report(&self) -> String {
        self.proxies.iter().map(Process::report).collect::<Vec<_>>().join("\n")
    }
}
