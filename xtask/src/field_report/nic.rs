//! The machine and the interface that figures are of.

use std::fmt;
use std::net::Ipv4Addr;

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::netns::Namespace;
use gdp_tests::programs::Program;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A machine and one of its interfaces, as the report shows them.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineFacts {
    kernel: String,
    processor: String,
    cores: usize,
    interface: String,
    driver: String,
    /// As `ethtool` writes it, such as `10000Mb/s`.
    speed: String,
    mtu: u32,
}

/// Drivers of interfaces without hardware.
const VIRTUAL: [&str; 7] = ["veth", "virtio_net", "tun", "bridge", "vmxnet3", "hv_netvsc", "xen_netfront"];

const UNKNOWN: &str = "unknown";

impl MachineFacts {
    pub fn of(at: &Namespace, nic: &Nic) -> Result<Self> {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let cpu = read("/proc/cpuinfo");
        // Kernels for ARM name the board, or only numbers of the core.
        let model = ["model name", "Model", "Hardware"].iter().find_map(|key| field(&cpu, key));
        let arguments: [&[&str]; 2] = [&["-i", &nic.name], &[&nic.name]];
        let [driver, settings] = arguments.map(|arguments| ethtool(at, arguments).unwrap_or_default());
        let driver = field(&driver, "driver").or(nic.kind.as_deref()).unwrap_or(UNKNOWN);
        let speed = field(&settings, "Speed").filter(|speed| speed.starts_with(|c: char| c.is_ascii_digit()));
        let facts = Self {
            kernel: read("/proc/sys/kernel/osrelease"),
            processor: model.map_or_else(|| std::env::consts::ARCH.to_owned(), str::to_owned),
            cores: std::thread::available_parallelism().context("cannot count the processors")?.get(),
            interface: nic.name.clone(),
            driver: driver.to_owned(),
            speed: speed.unwrap_or(UNKNOWN).to_owned(),
            mtu: nic.mtu,
        };
        Ok(facts.clean())
    }

    /// Returns the same facts without what does not belong on a line of a table. They may come from
    /// another machine.
    pub fn clean(self) -> Self {
        let Self { kernel, processor, cores, interface, driver, speed, mtu } = self;
        let [kernel, processor, interface, driver, speed] =
            [kernel, processor, interface, driver, speed].map(|text| clean(&text, 80));
        Self { kernel, processor, cores, interface, driver, speed, mtu }
    }

    /// Returns the driver, if it has no hardware.
    pub fn virtual_driver(&self) -> Option<&str> {
        VIRTUAL.contains(&self.driver.as_str()).then_some(&self.driver)
    }
}

impl fmt::Display for MachineFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kernel, processor, cores, interface, driver, speed, mtu } = self;
        write!(f, "Linux {kernel}, {processor}, {cores} cores; {interface}: driver {driver}, {speed}, MTU {mtu}")
    }
}

/// An interface of this machine that is up.
pub struct Nic {
    pub name: String,
    mtu: u32,
    /// `veth`, `bridge` and the like. None for hardware.
    kind: Option<String>,
    addresses: Vec<String>,
}

impl Nic {
    /// Looks up an interface by its name.
    pub fn find(at: &Namespace, name: &str) -> Result<Self> {
        let all: Vec<Value> = parse(&at.ip(&["-j", "-d", "addr", "show"])?)?;
        let Some(it) = all.iter().find(|it| it["ifname"] == name) else {
            let names: Vec<&str> = all.iter().filter_map(|it| it["ifname"].as_str()).collect();
            bail!("this machine has no interface `{name}`: choose one of {}", names.join(", "));
        };
        let is_up = it["flags"].as_array().is_some_and(|flags| flags.iter().any(|flag| flag == "UP"));
        ensure!(is_up, "the interface `{name}` is down: run `ip link set {name} up`");
        let of_four = it["addr_info"].as_array().into_iter().flatten().filter(|address| address["family"] == "inet");
        Ok(Self {
            name: name.to_owned(),
            mtu: it["mtu"].as_u64().and_then(|mtu| mtu.try_into().ok()).context("`ip` shows no MTU")?,
            kind: it["linkinfo"]["info_kind"].as_str().map(str::to_owned),
            addresses: of_four.filter_map(|address| Some(address["local"].as_str()?.to_owned())).collect(),
        })
    }

    /// Looks up the interface by which this machine reaches an address.
    pub fn towards(at: &Namespace, to: Ipv4Addr) -> Result<Self> {
        let routes = at.ip(&["-j", "route", "get", &to.to_string()]);
        let routes = routes.with_context(|| format!("this machine has no route to {to}: pass the edge's address"))?;
        let routes: Vec<Value> = parse(&routes)?;
        let route = routes.first().with_context(|| format!("this machine has no route to {to}"))?;
        ensure!(
            route["type"] != "local",
            "{to} is an address of this machine: run `field-report measure` on another, or `field-report try`"
        );
        Self::find(at, route["dev"].as_str().with_context(|| format!("the route to {to} has no interface"))?)
    }

    pub fn check_address(&self, address: Ipv4Addr) -> Result<()> {
        let Self { name, addresses, .. } = self;
        let has = if addresses.is_empty() { "no IPv4 address".to_owned() } else { addresses.join(", ") };
        ensure!(
            addresses.contains(&address.to_string()),
            "{address} is not on `{name}`, which has {has}: pass an address of `{name}`, or add it with `ip address add`"
        );
        Ok(())
    }
}

/// Returns the text with at most `most` characters, and each that is not printable ASCII replaced.
pub fn clean(text: &str, most: usize) -> String {
    let printable = |c: char| if (c.is_ascii_graphic() && c != '|') || c == ' ' { c } else { '?' };
    text.trim().chars().take(most).map(printable).collect()
}

fn ethtool(at: &Namespace, arguments: &[&str]) -> Option<String> {
    // An unprivileged user's PATH omits its folder.
    let mut command = at.command(Program::Ethtool.find()?).ok()?;
    // It fails without root after it has printed what is of interest here.
    let output = command.args(arguments).output().ok()?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Returns the value of a line `KEY: VALUE`.
fn field<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let values = text.lines().filter_map(|line| line.split_once(':'));
    let mut values = values.filter(|(name, _)| name.trim() == key).map(|(_, value)| value.trim());
    values.find(|value| !value.is_empty())
}

fn parse(json: &str) -> Result<Vec<Value>> {
    serde_json::from_str(json).context("`ip -j` printed something other than JSON")
}
