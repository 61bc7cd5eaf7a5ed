//! The paper's Figure 4: two trust domains below a third, a robot that roams between the two, and a
//! cloud. Robot and cloud are always behind NAT.
//!
//! ```text
//!                           ╔═ tier 1 ═══════╗
//!                           ║   b3  (RIB)    ║
//!                           ╚═╪════════════╪═╝
//!      ╔═ enterprise ═════════╪═╗        ╔═╪═ university ═════════════╗
//!      ║  (RIB) b1 ── t0      t0║        ║ t0   b2 (RIB) e0 ──────────╫── nat-c ── c0 cloud
//!      ║        d0              ║        ║    d1    d2                ║
//!      ║        u0              ║        ║    u0    u0                ║
//!      ║        a1              ║        ║    u1    u2                ║
//!      ║        e0              ║        ║    e0    e0                ║
//!      ╚════════╪═══════════════╝        ╚════╪═════╪═════════════════╝
//!            nat-a                           nat-u
//!               └┄┄┄┄┄┄┄ wlan0 robot ┄┄┄┄┄┄┄┄┄┄┘
//! ```
//!
//! Switches have Ethernet cables and XDP; hosts behind NAT dial out over UDP. The robot is a member
//! of the enterprise's domain and may visit the university's. The cloud is a member of the latter.
//! The third domain lets both cross it.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::fabric::{Authority, Switch, TOPIC, TYPE};
use crate::netns::{End, Namespace, veth};
use crate::packet::PacketSocket;
use crate::process::Process;
use crate::tools::Tools;
use crate::topics::{BothEnds, FabricTopic, ProxyPlan, ros2};
use crate::wait::{TIMEOUT, wait_for};

/// The switches that the robot may attach to, in its order: the enterprise's, then the university's
/// two.
pub const ROBOT_LINKS: [&str; 3] = ["udp://10.1.0.2:31415", "udp://10.2.1.2:31415", "udp://10.2.2.2:31415"];

/// The switch that the cloud attaches to.
pub const CLOUD_LINK: &str = "udp://10.3.0.2:31415";

/// FIB capacity of each switch, in names.
const FIB_CAPACITY: u32 = 1 << 12;

/// A network that the robot can be in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Site {
    Enterprise,
    University,
}

impl Site {
    /// Returns the addresses of the robot and of the NAT router in this network.
    fn addresses(self) -> (&'static str, &'static str) {
        match self {
            Self::Enterprise => ("192.168.1.7", "192.168.1.1"),
            Self::University => ("192.168.77.20", "192.168.77.1"),
        }
    }
}

/// A trust domain: its folder and its name.
struct Domain {
    folder: &'static str,
    name: String,
}

/// The names of the three domains, 64 hex digits each.
#[derive(Clone, Debug)]
pub struct Domains {
    pub enterprise: String,
    pub university: String,
    pub top: String,
}

/// A running federation. Dropping it ends the programs, then deletes the namespaces and files.
pub struct Federation {
    // Fields drop in this order: proxies, daemons, network, files.
    pub robot_proxy: Option<Process>,
    pub cloud_proxy: Option<Process>,
    /// The topic that the proxies exchange, once there is one.
    pub name: Option<String>,
    switches: Vec<(&'static str, Switch)>,
    pub robot: Namespace,
    pub cloud: Namespace,
    /// The NAT routers of the enterprise, the university and the cloud.
    nats: [Namespace; 3],
    at: Site,
    nodes: Vec<(&'static str, Namespace)>,
    pub domains: Domains,
    pub tools: Tools,
    files: tempfile::TempDir,
}

/// A switch: its domain's number, its role, and its cables (interface, switch at the other end).
/// With links over UDP it has an address. A border's first cable leads to the domain above.
struct Plan {
    label: &'static str,
    domain: usize,
    role: &'static str,
    cables: &'static [(&'static str, &'static str)],
    address: Option<&'static str>,
}

const ENTERPRISE: usize = 0;
const UNIVERSITY: usize = 1;
const TOP: usize = 2;

const PLANS: [Plan; 6] = [
    Plan { label: "b3", domain: TOP, role: "border", cables: &[("l0", "b1"), ("r0", "b2")], address: None },
    Plan { label: "b1", domain: ENTERPRISE, role: "border", cables: &[("t0", "b3"), ("d0", "a1")], address: None },
    Plan { label: "a1", domain: ENTERPRISE, role: "switch", cables: &[("u0", "b1")], address: Some("10.1.0.2") },
    Plan {
        label: "b2",
        domain: UNIVERSITY,
        role: "border",
        cables: &[("t0", "b3"), ("d1", "u1"), ("d2", "u2")],
        address: Some("10.3.0.2"),
    },
    Plan { label: "u1", domain: UNIVERSITY, role: "switch", cables: &[("u0", "b2")], address: Some("10.2.1.2") },
    Plan { label: "u2", domain: UNIVERSITY, role: "switch", cables: &[("u0", "b2")], address: Some("10.2.2.2") },
];

/// The interface of a switch that has the address for UDP links.
const ACCESS: &str = "e0";

impl Federation {
    /// Starts networks, keys, certificates and daemons. Each lower RIB has a session with the RIB
    /// above. The robot starts at the enterprise.
    pub fn start(tools: Tools) -> Result<Self> {
        let nodes = PLANS.iter().map(|plan| Ok((plan.label, Namespace::create(plan.label)?)));
        let nodes = nodes.collect::<Result<Vec<_>>>()?;
        let [robot, cloud] = ["robot", "cloud"].map(Namespace::create);
        let nats = ["nat-a", "nat-u", "nat-c"].map(Namespace::create);
        let [nat_a, nat_u, nat_c] = nats;
        let (robot, cloud, nats) = (robot?, cloud?, [nat_a?, nat_u?, nat_c?]);
        let files = tempfile::Builder::new().prefix("gdp-federation-").tempdir().context("cannot create a folder")?;
        let domains = Domains { enterprise: String::new(), university: String::new(), top: String::new() };
        let mut this = Self {
            robot_proxy: None,
            cloud_proxy: None,
            name: None,
            switches: Vec::new(),
            robot,
            cloud,
            nats,
            at: Site::Enterprise,
            nodes,
            domains,
            tools,
            files,
        };
        this.connect()?;
        this.serve()?;
        let top = this.domains.top.clone();
        for border in ["b1", "b2"] {
            this.wait(&format!("the RIB at {border} to know the one above"), |it| {
                let tiers = it.ctl(border, &["status"])?["tiers"].clone();
                Ok(tiers.as_array().into_iter().flatten().any(|tier| tier["domain"] == *top && tier["state"] == "up"))
            })?;
        }
        for (label, rib) in [("a1", "b1"), ("u1", "b2"), ("u2", "b2")] {
            let rib = this.switch(rib)?.name.clone();
            this.wait(&format!("{label} to reach its RIB"), |it| {
                let control = it.ctl(label, &["status"])?["control"].clone();
                Ok(control["ready"] == true && control["next"] == *rib)
            })?;
        }
        Ok(this)
    }

    /// Connects all cables and sets up NAT.
    fn connect(&self) -> Result<()> {
        let mut number = 0;
        let mut lay = |a: (&Namespace, &str), b: (&Namespace, &str)| {
            number += 1;
            let end = |(namespace, interface), side| End { namespace, interface, mac: [2, 0, 0, 0, number, side] };
            veth(&end(a, 1), &end(b, 2), 1500)
        };
        for plan in &PLANS {
            for (interface, other) in plan.cables {
                let above = PLANS.iter().find(|above| above.label == *other).context("a switch of that label")?;
                // Each cable is listed at both ends.
                if let Some((far, _)) = above.cables.iter().find(|(_, near)| *near == plan.label)
                    && plan.label < *other
                {
                    lay((self.node(plan.label)?, interface), (self.node(other)?, far))?;
                }
            }
            if let Some(address) = plan.address {
                let (nat, outside) = match plan.label {
                    "a1" => (&self.nats[0], "l1"),
                    "u1" => (&self.nats[1], "l1"),
                    "u2" => (&self.nats[1], "l2"),
                    _ => (&self.nats[2], "l1"),
                };
                let at = self.node(plan.label)?;
                lay((nat, outside), (at, ACCESS))?;
                at.ip(&["addr", "add", &format!("{address}/24"), "dev", ACCESS])?;
                let router = address.strip_suffix('2').with_context(|| format!("no router beside {address}"))?;
                nat.ip(&["addr", "add", &format!("{router}1/24"), "dev", outside])?;
            }
        }
        lay((&self.nats[0], INSIDE), (&self.robot, WLAN))?;
        lay((&self.nats[2], INSIDE), (&self.cloud, "c0"))?;
        self.nats.iter().try_for_each(|nat| nat.masquerade(INSIDE))?;
        self.nats[2].ip(&["addr", "add", "192.168.3.1/24", "dev", INSIDE])?;
        self.cloud.ip(&["addr", "add", "192.168.3.8/24", "dev", "c0"])?;
        self.cloud.ip(&["route", "add", "default", "via", "192.168.3.1"])?;
        self.associate(Site::Enterprise)
    }

    /// Assigns the robot its address and default route, and the router its own address.
    fn associate(&self, with: Site) -> Result<()> {
        let (own, router) = with.addresses();
        let nat = self.nat_of(with);
        nat.ip(&["addr", "add", &format!("{router}/24"), "dev", INSIDE])?;
        nat.ip(&["link", "set", INSIDE, "up"])?;
        self.robot.ip(&["addr", "flush", "dev", WLAN])?;
        self.robot.ip(&["addr", "add", &format!("{own}/24"), "dev", WLAN])?;
        self.robot.ip(&["route", "replace", "default", "via", router, "dev", WLAN])?;
        Ok(())
    }

    /// Moves the robot to the other network, as Wi-Fi does. Its interface loses the carrier and
    /// regains it there, with another address and another router.
    pub fn roam(&mut self, to: Site) -> Result<()> {
        let (from, into) = (self.nat_of(self.at), self.nat_of(to));
        from.ip(&["link", "set", INSIDE, "netns", into.name()])?;
        self.associate(to)?;
        self.at = to;
        Ok(())
    }

    /// Returns the network that the robot is in.
    pub fn site(&self) -> Site {
        self.at
    }

    fn nat_of(&self, site: Site) -> &Namespace {
        &self.nats[usize::from(site == Site::University)]
    }

    /// Creates keys and certificates, then starts a daemon on each switch.
    fn serve(&mut self) -> Result<()> {
        let folder = self.files.path().to_owned();
        let authority = Authority { tools: &self.tools, folder: &folder };
        let domain = |folder| Ok::<_, anyhow::Error>(Domain { folder, name: authority.domain(folder)? });
        let domains = [domain("enterprise")?, domain("university")?, domain("top")?];
        let [enterprise, university, top] = &domains;
        for (of, other, rights, file) in [
            (enterprise, top, "peering", "enterprise-top.peer"),
            (university, top, "peering", "university-top.peer"),
            (top, enterprise, "peering,transit", "top-enterprise.peer"),
            (top, university, "peering,transit", "top-university.peer"),
            // The university admits the enterprise's robots, and the enterprise lets them visit.
            (university, enterprise, "visit", "university-enterprise.peer"),
            (enterprise, university, "visit", "enterprise-university.peer"),
        ] {
            authority.peer(of.folder, &other.name, rights, file)?;
        }
        let mut names = Vec::new();
        for plan in &PLANS {
            let name = authority.switch(plan.label)?;
            authority.member(domains[plan.domain].folder, &name, plan.role, &format!("{}.member", plan.label))?;
            names.push((plan.label, name));
        }
        for plan in &PLANS {
            let name = names.iter().find(|(label, _)| *label == plan.label).map(|(_, name)| name.as_str());
            let config = config(plan, &names, &folder);
            let at = self.node(plan.label)?;
            let who = (plan.label, name.context("its name")?);
            let switch = Switch::start(&self.tools, at, &folder, who, config)?;
            self.switches.push((plan.label, switch));
        }
        let [enterprise, university, top] = domains.map(|domain| domain.name);
        self.domains = Domains { enterprise, university, top };
        Ok(())
    }

    /// Creates an entity's key and makes it a member: `robot` of the enterprise, others of the
    /// university. Its folder has `key.pem`, `domain.card`, `membership`, and for the robot
    /// `visit.peer`. Returns its name.
    pub fn admit(&self, label: &str) -> Result<String> {
        let folder = self.folder_of(label);
        let authority = Authority { tools: &self.tools, folder: self.files.path() };
        let name = authority.proxy(label)?;
        let of = if label == "robot" { "enterprise" } else { "university" };
        authority.member(of, &name, "robot", &format!("{label}/membership"))?;
        let copy = |from: &str, to: &str| {
            fs::copy(self.files.path().join(from), folder.join(to)).with_context(|| format!("cannot copy {from}"))
        };
        copy(&format!("{of}/domain.card"), "domain.card")?;
        if label == "robot" {
            copy("enterprise-university.peer", "visit.peer")?;
        }
        Ok(name)
    }

    /// Starts a proxy for the robot and one for the cloud. The topic's scope is both domains. Waits
    /// until the switches on the path have its name.
    pub fn start_proxies(&mut self) -> Result<()> {
        for end in [&self.robot, &self.cloud] {
            end.enable_loopback_multicast()?;
        }
        let authority = Authority { tools: &self.tools, folder: self.files.path() };
        let name = authority.topic()?;
        let Domains { enterprise, university, .. } = &self.domains;
        let publish = ["--publish", "--scope", enterprise, "--scope", university];
        authority.grant("robot", &self.admit("robot")?, &publish)?;
        authority.grant("cloud", &self.admit("cloud")?, &["--read"])?;
        let entry = |direction, right: &str| {
            json!({
                "topic": TOPIC, "type": TYPE, "direction": direction, "card": "chatter.card", (right): "chatter.cert",
                "qos": {"reliability": "reliable", "durability": "volatile", "depth": 100},
            })
        };
        self.cloud_proxy = Some(self.start_cloud(vec![entry("in", "grant")], ros2())?);
        self.robot_proxy = Some(self.start_robot(vec![entry("out", "cert")])?);
        for switch in ["a1", "b2"] {
            self.wait(&format!("{switch} to hold {name}"), |it| {
                Ok(it.ctl(switch, &["fib", "dump"])?.to_string().contains(&name))
            })?;
        }
        self.name = Some(name);
        Ok(())
    }

    /// Starts both proxies with these topics instead of [`TOPIC`].
    pub fn start_proxies_of(&mut self, topics: &[FabricTopic]) -> Result<()> {
        for end in [&self.robot, &self.cloud] {
            end.enable_loopback_multicast()?;
        }
        let authority = Authority { tools: &self.tools, folder: self.files.path() };
        authority.owner()?;
        ["robot", "cloud"].into_iter().try_for_each(|label| self.admit(label).map(drop))?;
        let BothEnds { robot, cloud, cloud_graphs } =
            authority.topics(topics, &[&self.domains.enterprise, &self.domains.university])?;
        self.cloud_proxy = Some(self.start_cloud(cloud, cloud_graphs)?);
        self.robot_proxy = Some(self.start_robot(robot)?);
        Ok(())
    }

    fn start_robot(&self, topics: Vec<Value>) -> Result<Process> {
        let plan = ProxyPlan { links: ROBOT_LINKS.to_vec(), graphs: ros2(), topics, peers: Some(&["visit.peer"]) };
        plan.start(&self.tools, &self.robot, self.files.path(), "robot")
    }

    fn start_cloud(&self, topics: Vec<Value>, graphs: Value) -> Result<Process> {
        let plan = ProxyPlan { links: vec![CLOUD_LINK], graphs, topics, peers: Some(&[]) };
        plan.start(&self.tools, &self.cloud, self.files.path(), "cloud")
    }

    /// Captures all frames of the robot, on the inside of its NAT.
    pub fn on_the_air(&self) -> Result<PacketSocket> {
        PacketSocket::open(self.nat_of(self.at), INSIDE)
    }

    /// Returns the robot's own address in its present network.
    pub fn robot_address(&self) -> &'static str {
        self.at.addresses().0
    }

    /// Returns the folder of the logs.
    pub fn folder(&self) -> &Path {
        self.files.path()
    }

    /// Runs a `gdp-ctl` command against the daemon of a switch and returns its JSON.
    pub fn ctl(&self, label: &str, arguments: &[&str]) -> Result<Value> {
        self.switch(label)?.ctl(&self.tools, arguments)
    }

    pub fn switch(&self, label: &str) -> Result<&Switch> {
        let found = self.switches.iter().find(|(of, _)| *of == label);
        Ok(&found.with_context(|| format!("no switch {label}"))?.1)
    }

    /// Returns the label of the switch with this name.
    pub fn label_of(&self, name: &str) -> Option<&'static str> {
        self.switches.iter().find(|(_, switch)| switch.name == name).map(|(label, _)| *label)
    }

    /// Kills a switch's daemon, and its data plane with it.
    pub fn kill(&mut self, label: &str) -> Result<()> {
        let found = self.switches.iter_mut().find(|(of, _)| *of == label);
        found.with_context(|| format!("no switch {label}"))?.1.process.kill()?;
        Ok(())
    }

    /// Starts another daemon for a switch whose daemon has ended.
    pub fn start_again(&mut self, label: &str) -> Result<()> {
        let plan = PLANS.iter().find(|plan| plan.label == label).with_context(|| format!("no switch {label}"))?;
        let names: Vec<_> = self.switches.iter().map(|(label, switch)| (*label, switch.name.clone())).collect();
        let (folder, name) = (self.files.path(), self.switch(label)?.name.clone());
        let who = (plan.label, name.as_str());
        let started = Switch::start(&self.tools, self.node(label)?, folder, who, config(plan, &names, folder))?;
        let place = self.switches.iter_mut().find(|(of, _)| *of == label);
        place.with_context(|| format!("no switch {label}"))?.1 = started;
        Ok(())
    }

    /// Waits until a condition holds. An error, for example of a daemon that does not answer yet,
    /// counts as no.
    pub fn wait(&self, what: &str, condition: impl Fn(&Self) -> Result<bool>) -> Result<()> {
        wait_for(what, TIMEOUT, || Ok(condition(self).unwrap_or(false).then_some(()))).with_context(|| self.report())
    }

    /// Returns the folder of `robot` or `cloud`.
    pub fn folder_of(&self, party: &str) -> PathBuf {
        self.files.path().join(party)
    }

    /// Returns the end of every daemon's output, for a failure message.
    pub fn report(&self) -> String {
        let switches = self.switches.iter().map(|(_, switch)| &switch.process);
        switches.chain(&self.robot_proxy).chain(&self.cloud_proxy).map(Process::report).collect::<Vec<_>>().join("\n")
    }

    fn node(&self, label: &str) -> Result<&Namespace> {
        let found = self.nodes.iter().find(|(of, _)| *of == label);
        Ok(&found.with_context(|| format!("no switch {label}"))?.1)
    }
}

/// The robot's interface, and a router's interface on its private side.
const WLAN: &str = "wlan0";
const INSIDE: &str = "w0";

fn config(plan: &Plan, names: &[(&str, String)], folder: &Path) -> Value {
    let is_border = plan.role == "border";
    let name_of = |label: &str| names.iter().find(|(of, _)| *of == label).map(|(_, name)| name.clone());
    let neighbours: Vec<Value> = plan
        .cables
        .iter()
        .enumerate()
        .map(|(i, (interface, other))| {
            let parent = is_border && plan.domain != TOP && i == 0;
            json!({"interface": interface, "switch": name_of(other), "parent": parent})
        })
        .collect();
    let interfaces = plan.cables.iter().map(|(interface, _)| *interface).chain(plan.address.map(|_| ACCESS));
    let domain = ["enterprise", "university", "top"][plan.domain];
    let peers: Vec<String> = match (plan.domain, is_border) {
        (TOP, _) => vec!["top-enterprise.peer".into(), "top-university.peer".into()],
        (_, true) => vec![format!("{domain}-top.peer")],
        (_, false) => Vec::new(),
    };
    let visitors = (plan.domain == UNIVERSITY).then(|| "university-enterprise.peer".to_owned());
    let peers: Vec<PathBuf> = peers.into_iter().chain(visitors).map(|file| folder.join(file)).collect();
    json!({
        "interfaces": interfaces.collect::<Vec<_>>(),
        "udp": plan.address.map(|address| format!("{address}:31415")),
        "data_plane": "xdp",
        "bpffs": null,
        "fib_capacity": FIB_CAPACITY,
        "rib": is_border,
        "neighbours": neighbours,
        "domain": {
            "card": folder.join(domain).join("domain.card"),
            "membership": folder.join(format!("{}.member", plan.label)),
            "peers": peers,
            "members_only": true,
        },
    })
}

impl Authority<'_> {
    /// Creates a trust domain in a folder and returns its name.
    fn domain(&self, folder: &str) -> Result<String> {
        let made = self.ctl("", &["domain", "init", "-o", folder])?;
        Ok(made["name"].as_str().with_context(|| format!("no name in {made}"))?.to_owned())
    }

    /// Writes the peering certificate that gives another domain these rights in a domain.
    fn peer(&self, folder: &str, other: &str, rights: &str, file: &str) -> Result<()> {
        let key = format!("{folder}/domain.pem");
        self.ctl("", &["domain", "peer", "--key", &key, other, "--rights", rights, "-o", file]).map(drop)
    }

    fn member(&self, folder: &str, entity: &str, role: &str, file: &str) -> Result<()> {
        let key = format!("{folder}/domain.pem");
        self.ctl("", &["domain", "admit", "--key", &key, entity, "--role", role, "-o", file]).map(drop)
    }
}
