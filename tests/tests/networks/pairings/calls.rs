//! Every client with every server, of rospy, Cyclone DDS and Fast DDS; and an rclpy action on Fast
//! DDS. No other vendor has installable programs with actions: those of ROS 1 are topics, and
//! Cyclone DDS has only its own interface, without ROS's.

use std::os::unix::process::ExitStatusExt;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::netns::Namespace;
use gdp_tests::process::Process;
use serde_json::{Value, json};

use super::site::{Carried, Site, Vendor};

/// Limit with everything started at once on two cores.
const TIMEOUT: Duration = Duration::from_secs(90);

/// Time that a server has to end by itself.
const PATIENCE: Duration = Duration::from_secs(20);

/// The service of each vendor's server.
const SERVICE: &str = "lamp";

const ACTION: &str = "/fibonacci";

#[test]
fn every_client_calls_every_server_and_sees_it_go_and_an_action_runs_its_course() -> Result<()> {
    let mut site = start()?;
    let action = fibonacci(&site, &site.robot, "server", &["compute", ACTION, "0.1"])?;
    let mut patient = fibonacci(&site, &site.new, "patient", &["send", ACTION, "20"])?;
    let mut hasty = fibonacci(&site, &site.new, "hasty", &["send", ACTION, "1000", "3"])?;
    let services = Vendor::ALL.map(|server| server.name(SERVICE));
    let servers = Vendor::ALL.map(|vendor| service(&site, vendor, "switch", &[vendor.name(SERVICE)]));
    let mut servers = servers.into_iter().collect::<Result<Vec<_>>>()?;
    let clients = Vendor::ALL.map(|vendor| service(&site, vendor, "set", &services));
    let mut clients = clients.into_iter().collect::<Result<Vec<_>>>()?;
    site.programs.push(action);

    let answers: Vec<Value> = services.iter().flat_map(|service| answers(service)).collect();
    for client in &mut clients {
        lines(&site, client, answers.len())?;
    }
    feedback_and_results(&mut patient, &mut hasty).with_context(|| site.report())?;
    for client in &clients {
        // Each answer arrived once, and no server disappeared meanwhile.
        ensure!(client.json_lines() == answers, "{}\n{}", client.report(), site.report());
    }
    site.check_alive()?;

    for (vendor, server) in Vendor::ALL.into_iter().zip(&mut servers) {
        let status = server.stop(PATIENCE)?;
        // In some runs rclpy does not end by SIGTERM. Its clients miss it when its lease ends.
        let was_killed = vendor == Vendor::FastDds && status.signal() == Some(libc::SIGKILL);
        ensure!(status.success() || was_killed, "{status}\n{}", server.report());
    }
    for client in &mut clients {
        let said = lines(&site, client, answers.len() + services.len())?;
        let gone = services.iter().all(|service| said.contains(&json!({"event": "gone", "service": service})));
        ensure!(gone, "{}\n{}", client.report(), site.report());
    }
    site.check_alive()
}

/// One goal yields twenty numbers, each with feedback; the other is cancelled after three.
fn feedback_and_results(patient: &mut Process, hasty: &mut Process) -> Result<()> {
    let result = hasty.wait_event("result", TIMEOUT)?;
    ensure!(result["status"] == "canceled" && result["shown"] == "canceled", "{}", hasty.report());
    ensure!(hasty.wait_event("canceling", TIMEOUT)?["goals"] == 1, "{}", hasty.report());
    let result = patient.wait_event("result", TIMEOUT)?;
    let whole = result["status"] == "succeeded" && result["shown"] == "succeeded" && result["length"] == 20;
    ensure!(whole, "{}", patient.report());
    // Feedback stays in order, but may arrive after the result, which another topic carries.
    let heard = patient.wait_until("the last feedback", TIMEOUT, |patient| {
        let lines = patient.json_lines();
        let feedback = lines.iter().filter(|line| line["event"] == "feedback");
        let lengths: Vec<u64> = feedback.filter_map(|line| line["length"].as_u64()).collect();
        lengths.ends_with(&[20]).then_some(lengths)
    })?;
    // The first ones may precede ROS's discovery of the listener, as with a server next to the
    // client.
    let all: Vec<u64> = (heard[0]..=20).collect();
    ensure!(heard == all && heard[0] < 10, "each, in order, and not {heard:?}");
    Ok(())
}

/// Returns a client's output for a service: it is switched on, then off.
fn answers(service: &str) -> [Value; 2] {
    [(true, "on"), (false, "off")].map(|(success, is)| {
        json!({"event": "response", "service": service, "success": success, "message": format!("{service} is {is}")})
    })
}

/// Returns a program's output once it has this many lines.
fn lines(site: &Site, program: &mut Process, count: usize) -> Result<Vec<Value>> {
    let said = program.wait_until(&format!("{count} lines"), TIMEOUT, |program| {
        Some(program.json_lines()).filter(|lines| lines.len() >= count)
    });
    said.with_context(|| site.report())
}

/// Starts the network, and the proxies that carry each vendor's service and the action.
fn start() -> Result<Site> {
    let service = |source: Vendor| Carried {
        what: "service",
        name: source.name(SERVICE),
        kind: "std_srvs/srv/SetBool".into(),
        source,
    };
    let kind = "test_msgs/action/Fibonacci".into();
    let action = Carried { what: "action", name: ACTION.into(), kind, source: Vendor::FastDds };
    let carried: Vec<Carried> = Vendor::ALL.map(service).into_iter().chain([action]).collect();
    Site::start(Tools::beside_this_test()?, Site::files()?, &carried, json!({}))
}

/// Starts a server (`switch`), or a client of all these services (`set`).
fn service(site: &Site, vendor: Vendor, verb: &str, services: &[String]) -> Result<Process> {
    let at = if verb == "switch" { &site.robot } else { site.sink(vendor) };
    let mut command = match vendor {
        Vendor::Rospy => site.ros1(at, "rospy_service.py")?,
        Vendor::Cyclone => site.python(at, "cyclone_service.py")?,
        Vendor::FastDds => site.python(at, "rclpy_service.py")?,
    };
    command.args([verb, "--service"]).args(services);
    site.spawn(&format!("{}-{verb}", vendor.label()), command)
}

/// Starts an rclpy node, which the proxy's tests use as well.
fn fibonacci(site: &Site, at: &Namespace, name: &str, arguments: &[&str]) -> Result<Process> {
    let mut command = site.python(at, "../../gdp-proxy/tests/calls/peer.py")?;
    command.arg(name).args(arguments);
    site.spawn(name, command)
}
