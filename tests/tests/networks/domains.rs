//! A trust domain as its administrator makes it, with the real programs. There is a first switch,
//! an invitation, and a second switch or a proxy. The newcomer joins with the invitation over a
//! cable without IP.
//!
//! ```text
//!  [ first switch and RIB  h0 ]────────[ e0  newcomer ]
//! ```

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program, own};
use gdp_tests::tools::Tools;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

#[test]
fn a_switch_joins_by_one_line_and_leaves_when_it_is_revoked() -> Result<()> {
    let mut home = Home::start()?;
    let (folder, first) = (home.files.path(), home.first.clone());
    let user = |arguments: &[&str]| ctl(&home.tools, folder, arguments);

    let invite =
        ["domain", "invite", "--key", "home/domain.pem", "--role", "switch", "--at", "eth://e0", "--switch", &first];
    let token = user(&invite)?["token"].as_str().context("a line")?.to_owned();
    let name = join(&home.tools, folder, &token)?;
    // Adds this machine's settings to the configuration that `join` wrote.
    let config = folder.join("new/gdp.yaml");
    let written = fs::read_to_string(&config)? + "socket: ../new.sock\ninterfaces: [e0]\nudp: null\nbpffs: null\n";
    fs::write(&config, written)?;
    let mut newcomer = serve(&home.tools, &home.beyond, "newcomer", &config, folder)?;

    let standing = |socket: &str, peer: &str| standing(&home.tools, folder, socket, peer);
    for (socket, peer) in [("first.sock", &name), ("new.sock", &first)] {
        let link = wait_for(&format!("{socket} to have the link"), TIMEOUT, || {
            home.process.check_alive()?;
            newcomer.check_alive()?;
            Ok(standing(socket, peer).filter(|link| link["relationship"] == "member"))
        })
        .with_context(|| home.process.report() + &newcomer.report())?;
        ensure!(link["plane"] == "kernel", "{link:#}");
    }
    wait_for("the RIB to know both", TIMEOUT, || {
        let status = user(&["--socket", "first.sock", "status"])?;
        Ok((status["rib"]["switches"] == 2 && status["domain"]["invitations_used"] == 1).then_some(()))
    })?;

    user(&["--socket", "first.sock", "domain", "revoke", "--key", "home/domain.pem", "new/membership"])?;
    wait_for("the link to be gone", TIMEOUT, || Ok(standing("first.sock", &name).is_none().then_some(())))?;
    wait_for("both to say why", TIMEOUT, || {
        let said = |process: &Process| process.stderr().contains("revoked: the Invite");
        Ok((said(&home.process) && said(&newcomer)).then_some(()))
    })
    .with_context(|| home.process.report() + &newcomer.report())?;
    // No log contains the invitation's key or the invitation itself.
    for process in [&home.process, &newcomer] {
        ensure!(!process.stderr().contains(&token[..40]), "{}", process.report());
    }
    for process in [&mut newcomer, &mut home.process] {
        ensure!(process.stop(TIMEOUT)?.success(), "{}", process.report());
    }
    Ok(())
}

#[test]
fn a_proxy_attaches_with_the_configuration_that_join_wrote() -> Result<()> {
    let mut home = Home::start()?;
    let name = home.join_robot()?;
    let mut proxy = home.start_proxy(&name)?;
    for process in [&mut proxy, &mut home.process] {
        ensure!(process.stop(TIMEOUT)?.success(), "{}", process.report());
    }
    Ok(())
}

/// Reproduces a container: a write to the mounted file elsewhere produces no event in the folder of
/// the mount.
#[test]
fn a_bind_mounted_configuration_is_read_again() -> Result<()> {
    let mut home = Home::start()?;
    let name = home.join_robot()?;
    let (config, source) = (home.files.path().join("new/gdp.yaml"), home.files.path().join("source.yaml"));
    fs::copy(&config, &source)?;
    let _mount = BindMount::new(&source, &config)?;
    let mut proxy = home.start_proxy(&name)?;
    fs::write(&source, fs::read_to_string(&source)? + "diagnostics: true\n")?;
    wait_for("the changed file to be read", TIMEOUT, || {
        proxy.check_alive()?;
        Ok(proxy.stderr().contains("took the changed configuration").then_some(()))
    })
    .with_context(|| proxy.report())?;
    for process in [&mut proxy, &mut home.process] {
        ensure!(process.stop(TIMEOUT)?.success(), "{}", process.report());
    }
    Ok(())
}

/// A file that is bind-mounted on another one until this guard is dropped.
struct BindMount(PathBuf);

impl BindMount {
    fn new(source: &Path, on: &Path) -> Result<Self> {
        execute(Program::Mount.command().arg("--bind").args([source, on]))?;
        Ok(Self(on.into()))
    }
}

impl Drop for BindMount {
    fn drop(&mut self) {
        let _ = execute(Program::Umount.command().arg(&self.0));
    }
}

/// A domain with its first switch, and a cable to the newcomer.
struct Home {
    process: Process,
    /// The name of the first switch.
    first: String,
    files: tempfile::TempDir,
    beyond: Namespace,
    _at_home: Namespace,
    tools: Tools,
}

impl Home {
    fn start() -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let (at_home, beyond) = (Namespace::create("first")?, Namespace::create("newcomer")?);
        let end = |namespace, interface, mac| End { namespace, interface, mac };
        veth(&end(&at_home, "h0", [2, 0, 0, 0, 0, 1]), &end(&beyond, "e0", [2, 0, 0, 0, 0, 2]), 1500)?;
        let files = tempfile::tempdir()?;
        let folder = files.path();
        let user = |arguments: &[&str]| ctl(&tools, folder, arguments);
        user(&["domain", "init", "-o", "home"])?;
        let first = name_in(&user(&["key", "generate", "first.pem", "--kind", "switch"])?)?;
        user(&["domain", "admit", "--key", "home/domain.pem", &first, "--role", "rib", "-o", "first.member"])?;
        let config = json!({
            "identity": "first.pem", "socket": "first.sock", "interfaces": ["h0"], "udp": null, "bpffs": null,
            "domain": {"card": "home/domain.card", "membership": "first.member", "members_only": true},
        });
        fs::write(folder.join("first.yaml"), config.to_string())?;
        let process = serve(&tools, &at_home, "first", &folder.join("first.yaml"), folder)?;
        Ok(Self { process, first, files, beyond, _at_home: at_home, tools })
    }

    /// Returns the name of the proxy that may use the folder `new`.
    fn join_robot(&self) -> Result<String> {
        let invite = ["domain", "invite", "--key", "home/domain.pem", "--role", "robot", "--at", "eth://e0"];
        let invited = ctl(&self.tools, self.files.path(), &[&invite[..], &["--switch", &self.first]].concat())?;
        join(&self.tools, self.files.path(), invited["token"].as_str().context("a line")?)
    }

    /// Starts the proxy of this name with what `join` wrote, and waits until it is attached.
    fn start_proxy(&mut self, name: &str) -> Result<Process> {
        let folder = self.files.path();
        let mut command = self.beyond.command(self.tools.gdp_proxy()?)?;
        command.arg("--config").arg(folder.join("new/gdp.yaml"));
        let mut proxy = Process::spawn("robot", command, folder)?;
        wait_for("the proxy to be attached as a member", TIMEOUT, || {
            self.process.check_alive()?;
            proxy.check_alive()?;
            let link = standing(&self.tools, folder, "first.sock", name);
            Ok(link.filter(|link| link["relationship"] == "member" && link["role"] == "endpoint"))
        })
        .with_context(|| self.process.report() + &proxy.report())?;
        Ok(proxy)
    }
}

/// Returns the link with `peer` from the daemon behind `socket`.
fn standing(tools: &Tools, folder: &Path, socket: &str, peer: &str) -> Option<Value> {
    let links = ctl(tools, folder, &["--socket", socket, "link", "list"]).ok()?;
    links["links"].as_array()?.iter().find(|link| link["peer"] == peer).cloned()
}

fn serve(tools: &Tools, at: &Namespace, label: &str, config: &Path, folder: &Path) -> Result<Process> {
    let mut command = at.command(tools.gdp_ctl()?)?;
    command.args(["serve", "--config"]).arg(config).env("GDP_EBPF_OBJECT", tools.ebpf_object()?);
    Process::spawn(label, command, folder)
}

/// Joins with the invitation on stdin. Returns the new member's name; its files are in the folder
/// `new`.
fn join(tools: &Tools, folder: &Path, token: &str) -> Result<String> {
    let mut command = own(tools.gdp_ctl()?);
    command.args(["-j", "domain", "join", "-", "-o", "new"]).current_dir(folder);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
    child.stdin.take().context("a pipe")?.write_all(token.as_bytes())?;
    let output = child.wait_with_output()?;
    ensure!(output.status.success(), "join failed");
    name_in(&serde_json::from_slice(&output.stdout)?)
}

fn name_in(reply: &Value) -> Result<String> {
    Ok(reply["name"].as_str().context("a name")?.to_owned())
}

fn ctl(tools: &Tools, folder: &Path, arguments: &[&str]) -> Result<Value> {
    let mut command = own(tools.gdp_ctl()?);
    let output = execute(command.args(arguments).arg("-j").current_dir(folder))?;
    serde_json::from_str(&output).with_context(|| format!("not JSON: {output}"))
}
