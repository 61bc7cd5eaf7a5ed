//! The host resources that a daemon uses by default, those that it uses if they are named, and the
//! capabilities that it retains.
//!
//! ```text
//!   host:e0 192.0.2.1 ──── b0:beyond 192.0.2.2
//!   host:e1 ────────────── b1:beyond
//! ```

use std::fs::{self, Permissions};
use std::net::UdpSocket;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::fabric::Mounted;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program, own};
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

/// CAP_NET_ADMIN, CAP_NET_RAW, CAP_PERFMON and CAP_BPF in `/proc/PID/status`.
const FOUR_CAPABILITIES: &str = "000000c000003000";
/// The neighbour's key, in a separate folder.
const FAR: &str = "far/key.pem";
/// Debian's user `nobody`.
const NOBODY: u32 = 65534;

#[test]
fn unasked_it_has_xdp_for_udp_where_there_is_an_address_and_no_links_on_ethernet() -> Result<()> {
    let site = Site::build()?;
    let mut daemon = site.serve(&[])?;
    let line = daemon.ready()?;
    ensure!(line.contains("; XDP: native on e0; "), "{line}");
    ensure!(line.contains("; links over UDP: on 0.0.0.0:31415; "), "{line}");
    ensure!(line.contains("; links on Ethernet: off, no interface is named (`"), "{line}");
    ensure!(line.contains(" --interface DEV`)"), "{line}");
    ensure!(site.attached("e0")? && !site.attached("e1")?);
    ensure!(site.packet_sockets()? == 0);

    let _neighbour = site.neighbour(&daemon)?;
    site.wait_for_kernel_link(&daemon)?;
    // Traffic other than GDP passes.
    site.exchange_datagrams()?;

    // An interface that appears later.
    site.cable("e2", "b2", 3)?;
    site.host.ip(&["address", "add", "198.51.100.1/24", "dev", "e2"])?;
    daemon.process.wait_until("XDP on e2", TIMEOUT, |_| site.attached("e2").ok()?.then_some(()))?;
    let log = daemon.process.stderr();
    ensure!(log.contains("e2: data plane xdp-native") && log.matches("data plane").count() == 1, "{log}");
    daemon.stop()?;
    ensure!(!site.attached("e0")? && !site.attached("e2")?);
    Ok(())
}

/// A bridge has no native XDP, and generic XDP would slow down all of the host's reception.
#[test]
fn an_interface_that_would_be_disturbed_is_left_alone_until_it_is_named() -> Result<()> {
    let site = Site::build()?;
    site.host.ip(&["link", "add", "br0", "type", "bridge", "stp_state", "0"])?;
    site.host.ip(&["link", "set", "e1", "master", "br0"])?;
    site.host.ip(&["address", "add", "198.51.100.1/24", "dev", "br0"])?;
    site.host.ip(&["link", "set", "br0", "up"])?;
    let daemon = site.serve(&[])?;
    let line = daemon.ready()?;
    let off = line.split("XDP: native on e0, off on br0 (no native XDP: the driver has none; ").nth(1);
    let command = off.and_then(|rest| rest.split('`').nth(1)).with_context(|| line.clone())?;
    ensure!(!site.attached("br0")?);
    daemon.stop()?;

    // The printed command enables it.
    let words: Vec<&str> = command.split(' ').collect();
    let mut as_printed = site.host.command(PathBuf::from(words[0]))?;
    as_printed.args(&words[1..]).env("GDP_EBPF_OBJECT", site.tools.ebpf_object()?);
    let line = site.start(as_printed)?.ready()?;
    ensure!(line.contains("links on Ethernet: on br0; XDP: native on e0, generic on br0 ("), "{line}");
    Ok(())
}

#[test]
fn named_interfaces_have_links_on_ethernet_and_xdp() -> Result<()> {
    let site = Site::build()?;
    for (options, on) in [(&["--interface", "e1"][..], "e1"), (&["--all-interfaces"], "e0, e1")] {
        let daemon = site.serve(options)?;
        let line = daemon.ready()?;
        ensure!(line.contains(&format!("; links on Ethernet: on {on}; XDP: native on e0, e1; ")), "{line}");
        ensure!(site.attached("e0")? && site.attached("e1")?);
        ensure!(site.packet_sockets()? > 0);
        daemon.stop()?;
    }
    Ok(())
}

#[test]
fn without_xdp_the_kernel_has_no_program_and_the_log_says_so_once() -> Result<()> {
    let site = Site::build()?;
    let daemon = site.serve(&["--no-xdp", "--interface", "e1"])?;
    let line = daemon.ready()?;
    ensure!(line.contains("on e1; XDP: off, `--no-xdp` or `data_plane: userspace` turns it off; admin"), "{line}");
    ensure!(!site.attached("e0")? && !site.attached("e1")?);
    let log = daemon.process.stderr();
    ensure!(log.matches("turns it off").count() == 1 && !log.contains("asked for"), "{log}");
    ensure!(log.matches("serspace plane").count() == 0, "{log}");
    Ok(())
}

/// The first interface has links on Ethernet, the second one links over UDP.
#[test]
fn an_mtu_that_is_too_small_is_named_with_what_is_needed() -> Result<()> {
    let site = Site::build()?;
    let mut daemon = site.serve(&["--interface", "e1"])?;
    let log = daemon.process.stderr();
    ensure!(log.contains("this switch is of no domain: every endpoint that reaches it gets a link"), "{log}");
    for (before, interface) in ["e1", "e0"].into_iter().enumerate() {
        site.host.ip(&["link", "set", interface, "mtu", "600"])?;
        let small = site.wait_for_warning(&mut daemon, |warning| warning["interface"] == interface)?;
        let needed = small["needed"].as_u64().context("what is needed")?;
        ensure!(small["mtu"] == 600 && (1200..1280).contains(&needed), "{small}");
        let line = format!("the MTU of {interface} is too small for links: `ip link set dev {interface} mtu {needed}`");
        let log = daemon.process.stderr();
        ensure!(log.contains(&line), "{log}");
        site.host.ip(&["link", "set", interface, "mtu", &needed.to_string()])?;
        daemon.process.wait_until("an MTU that is not too small", TIMEOUT, |process| {
            (process.stderr().matches("no longer too small").count() > before).then_some(())
        })?;
        site.wait_for_warning(&mut daemon, |warning| warning["kind"] == "open")?;
    }
    let log = daemon.process.stderr();
    ensure!(log.contains("the MTU of the interface has changed from 1500 to 600; its links end"), "{log}");
    ensure!(log.matches("is too small for links").count() == 2, "{log}");
    daemon.stop()
}

#[test]
fn of_roots_capabilities_it_keeps_four_and_they_suffice_for_all_that_comes() -> Result<()> {
    let site = Site::build()?;
    let mut daemon = site.serve(&["--interface", "e9"])?;
    let line = daemon.ready()?;
    ensure!(line.contains("links on Ethernet: waiting for e9; XDP: native on e0; "), "{line}");
    daemon.has_four_capabilities()?;
    let _neighbour = site.neighbour(&daemon)?;
    site.wait_for_kernel_link(&daemon)?;

    // A named interface that appears, disappears, and appears again.
    for address in [5, 6] {
        site.cable("e9", "b9", address)?;
        daemon.process.wait_until("XDP on e9", TIMEOUT, |_| site.attached("e9").ok()?.then_some(()))?;
        site.host.ip(&["link", "del", "e9"])?;
    }

    // The next daemon takes over a killed daemon's kernel state, and removes it when it ends.
    daemon.process.kill()?;
    ensure!(site.attached("e0")?);
    let daemon = site.serve(&[])?;
    let line = daemon.ready()?;
    ensure!(line.contains("XDP: native on e0 (taken over from the daemon before this one)"), "{line}");
    daemon.has_four_capabilities()?;
    site.wait_for_kernel_link(&daemon)?;
    daemon.stop()?;
    ensure!(!site.attached("e0")?);

    // The daemon can no longer read other users' files.
    chown(site.file("key.pem"), Some(NOBODY), None)?;
    let output = site.command(&[])?.output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    let file = site.file("key.pem");
    let remedy = format!("{} belongs to user {NOBODY}", file.display());
    ensure!(output.status.code() == Some(1), "{said}");
    ensure!(said.contains(&remedy) && said.contains(&format!("chown root {}", file.display())), "{said}");
    Ok(())
}

#[test]
fn capabilities_and_not_root_decide_what_is_possible() -> Result<()> {
    let site = Site::build()?;
    site.give_to_nobody()?;
    let manager = UnixDatagram::bind(site.file("notify"))?;
    manager.set_read_timeout(Some(TIMEOUT))?;
    chown(site.file("notify"), Some(NOBODY), Some(NOBODY))?;
    let mut granted = site.as_nobody(&capabilities_of_the_unit()?)?;
    let daemon = site.start({
        granted.args(["--interface", "e1"]);
        granted.env("NOTIFY_SOCKET", site.file("notify")).env("WATCHDOG_USEC", "1000000");
        granted
    })?;
    let line = daemon.ready()?;
    ensure!(line.contains("; links on Ethernet: on e1; XDP: native on e0, e1; "), "{line}");
    daemon.has_four_capabilities()?;
    ensure!(notification(&manager)? == "STATUS=starting");
    let ready = notification(&manager)?;
    ensure!(ready.starts_with("READY=1\nSTATUS=ready: switch ") && ready.contains("XDP: native on e0, e1"), "{ready}");
    ensure!(notification(&manager)? == "WATCHDOG=1" && notification(&manager)? == "WATCHDOG=1");
    let neighbour = site.neighbour(&daemon)?;
    site.wait_for_kernel_link(&daemon)?;
    drop(neighbour);
    daemon.stop()?;
    while notification(&manager)? != "STOPPING=1" {}

    let daemon = site.start(site.as_nobody("-all")?)?;
    let (line, log) = (daemon.ready()?, daemon.process.stderr());
    let off = "XDP: off, this process lacks CAP_BPF, CAP_PERFMON, CAP_NET_ADMIN; run it as root, or grant it these";
    ensure!(line.contains(off) && log.matches("lacks").count() == 1, "{log}");
    ensure!(!site.attached("e0")? && !site.attached("e1")?);
    drop(daemon);

    let mut named = site.as_nobody("-all")?;
    let output = named.args(["--interface", "e1"]).output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.code() == Some(1) && said.contains("needs root or CAP_NET_RAW"), "{said}");
    Ok(())
}

struct Site {
    host: Namespace,
    beyond: Namespace,
    tools: Tools,
    _bpffs: Mounted,
    files: tempfile::TempDir,
}

struct Daemon {
    process: Process,
}

impl Site {
    fn build() -> Result<Self> {
        let (host, beyond) = (Namespace::create("host")?, Namespace::create("beyond")?);
        let files = tempfile::tempdir()?;
        let bpffs = Mounted(files.path().join("bpf"));
        let site = Self { host, beyond, tools: Tools::beside_this_test()?, _bpffs: bpffs, files };
        site.cable("e0", "b0", 1)?;
        site.cable("e1", "b1", 2)?;
        site.host.ip(&["address", "add", "192.0.2.1/24", "dev", "e0"])?;
        site.beyond.ip(&["address", "add", "192.0.2.2/24", "dev", "b0"])?;
        fs::create_dir(site.file("far"))?;
        let mut far = own(site.tools.gdp_ctl()?);
        let far = execute(far.args(["key", "generate", "--kind", "switch", "-j"]).arg(site.file(FAR)))?;
        let far: Value = serde_json::from_str(&far).with_context(|| format!("not JSON: {far}"))?;
        let neighbour = json!({"udp": "192.0.2.2:31415", "switch": far["name"]});
        let config = json!({"identity": "key.pem", "socket": "socket", "bpffs": "bpf", "neighbours": [neighbour]});
        fs::write(site.file("config.yaml"), config.to_string())?;
        Ok(site)
    }

    fn cable(&self, here: &str, there: &str, number: u8) -> Result<()> {
        let end = |namespace, interface, side| End { namespace, interface, mac: [2, 0, 0, 0, side, number] };
        veth(&end(&self.host, here, 1), &end(&self.beyond, there, 2), 1500)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.files.path().join(name)
    }

    fn command(&self, options: &[&str]) -> Result<Command> {
        let mut command = self.host.command(self.tools.gdp_ctl()?)?;
        command.args(["serve", "--config"]).arg(self.file("config.yaml")).args(options);
        command.env("GDP_EBPF_OBJECT", self.tools.ebpf_object()?);
        Ok(command)
    }

    fn serve(&self, options: &[&str]) -> Result<Daemon> {
        self.start(self.command(options)?)
    }

    fn start(&self, command: Command) -> Result<Daemon> {
        let mut process = Process::spawn("daemon", command, self.files.path())?;
        let is_ready = |process: &Process| process.stderr().contains("ready: switch ").then_some(());
        process.wait_until("the ready line", TIMEOUT, is_ready)?;
        Ok(Daemon { process })
    }

    /// Starts the switch beyond `e0`, with a link to the daemon.
    fn neighbour(&self, daemon: &Daemon) -> Result<Process> {
        let line = daemon.ready()?;
        let name = line.split("ready: switch ").nth(1).and_then(|rest| rest.split(';').next()).context("a name")?;
        let config = json!({
            "identity": "key.pem", "socket": "socket", "data_plane": "userspace", "bpffs": null,
            "uplink": {"udp": "192.0.2.1:31415", "switch": name},
        });
        let file = self.file("far/config.yaml");
        fs::write(&file, config.to_string())?;
        let mut command = self.beyond.command(self.tools.gdp_ctl()?)?;
        command.args(["serve", "--config"]).arg(file);
        Process::spawn("neighbour", command, self.files.path())
    }

    /// Waits until the status has a warning, and returns it.
    fn wait_for_warning(&self, daemon: &mut Daemon, is_it: impl Fn(&Value) -> bool) -> Result<Value> {
        daemon.process.wait_until("a warning", TIMEOUT, |_| {
            let mut status = own(self.tools.gdp_ctl().ok()?);
            let output = status.arg("--socket").arg(self.file("socket")).args(["status", "-j"]).output().ok()?;
            let status = serde_json::from_slice::<Value>(&output.stdout).ok()?;
            status["warnings"].as_array()?.iter().find(|warning| is_it(warning)).cloned()
        })
    }

    /// Waits until there is a link on which the kernel sends.
    fn wait_for_kernel_link(&self, daemon: &Daemon) -> Result<()> {
        let link = wait_for("a link in the kernel", TIMEOUT, || {
            let mut status = own(self.tools.gdp_ctl()?);
            let output = status.arg("--socket").arg(self.file("socket")).args(["status", "-j"]).output()?;
            let status = serde_json::from_slice::<Value>(&output.stdout).unwrap_or_default();
            Ok((status["links"][0]["plane"] == "kernel").then_some(()))
        });
        link.with_context(|| daemon.process.report())
    }

    /// Exchanges datagrams on another port, over the interface with the XDP program.
    fn exchange_datagrams(&self) -> Result<()> {
        let socket = |at: &Namespace, address: &str| -> Result<UdpSocket> {
            let _inside = at.enter()?;
            let socket = UdpSocket::bind((address, 4000))?;
            socket.set_read_timeout(Some(TIMEOUT))?;
            Ok(socket)
        };
        let (here, there) = (socket(&self.host, "192.0.2.1")?, socket(&self.beyond, "192.0.2.2")?);
        let mut buffer = [0; 16];
        there.send_to(b"question", "192.0.2.1:4000")?;
        let (length, from) = here.recv_from(&mut buffer)?;
        ensure!(&buffer[..length] == b"question");
        here.send_to(b"answer", from)?;
        let length = there.recv(&mut buffer)?;
        ensure!(&buffer[..length] == b"answer");
        Ok(())
    }

    fn attached(&self, interface: &str) -> Result<bool> {
        Ok(self.host.ip(&["-o", "link", "show", interface])?.contains(" xdp"))
    }

    /// Returns the number of packet sockets in the host, of all processes.
    fn packet_sockets(&self) -> Result<usize> {
        let _inside = self.host.enter()?;
        Ok(fs::read_to_string("/proc/thread-self/net/packet")?.lines().skip(1).count())
    }

    /// Gives the daemon's files to `nobody`, with readable copies of the executable and the eBPF
    /// object.
    fn give_to_nobody(&self) -> Result<()> {
        fs::create_dir(self.file("bpf"))?;
        execute(Program::Mount.command().args(["-t", "bpf", "bpf"]).arg(self.file("bpf")))?;
        fs::copy(self.tools.gdp_ctl()?, self.file("gdp-ctl"))?;
        fs::copy(self.tools.ebpf_object()?, self.file("object"))?;
        fs::set_permissions(self.file("object"), Permissions::from_mode(0o644))?;
        for path in [self.files.path(), &self.file("bpf"), &self.file("config.yaml")] {
            chown(path, Some(NOBODY), Some(NOBODY))?;
        }
        Ok(())
    }

    fn as_nobody(&self, capabilities: &str) -> Result<Command> {
        let mut command = self.host.command(Program::Setpriv)?;
        let nobody = NOBODY.to_string();
        command.args(["--reuid", &nobody, "--regid", &nobody, "--clear-groups"]);
        command.args(["--inh-caps", capabilities, "--ambient-caps", capabilities]);
        command.arg(self.file("gdp-ctl")).args(["serve", "--config"]).arg(self.file("config.yaml"));
        command.env("GDP_EBPF_OBJECT", self.file("object"));
        Ok(command)
    }
}

/// Returns the capabilities of the packages' unit in the form that setpriv expects.
fn capabilities_of_the_unit() -> Result<String> {
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/systemd/gdp-switch.service");
    let unit = fs::read_to_string(unit)?;
    let line = unit.lines().find_map(|line| line.strip_prefix("AmbientCapabilities="));
    let names = line.context("the unit grants no capabilities")?.split(' ');
    let names = names.map(|name| format!(",+{}", name.trim_start_matches("CAP_").to_lowercase()));
    Ok(format!("-all{}", names.collect::<String>()))
}

/// Receives the daemon's next notification in the service manager's place.
fn notification(manager: &UnixDatagram) -> Result<String> {
    let mut buffer = [0; 4096];
    let length = manager.recv(&mut buffer).context("no notification")?;
    Ok(String::from_utf8_lossy(&buffer[..length]).into_owned())
}

impl Daemon {
    /// Returns the daemon's ready line, and fails unless there is exactly one.
    fn ready(&self) -> Result<String> {
        let log = self.process.stderr();
        let mut lines = log.lines().filter(|line| line.contains("ready: switch "));
        let line = lines.next().with_context(|| log.clone())?;
        ensure!(lines.next().is_none(), "{log}");
        Ok(line.to_owned())
    }

    /// Stops the daemon with SIGTERM, so it removes its kernel state.
    fn stop(mut self) -> Result<()> {
        ensure!(self.process.stop(TIMEOUT)?.success(), "{}", self.process.report());
        Ok(())
    }

    /// Checks that all threads have exactly these capabilities and cannot gain others.
    fn has_four_capabilities(&self) -> Result<()> {
        let threads = format!("/proc/{}/task", self.process.pid());
        for thread in fs::read_dir(Path::new(&threads))?.flatten() {
            let Ok(status) = fs::read_to_string(thread.path().join("status")) else { continue };
            let field = |key: &str| status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default().trim();
            for set in ["CapEff:", "CapPrm:"] {
                ensure!(field(set) == FOUR_CAPABILITIES, "{status}");
            }
            for set in ["CapInh:", "CapAmb:"] {
                ensure!(field(set) == "0000000000000000", "{status}");
            }
            ensure!(field("NoNewPrivs:") == "1", "{status}");
        }
        Ok(())
    }
}
