//! A whole fabric on a [`Chain`]. `gdp-ctl` makes keys, names and certificates, as a user would.
//! Every switch runs a daemon (the last one is the RIB), and each end runs a `gdp-proxy`. The
//! topic's owner, the robot and the cloud each have a folder, as each would have a machine. A party
//! has no file that was not copied into its folder.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::chain::{Chain, ChainOptions, GDP_PORT};
use crate::dpdk;
use crate::netns::{Namespace, execute};
use crate::process::Process;
use crate::programs::{Executable as _, Program, own};
use crate::tools::Tools;
use crate::topics::{self, BothEnds, FabricTopic, ProxyPlan};
use crate::wait::{TIMEOUT, wait_for};

#[derive(Clone, Debug)]
pub struct FabricOptions {
    pub chain: ChainOptions,
    /// Data planes of the switches: `auto`, `xdp`, `userspace`, or a DPDK driver
    /// ([`crate::dpdk::DRIVERS`]). If there are fewer entries than switches, the switches cycle
    /// through the list.
    pub data_planes: &'static [&'static str],
    pub best_effort: bool,
    pub transient_local: bool,
    pub depth: u32,
    /// Number of topics from robot to cloud: [`TOPIC`], and others with a number appended.
    pub topics: u32,
    /// Whether links are over UDP and IPv4. Otherwise frames are on Ethernet.
    pub udp: bool,
    /// Whether kernel state outlives the daemons, pinned in the fabric's own BPF file system.
    pub pinned: bool,
    /// Whether it also outlives daemons that are stopped, as those of the packages are.
    pub kept: bool,
}

impl Default for FabricOptions {
    fn default() -> Self {
        Self {
            chain: ChainOptions::default(),
            data_planes: &["xdp"],
            best_effort: false,
            transient_local: false,
            depth: 10,
            topics: 1,
            udp: false,
            pinned: false,
            kept: false,
        }
    }
}

/// The topic that crosses the fabric.
pub const TOPIC: &str = "/chatter";
pub const TYPE: &str = "std_msgs/msg/String";

/// The owner's folder.
const OWNER: &str = "owner";

/// The mount point of a fabric's BPF file system, in the fabric's folder.
const BPFFS: &str = "bpf";

/// A running fabric. Dropping it ends the programs, then deletes the namespaces and files.
pub struct Fabric {
    // Fields drop in this order: proxies, daemons, network, files.
    pub robot: Option<Process>,
    pub cloud: Option<Process>,
    pub switches: Vec<Switch>,
    pub chain: Chain,
    pub tools: Tools,
    options: FabricOptions,
    _bpffs: Option<Mounted>,
    files: tempfile::TempDir,
    /// The topic's name, 64 hex digits.
    pub name: String,
}

/// The daemon of one switch.
pub struct Switch {
    /// The switch's name, 64 hex digits.
    pub name: String,
    pub process: Process,
    socket: PathBuf,
}

impl Fabric {
    /// Starts network, keys and daemons. All daemons answer and are adjacent; no proxies run yet.
    pub fn start(tools: Tools, options: FabricOptions) -> Result<Self> {
        let chain = Chain::build(options.chain)?;
        for end in [chain.robot(), chain.cloud()] {
            end.enable_loopback_multicast()?;
        }
        if options.udp {
            chain.become_ip_routers()?;
        }
        let files = tempfile::Builder::new().prefix("gdp-fabric-").tempdir().context("cannot create a folder")?;
        let authority = Authority { tools: &tools, folder: files.path() };
        let names = authority.switches(options.chain.switches)?;
        let name = authority.topic()?;
        authority.admit("robot", "--publish")?;
        authority.admit("cloud", "--read")?;
        for i in 1..options.topics {
            authority.further_topic(i)?;
        }
        let bpffs = options.pinned.then(|| Mounted(files.path().join(BPFFS)));
        let switches = names
            .iter()
            .enumerate()
            .map(|(i, name)| start_switch(&tools, &chain, files.path(), &names, i, name, &options))
            .collect::<Result<Vec<_>>>()?;
        let mut fabric = Self { robot: None, cloud: None, switches, chain, tools, options, _bpffs: bpffs, files, name };
        for i in 0..fabric.switches.len() {
            fabric.wait_for_status(i, "its neighbours", |status| links(status) >= neighbours(names.len(), i))?;
        }
        Ok(fabric)
    }

    /// Restarts the daemon of switch `i`, which has ended.
    pub fn start_again(&mut self, i: usize) -> Result<()> {
        let names: Vec<String> = self.switches.iter().map(|switch| switch.name.clone()).collect();
        let folder = self.files.path();
        self.switches[i] = start_switch(&self.tools, &self.chain, folder, &names, i, &names[i], &self.options)?;
        Ok(())
    }

    /// Returns the BPF file system of a pinned fabric. The first daemon mounts it.
    pub fn bpffs(&self) -> PathBuf {
        self.files.path().join(BPFFS)
    }

    /// Runs `gdp-ctl xdp …` on this fabric's BPF file system and returns its JSON. An exit status
    /// other than 0 is an error.
    pub fn xdp(&self, verb: &str) -> Result<Value> {
        let mut command = own(self.tools.gdp_ctl()?);
        parse(&execute(command.args(["xdp", verb, "-j", "--bpffs"]).arg(self.bpffs()))?)
    }

    /// Starts both proxies, and waits until every switch on the path has the name's routes.
    pub fn start_proxies(&mut self) -> Result<()> {
        self.start_cloud()?;
        self.start_robot()?;
        self.wait_for_route()
    }

    /// Starts both proxies with these topics instead of [`TOPIC`].
    pub fn start_proxies_of(&mut self, topics: &[FabricTopic]) -> Result<()> {
        let BothEnds { robot, cloud, .. } =
            Authority { tools: &self.tools, folder: self.files.path() }.topics(topics, &[])?;
        self.cloud = Some(self.start_proxy_of("cloud", self.chain.cloud(), "l0", cloud)?);
        self.robot = Some(self.start_proxy_of("robot", self.chain.robot(), "r0", robot)?);
        Ok(())
    }

    pub fn start_robot(&mut self) -> Result<()> {
        self.robot = Some(self.start_proxy("robot", "out", self.chain.robot(), "r0")?);
        Ok(())
    }

    pub fn start_cloud(&mut self) -> Result<()> {
        self.cloud = Some(self.start_proxy("cloud", "in", self.chain.cloud(), "l0")?);
        Ok(())
    }

    /// Adds a reader of the topic: creates its key, adds the owner's grant, and runs a proxy.
    pub fn admit_reader(&self, label: &str, at: &Namespace, interface: &str) -> Result<Process> {
        Authority { tools: &self.tools, folder: self.files.path() }.admit(label, "--read")?;
        self.start_proxy(label, "in", at, interface)
    }

    /// Runs a `gdp-ctl` command of the topic's owner, in its folder, through the daemon of switch
    /// `i`.
    pub fn owner(&self, i: usize, arguments: &[&str]) -> Result<Value> {
        let mut command = own(self.tools.gdp_ctl()?);
        command.arg("--socket").arg(&self.switches[i].socket).args(arguments).arg("-j");
        parse(&execute(command.current_dir(self.folder_of(OWNER)))?)
    }

    /// Waits until the writer's and the reader's switch have the name in their FIBs.
    pub fn wait_for_route(&mut self) -> Result<()> {
        for i in [0, self.switches.len() - 1] {
            self.wait_for_fib(i, true)?;
        }
        Ok(())
    }

    /// Waits until the FIB of switch `i` contains the topic's name, or no longer contains it.
    pub fn wait_for_fib(&mut self, i: usize, present: bool) -> Result<()> {
        let what = format!("s{} to {} {}", i + 1, if present { "hold" } else { "forget" }, self.name);
        wait_for(&what, TIMEOUT, || {
            self.switches[i].process.check_alive()?;
            Ok((self.holds_name(i)? == present).then_some(()))
        })
        .with_context(|| self.report())
    }

    /// Returns whether the FIB of switch `i` contains the topic's name.
    pub fn holds_name(&self, i: usize) -> Result<bool> {
        Ok(self.ctl(i, &["fib", "dump"])?.to_string().contains(&self.name))
    }

    /// Returns the output of `gdp-ctl status -j` for switch `i`.
    pub fn status(&self, i: usize) -> Result<Value> {
        self.ctl(i, &["status"])
    }

    /// Returns a counter of switch `i`, summed over all planes.
    pub fn counter(&self, i: usize, counter: &str) -> Result<u64> {
        Ok(self.status(i)?["counters"][counter].as_u64().unwrap_or(0))
    }

    /// Returns the number of data frames that switch `i` forwarded without its daemon.
    pub fn forwarded_in_kernel(&self, i: usize) -> Result<u64> {
        let status = self.status(i)?;
        let kernel = |counter| status["counters_by_plane"][counter]["kernel"].as_u64().unwrap_or(0);
        Ok(kernel("forwarded") + kernel("delivered"))
    }

    /// Runs a `gdp-ctl` command against the daemon of switch `i` and returns its JSON.
    pub fn ctl(&self, i: usize, arguments: &[&str]) -> Result<Value> {
        self.switches[i].ctl(&self.tools, arguments)
    }

    /// Returns the latest counters that a proxy has written.
    pub fn proxy_stats(&self, label: &str) -> Value {
        let text = fs::read_to_string(self.folder_of(label).join("stats.json")).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// Returns the folder of the switches' files and all logs.
    pub fn folder(&self) -> &Path {
        self.files.path()
    }

    /// Returns the folder of `owner`, `robot` or `cloud`.
    pub fn folder_of(&self, party: &str) -> PathBuf {
        self.files.path().join(party)
    }

    /// Returns the end of every program's output, for a failure message.
    pub fn report(&self) -> String {
        let switches = self.switches.iter().map(|switch| &switch.process);
        let all = switches.chain(&self.robot).chain(&self.cloud);
        all.map(Process::report).collect::<Vec<_>>().join("\n")
    }

    fn wait_for_status(&mut self, i: usize, what: &str, condition: impl Fn(&Value) -> bool) -> Result<()> {
        wait_for(&format!("s{} to have {what}", i + 1), TIMEOUT, || {
            self.switches[i].process.check_alive()?;
            // The daemon may not listen yet.
            Ok(self.status(i).ok().filter(|status| condition(status)).map(drop))
        })
        .with_context(|| self.report())
    }

    fn start_proxy(&self, label: &str, direction: &str, at: &Namespace, interface: &str) -> Result<Process> {
        let options = &self.options;
        let right = if direction == "in" { "grant" } else { "cert" };
        let topic = |i: u32| {
            let behind = if i == 0 { String::new() } else { i.to_string() };
            json!({
                "topic": format!("{TOPIC}{behind}"), "type": TYPE, "direction": direction,
                "card": format!("chatter{behind}.card"), (right): format!("chatter{behind}.cert"),
                "qos": {
                    "reliability": if options.best_effort { "best_effort" } else { "reliable" },
                    "durability": if options.transient_local { "transient_local" } else { "volatile" },
                    "depth": options.depth,
                },
            })
        };
        self.start_proxy_of(label, at, interface, (0..options.topics).map(topic).collect())
    }

    fn start_proxy_of(&self, label: &str, at: &Namespace, interface: &str, entries: Vec<Value>) -> Result<Process> {
        let link = match (self.options.udp, interface) {
            (false, _) => format!("eth://{interface}"),
            (true, "r0") => format!("udp://{}", self.options.chain.right_of(0)),
            (true, _) => format!("udp://{}", self.options.chain.left_of(self.options.chain.switches + 1)),
        };
        let plan = ProxyPlan { links: vec![&link], graphs: topics::ros2(), topics: entries, peers: None };
        plan.start(&self.tools, at, self.files.path(), label)
    }
}

impl Switch {
    /// Starts a daemon with this configuration. The function sets identity and socket: `LABEL.pem`
    /// and `LABEL.sock` in the folder.
    pub fn start(
        tools: &Tools,
        at: &Namespace,
        folder: &Path,
        (label, name): (&str, &str),
        config: Value,
    ) -> Result<Self> {
        Self::start_with(tools, at, folder, (label, name), config, &[])
    }

    /// [Starts](Self::start) a daemon with these further arguments.
    fn start_with(
        tools: &Tools,
        at: &Namespace,
        folder: &Path,
        (label, name): (&str, &str),
        mut config: Value,
        arguments: &[&str],
    ) -> Result<Self> {
        let socket = folder.join(format!("{label}.sock"));
        config["identity"] = json!(folder.join(format!("{label}.pem")));
        config["socket"] = json!(socket);
        let path = folder.join(format!("{label}.yaml"));
        write_yaml(&path, &config)?;
        let mut command = at.command(tools.gdp_ctl()?)?;
        command.args(["serve", "--config"]).arg(path).args(arguments);
        command.envs(tools.loaded_object()?.map(|object| ("GDP_EBPF_OBJECT", object)));
        let process = Process::spawn(label, command, folder)?;
        Ok(Self { name: name.to_owned(), process, socket })
    }

    /// Returns the path of the daemon's admin socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// Runs a `gdp-ctl` command against the daemon and returns its JSON.
    pub fn ctl(&self, tools: &Tools, arguments: &[&str]) -> Result<Value> {
        let mut command = own(tools.gdp_ctl()?);
        command.arg("--socket").arg(&self.socket).args(arguments).arg("-j");
        parse(&execute(&mut command)?)
    }
}

fn start_switch(
    tools: &Tools,
    chain: &Chain,
    folder: &Path,
    names: &[String],
    i: usize,
    name: &str,
    options: &FabricOptions,
) -> Result<Switch> {
    let label = format!("s{}", i + 1);
    let last = names.len() - 1;
    let data_plane = options.data_planes[i % options.data_planes.len()];
    let (interfaces, data_plane, dpdk) = dpdk::planned(data_plane, &["l0", "r0"], options.chain.mtu);
    let neighbour = |interface: &str, address: String, name: &str| match options.udp {
        false => json!({"interface": interface, "switch": name}),
        true => json!({"udp": address, "switch": name}),
    };
    let left = (i > 0).then(|| neighbour(&interfaces[0], options.chain.left_of(i + 1), &names[i - 1]));
    let right = (i < last).then(|| neighbour(&interfaces[1], options.chain.right_of(i + 1), &names[i + 1]));
    let mut config = json!({
        "interfaces": interfaces,
        "udp": options.udp.then(|| format!("0.0.0.0:{GDP_PORT}")),
        "data_plane": data_plane,
        "dpdk": dpdk,
        "bpffs": options.pinned.then(|| folder.join(BPFFS)),
        "rib": i == last,
        "neighbours": left.iter().chain(&right).collect::<Vec<_>>(),
    });
    if let Some(uplink) = right {
        config["uplink"] = uplink;
    }
    let arguments: &[&str] = if options.kept { &["--keep"] } else { &[] };
    Switch::start_with(tools, &chain.switches()[i], folder, (&label, name), config, arguments)
}

/// A mounted file system. Dropping it unmounts the file system, and thereby removes all pins.
pub struct Mounted(pub PathBuf);

impl Drop for Mounted {
    fn drop(&mut self) {
        // The file system is not mounted if no daemon has started yet.
        let _ = execute(Program::Umount.command().arg("--lazy").arg(&self.0));
    }
}

/// Creates keys, names and certificates with the command line.
pub struct Authority<'a> {
    pub tools: &'a Tools,
    pub folder: &'a Path,
}

impl Authority<'_> {
    /// Creates the keys of switches `s1`, `s2`, … and returns their names.
    pub fn switches(&self, count: usize) -> Result<Vec<String>> {
        (1..=count).map(|i| self.switch(&format!("s{i}"))).collect()
    }

    /// Creates a switch's key, `LABEL.pem`, and returns the switch's name.
    pub fn switch(&self, label: &str) -> Result<String> {
        self.key("", &format!("{label}.pem"), "switch")
    }

    /// Creates a proxy's key, `key.pem` in the proxy's folder, and returns the proxy's name.
    pub fn proxy(&self, label: &str) -> Result<String> {
        self.key(label, "key.pem", "proxy")
    }

    /// Creates the owner's key.
    pub fn owner(&self) -> Result<String> {
        self.key(OWNER, "owner.pem", "owner")
    }

    /// Returns the name of a proxy whose key exists.
    pub(crate) fn name_of(&self, label: &str) -> Result<String> {
        field(&self.ctl(label, &["key", "show", "key.pem", "--kind", "proxy"])?, "name")
    }

    /// Creates the owner's key and the topic, and returns the topic's name.
    pub fn topic(&self) -> Result<String> {
        self.owner()?;
        self.name("topic", TOPIC, TYPE, "chatter.card")
    }

    /// Creates another name of the same owner for a `topic`, a `service` or an `action`. The
    /// owner's folder gets its card, and the function returns the name.
    pub fn name(&self, what: &str, topic: &str, kind: &str, card: &str) -> Result<String> {
        let topic = ["--owner", "owner.pem", "--kind", what, "--topic", topic, "--type", kind, "-o", card];
        field(&self.ctl(OWNER, &[&["name", "create"], &topic[..]].concat())?, "name")
    }

    /// Creates another topic of the owner for robot and cloud, whose keys exist. Each gets
    /// `chatterI.card` and `chatterI.cert`.
    fn further_topic(&self, i: u32) -> Result<()> {
        let name = format!("chatter{i}");
        self.name("topic", &format!("{TOPIC}{i}"), TYPE, &format!("{name}.card"))?;
        for (label, right) in [("robot", "--publish"), ("cloud", "--read")] {
            self.hand(label, &self.name_of(label)?, &[right], &name)?;
        }
        Ok(())
    }

    /// Creates a proxy's key and grants the proxy the right. The proxy gets the card and a
    /// certificate.
    pub fn admit(&self, label: &str, right: &str) -> Result<()> {
        let entity = self.proxy(label)?;
        self.grant(label, &entity, &[right])
    }

    /// Grants an entity these rights: copies the card and a certificate into its folder.
    pub fn grant(&self, label: &str, entity: &str, rights: &[&str]) -> Result<()> {
        self.hand(label, entity, rights, "chatter")
    }

    /// Grants an entity rights on another name: it gets `NAME.card` and `NAME.cert`.
    pub fn hand(&self, label: &str, entity: &str, rights: &[&str], name: &str) -> Result<()> {
        let (card, file) = (format!("{name}.card"), format!("{label}-{name}.cert"));
        let (add, whom) = (["grant", "add", &card, "--key", "owner.pem"], ["--entity", entity, "-o", &file]);
        self.ctl(OWNER, &[&add, rights, &whom].concat())?;
        for (from, to) in [(&card, &card), (&file, &format!("{name}.cert"))] {
            let (from, to) = (self.folder.join(OWNER).join(from), self.folder.join(label).join(to));
            fs::copy(&from, &to).with_context(|| format!("cannot copy {}", from.display()))?;
        }
        Ok(())
    }

    fn key(&self, whose: &str, file: &str, kind: &str) -> Result<String> {
        let folder = self.folder.join(whose);
        fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        field(&self.ctl(whose, &["key", "generate", file, "--kind", kind])?, "name")
    }

    /// Runs a `gdp-ctl` command in the folder of a party and returns its JSON.
    pub(crate) fn ctl(&self, whose: &str, arguments: &[&str]) -> Result<Value> {
        let mut command = own(self.tools.gdp_ctl()?);
        parse(&execute(command.args(arguments).arg("-j").current_dir(self.folder.join(whose)))?)
    }
}

/// Writes the configuration as JSON, which is YAML.
pub(crate) fn write_yaml(path: &Path, config: &Value) -> Result<()> {
    fs::write(path, format!("{config:#}\n")).with_context(|| format!("cannot write {}", path.display()))
}

fn parse(output: &str) -> Result<Value> {
    serde_json::from_str(output).with_context(|| format!("not JSON: {output}"))
}

fn field(value: &Value, key: &str) -> Result<String> {
    Ok(value[key].as_str().with_context(|| format!("no `{key}` in {value}"))?.to_owned())
}

fn links(status: &Value) -> usize {
    status["links"].as_array().map_or(0, Vec::len)
}

fn neighbours(switches: usize, i: usize) -> usize {
    usize::from(i > 0) + usize::from(i + 1 < switches)
}
