//! A trust domain as its administrator makes it, with the real programs: a first switch, an invitation, and a second switch that
//! joins by it over a cable without IP, forwards in its kernel, and is taken back.
//!
//! ```text
//!  [ first switch and RIB  h0 ]────────[ e0  newcomer ]
//! ```

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::own;
use gdp_tests::tools::Tools;
use gdp_tests::wait::{PATIENCE, wait_for};
use serde_json::{Value, json};

#[test]
fn a_switch_joins_by_one_line_and_leaves_when_it_is_revoked() -> Result<()> {
    let tools = Tools::beside_this_test()?;
    let (at_home, beyond) = (Namespace::create("first")?, Namespace::create("newcomer")?);
    let end = |namespace, interface, mac| End { namespace, interface, mac };
    veth(&end(&at_home, "h0", [2, 0, 0, 0, 0, 1]), &end(&beyond, "e0", [2, 0, 0, 0, 0, 2]), 1500)?;
    let files = tempfile::tempdir()?;
    let folder = files.path();
    let user = |arguments: &[&str]| ctl(&tools, folder, arguments);

    user(&["domain", "init", "-o", "home"])?;
    let first =
        user(&["key", "generate", "first.pem", "--kind", "switch"])?["name"].as_str().context("a name")?.to_owned();
    user(&["domain", "admit", "--key", "home/domain.pem", &first, "--role", "rib", "-o", "first.member"])?;
    let config = json!({
        "identity": "first.pem", "socket": "first.sock", "interfaces": ["h0"], "udp": null, "bpffs": null,
        "domain": {"card": "home/domain.card", "membership": "first.member", "members_only": true},
    });
    fs::write(folder.join("first.yaml"), config.to_string())?;
    let mut first_process = serve(&tools, &at_home, "first", &folder.join("first.yaml"), folder)?;

    let invite =
        ["domain", "invite", "--key", "home/domain.pem", "--role", "switch", "--at", "eth://e0", "--switch", &first];
    let token = user(&invite)?["token"].as_str().context("a line")?.to_owned();
    let joined = join(&tools, folder, &token)?;
    let name = joined["name"].as_str().context("a name")?.to_owned();
    // What is to be added to what `join` wrote is this machine's business.
    let config = folder.join("new/gdp.yaml");
    let written = fs::read_to_string(&config)? + "socket: ../new.sock\ninterfaces: [e0]\nudp: null\nbpffs: null\n";
    fs::write(&config, written)?;
    let mut newcomer = serve(&tools, &beyond, "newcomer", &config, folder)?;

    let standing = |socket: &str, peer: &str| -> Option<Value> {
        let links = ctl(&tools, folder, &["--socket", socket, "link", "list"]).ok()?;
        links["links"].as_array()?.iter().find(|link| link["peer"] == peer).cloned()
    };
    for (socket, peer) in [("first.sock", &name), ("new.sock", &first)] {
        let link = wait_for(&format!("{socket} to have the link"), PATIENCE, || {
            first_process.check_alive()?;
            newcomer.check_alive()?;
            Ok(standing(socket, peer).filter(|link| link["standing"] == "member"))
        })
        .with_context(|| first_process.report() + &newcomer.report())?;
        ensure!(link["plane"] == "kernel", "{link:#}");
    }
    wait_for("the RIB to know both", PATIENCE, || {
        let status = user(&["--socket", "first.sock", "status"])?;
        Ok((status["rib"]["switches"] == 2 && status["domain"]["invitations_used"] == 1).then_some(()))
    })?;

    user(&["--socket", "first.sock", "domain", "revoke", "--key", "home/domain.pem", "new/membership"])?;
    wait_for("the link to be gone", PATIENCE, || Ok(standing("first.sock", &name).is_none().then_some(())))?;
    wait_for("both to say why", PATIENCE, || {
        let said = |process: &Process| process.stderr().contains("revoked: the Invite");
        Ok((said(&first_process) && said(&newcomer)).then_some(()))
    })
    .with_context(|| first_process.report() + &newcomer.report())?;
    // Its key and its line are in no log.
    for process in [&first_process, &newcomer] {
        ensure!(!process.stderr().contains(&token[..40]), "{}", process.report());
    }
    for process in [&mut newcomer, &mut first_process] {
        ensure!(process.stop(PATIENCE)?.success(), "{}", process.report());
    }
    Ok(())
}

fn serve(tools: &Tools, at: &Namespace, label: &str, config: &Path, folder: &Path) -> Result<Process> {
    let mut command = at.command(tools.gdp_ctl()?)?;
    command.args(["serve", "--config"]).arg(config).env("GDP_EBPF_OBJECT", tools.ebpf_object()?);
    Process::spawn(label, command, folder)
}

/// As somebody who pastes the line.
fn join(tools: &Tools, folder: &Path, token: &str) -> Result<Value> {
    let mut command = own(tools.gdp_ctl()?);
    command.args(["-j", "domain", "join", "-", "-o", "new"]).current_dir(folder);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
    child.stdin.take().context("a pipe")?.write_all(token.as_bytes())?;
    let output = child.wait_with_output()?;
    ensure!(output.status.success(), "join failed");
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn ctl(tools: &Tools, folder: &Path, arguments: &[&str]) -> Result<Value> {
    let mut command = own(tools.gdp_ctl()?);
    let output = execute(command.args(arguments).arg("-j").current_dir(folder))?;
    serde_json::from_str(&output).with_context(|| format!("not JSON: {output}"))
}
