//! `gdp-ctl doctor` with real faults, the messages of `serve` about the same faults, and `gdp-ctl
//! link list`.
//!
//! ```text
//!   switch:l0 ──── e0:end
//! ```

use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use aya::Ebpf;
use aya::programs::Xdp;
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program, own};
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

#[test]
fn a_healthy_host_passes() -> Result<()> {
    let site = Site::build()?;
    let diagnosis = site.doctor(0)?;
    for check in ["kernel", "capabilities", "btf", "ebpf object", "jit", "udp port", "bpffs"] {
        ensure!(diagnosis.one(check)?["level"] == "ok", "{:#}", diagnosis.0);
    }
    for check in ["state", "mtu", "program", "mode", "redirects", "offloads"] {
        let finding = diagnosis.one(check)?;
        ensure!(finding["level"] == "ok" && finding["interface"] == "l0", "{finding:#}");
    }
    ensure!(diagnosis.0["ok"] == true);
    ensure!(!site.shown()?.contains("xdp"), "nothing stays attached");
    ensure!(!site.files.path().join(BPFFS).exists(), "nothing is mounted");
    Ok(())
}

#[test]
fn a_foreign_program_is_named_by_doctor_and_by_serve() -> Result<()> {
    let site = Site::build()?;
    let id = site.attach_foreign()?;
    let finding = site.doctor(1)?.one("program")?;
    let fact = format!("another XDP program is attached: program {id} `gdp_pass`, in native mode");
    ensure!(finding["level"] == "failed" && finding["fact"] == fact, "{finding:#}");

    let refused = site.ctl(&["serve", "--config"], &site.config("xdp")?)?;
    let said = String::from_utf8_lossy(&refused.stderr);
    ensure!(refused.status.code() == Some(1) && said.contains(&fact), "{said}");
    ensure!(said.contains("xdpdrv off"), "with the remedy: {said}");
    site.serves_in_userspace_because(&fact)?;

    // The remedy is a working command.
    let remedy = finding["remedy"].as_str().unwrap_or_default();
    let command = remedy.split('`').nth(1).with_context(|| remedy.to_owned())?;
    let words: Vec<&str> = command.split(' ').collect();
    ensure!(words[0] == Program::Ip.name(), "{remedy}");
    execute(site.switch.command(Program::Ip)?.args(&words[1..]))?;
    ensure!(site.doctor(0)?.one("program")?["level"] == "ok");
    Ok(())
}

/// `ip` cannot remove a program that a BPF link attached instead of the interface itself.
#[test]
fn a_program_that_a_link_holds_has_another_remedy() -> Result<()> {
    let site = Site::build()?;
    let mut ebpf = site.foreign()?;
    let program: &mut Xdp = ebpf.program_mut("gdp_pass").context("gdp_pass")?.try_into()?;
    {
        let _inside = site.switch.enter()?;
        program.attach("l0", aya::programs::xdp::XdpMode::Skb)?;
    }
    let finding = site.doctor(1)?.one("program")?;
    ensure!(finding["fact"].as_str().is_some_and(|fact| fact.contains("in generic mode")), "{finding:#}");
    ensure!(finding["remedy"].as_str().is_some_and(|remedy| remedy.contains("bpftool link detach")), "{finding:#}");
    drop(ebpf);
    ensure!(site.doctor(0)?.one("program")?["level"] == "ok");
    Ok(())
}

#[test]
fn a_veth_whose_peer_takes_no_redirects_is_a_warning() -> Result<()> {
    let site = Site::build()?;
    let gro = |state| execute(site.end.command(Program::Ethtool)?.args(["-K", "e0", "gro", state]));
    gro("off")?;
    let finding = site.doctor(0)?.one("redirects")?;
    ensure!(finding["level"] == "warning", "{finding:#}");
    ensure!(finding["remedy"].as_str().is_some_and(|remedy| remedy.contains("gro on")), "{finding:#}");
    gro("on")?;
    ensure!(site.doctor(0)?.one("redirects")?["level"] == "ok");
    Ok(())
}

#[test]
fn what_else_keeps_a_daemon_from_running_fails() -> Result<()> {
    let site = Site::build()?;
    let taken = {
        let _inside = site.switch.enter()?;
        std::net::UdpSocket::bind("0.0.0.0:31415")?
    };
    let finding = site.doctor(1)?.one("udp port")?;
    let process = format!("(process {})", std::process::id());
    ensure!(finding["fact"].as_str().is_some_and(|fact| fact.contains(&process)), "{finding:#}");
    drop(taken);

    site.switch.ip(&["link", "set", "l0", "down"])?;
    ensure!(site.doctor(1)?.one("state")?["fact"] == "down");
    site.switch.ip(&["link", "set", "l0", "up"])?;

    let config = site.config("auto")?;
    let broken = site.files.path().join("object");
    std::fs::write(&broken, "no eBPF")?;
    let output = site.ctl(&["doctor", "-j", "--ebpf-object", &broken.display().to_string(), "--config"], &config)?;
    let finding = Diagnosis::of(&output, 1)?.one("ebpf object")?;
    ensure!(finding["level"] == "failed" && finding["fact"].to_string().contains("object: "), "{finding:#}");
    let output = site.ctl(&["doctor", "-j", "--interface", "l7", "--config"], &config)?;
    ensure!(Diagnosis::of(&output, 1)?.one("interface")?["interface"] == "l7");

    for (dropped, lacks) in
        [("-bpf,-sys_admin,-net_raw", "CAP_BPF, CAP_NET_RAW"), ("-perfmon,-sys_admin", "CAP_PERFMON")]
    {
        let mut without = site.switch.command(Program::Setpriv)?;
        without.args(["--bounding-set", dropped]).arg(site.tools.gdp_ctl()?);
        without.args(["doctor", "-j", "--config"]).arg(&config).env("GDP_EBPF_OBJECT", site.tools.ebpf_object()?);
        let diagnosis = Diagnosis::of(&without.output()?, 1)?;
        ensure!(diagnosis.one("capabilities")?["fact"] == format!("this process lacks {lacks}"), "{:#}", diagnosis.0);
        let refused = diagnosis.one("ebpf object")?["fact"].to_string();
        ensure!(refused.contains("not permitted: run as root, or with the capabilities"), "{refused}");
    }
    Ok(())
}

#[test]
fn links_and_losses_are_shown_and_what_a_daemon_leaves_is_found() -> Result<()> {
    let chain = ChainOptions { switches: 2, ..Default::default() };
    let options = FabricOptions { chain, pinned: true, ..Default::default() };
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    let listed = fabric.ctl(0, &["link", "list"])?;
    let [link] = listed["links"].as_array().context("links")?.as_slice() else { anyhow::bail!("{listed:#}") };
    ensure!(link["peer"] == fabric.switches[1].name.as_str() && link["role"] == "switch", "{link:#}");
    ensure!((&link["plane"], &link["via"]) == (&json!("kernel"), &json!("r0")), "{link:#}");
    ensure!(link["id"].as_u64() > Some(0) && link["mtu"].as_u64() > Some(1000), "{link:#}");
    ensure!(link["age_s"].is_u64() && link["rtt_us"].is_u64(), "{link:#}");

    let status = fabric.status(0)?;
    ensure!(status["counters"]["drop_redirect_lost"] == 0 && status["errors"] == json!([]), "{status:#}");
    let lost = |interface: &Value| interface["redirect_lost"] == 0;
    ensure!(status["interfaces"].as_array().is_some_and(|all| all.len() == 2 && all.iter().all(lost)), "{status:#}");
    let stats = &fabric.xdp("stats")?["switches"][0];
    ensure!(stats["redirect_lost"].as_object().map(serde_json::Map::len) == Some(2), "both are watched: {stats:#}");

    let doctor = |fabric: &Fabric, status| -> Result<Diagnosis> {
        let mut command = fabric.chain.switches()[0].command(fabric.tools.gdp_ctl()?)?;
        command.args(["doctor", "-j", "--config"]).arg(fabric.folder().join("s1.yaml"));
        Diagnosis::of(&command.env("GDP_EBPF_OBJECT", fabric.tools.ebpf_object()?).output()?, status)
    };
    let running = doctor(&fabric, 0)?;
    ensure!(
        running.all("program").all(|finding| finding["fact"].to_string().contains("gdp_switch")),
        "{:#}",
        running.0
    );
    ensure!(running.all("pins").all(|finding| finding["level"] == "ok"), "{:#}", running.0);
    fabric.switches[0].process.kill()?;
    let left = doctor(&fabric, 0)?;
    let told = |finding: &Value| finding["fact"].to_string().contains("still forwards");
    ensure!(left.all("pins").any(|finding| finding["level"] == "warning" && told(finding)), "{:#}", left.0);
    Ok(())
}

/// BPF file systems in the folder of a site: the daemon's, and the foreign program's.
const BPFFS: &str = "bpf";
const FOREIGN: &str = "foreign";

struct Site {
    switch: Namespace,
    end: Namespace,
    tools: Tools,
    files: tempfile::TempDir,
}

/// The output of `gdp-ctl doctor -j`.
struct Diagnosis(Value);

impl Site {
    fn build() -> Result<Self> {
        let (switch, end) = (Namespace::create("switch")?, Namespace::create("end")?);
        let mac = |i| [2, 0, 0, 0, 7, i];
        let ends = [(&switch, "l0", mac(1)), (&end, "e0", mac(2))];
        let [a, b] = ends.map(|(namespace, interface, mac)| End { namespace, interface, mac });
        veth(&a, &b, 1500)?;
        Ok(Self { tools: Tools::beside_this_test()?, files: tempfile::tempdir()?, switch, end })
    }

    /// Writes a configuration whose paths are all in this site's folder.
    fn config(&self, data_plane: &str) -> Result<PathBuf> {
        let file = |name: &str| self.files.path().join(name);
        let config = json!({
            "identity": file("key.pem"), "socket": file("socket"), "interfaces": ["l0"],
            "data_plane": data_plane, "bpffs": file(BPFFS),
        });
        std::fs::write(file("config.yaml"), config.to_string())?;
        Ok(file("config.yaml"))
    }

    fn doctor(&self, status: i32) -> Result<Diagnosis> {
        Diagnosis::of(&self.ctl(&["doctor", "-j", "--config"], &self.config("auto")?)?, status)
    }

    fn ctl(&self, arguments: &[&str], config: &std::path::Path) -> Result<Output> {
        Ok(self.command(arguments, config)?.output()?)
    }

    fn command(&self, arguments: &[&str], config: &std::path::Path) -> Result<Command> {
        let mut command = self.switch.command(self.tools.gdp_ctl()?)?;
        command.args(arguments).arg(config).env("GDP_EBPF_OBJECT", self.tools.ebpf_object()?);
        Ok(command)
    }

    fn serves_in_userspace_because(&self, reason: &str) -> Result<()> {
        let command = self.command(&["serve", "--config"], &self.config("auto")?)?;
        let mut daemon = Process::spawn("daemon", command, self.files.path())?;
        let status = wait_for("the daemon", TIMEOUT, || {
            daemon.check_alive()?;
            let mut ctl = own(self.tools.gdp_ctl()?);
            let output = ctl.arg("--socket").arg(self.files.path().join("socket")).args(["status", "-j"]).output()?;
            // The daemon answers before it has examined its interfaces.
            let status = serde_json::from_slice::<Value>(&output.stdout).ok();
            Ok(status.filter(|status| status["interfaces"][0].is_object()))
        })?;
        ensure!(status["data_plane"] == "userspace", "{status:#}");
        ensure!(status["data_plane_reason"].as_str().is_some_and(|said| said.contains(reason)), "{status:#}");
        daemon.stop(Duration::from_secs(5)).map(drop)
    }

    fn shown(&self) -> Result<String> {
        self.switch.ip(&["-o", "link", "show", "l0"])
    }

    /// Loads the object's pass-through program, in the role of a program that is not GDP's.
    fn foreign(&self) -> Result<Ebpf> {
        let mut ebpf = Ebpf::load_file(self.tools.ebpf_object()?)?;
        let program: &mut Xdp = ebpf.program_mut("gdp_pass").context("gdp_pass")?.try_into()?;
        program.load()?;
        Ok(ebpf)
    }

    /// Attaches the program as `ip` does, to the interface itself, and returns the program's id.
    fn attach_foreign(&self) -> Result<u32> {
        let place = self.files.path().join(FOREIGN);
        std::fs::create_dir(&place)?;
        execute(Program::Mount.command().args(["-t", "bpf", "bpf"]).arg(&place))?;
        let mut ebpf = self.foreign()?;
        let program: &mut Xdp = ebpf.program_mut("gdp_pass").context("gdp_pass")?.try_into()?;
        let pin = place.join("program");
        program.pin(&pin)?;
        self.switch.ip(&["link", "set", "dev", "l0", "xdpdrv", "pinned", &pin.display().to_string()])?;
        Ok(program.info()?.id())
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        for place in [BPFFS, FOREIGN] {
            // Not every test mounts both.
            let _ = execute(Program::Umount.command().arg("--lazy").arg(self.files.path().join(place)));
        }
    }
}

impl Diagnosis {
    fn of(output: &Output, status: i32) -> Result<Self> {
        ensure!(output.status.code() == Some(status), "{output:?}");
        let diagnosis: Value = serde_json::from_slice(&output.stdout).with_context(|| format!("{output:?}"))?;
        ensure!((diagnosis["ok"] == true) == (status == 0) && diagnosis["v"] == 2, "{diagnosis:#}");
        Ok(Self(diagnosis))
    }

    fn all(&self, check: &str) -> impl Iterator<Item = &Value> {
        self.0["findings"].as_array().into_iter().flatten().filter(move |finding| finding["check"] == check)
    }

    fn one(&self, check: &str) -> Result<Value> {
        let mut found = self.all(check);
        let one = found.next().with_context(|| format!("no {check} in {:#}", self.0))?;
        ensure!(found.next().is_none(), "{check} more than once: {:#}", self.0);
        Ok(one.clone())
    }
}
