//! A robot whose network lets no UDP out joins as the documentation says, and its topics flow: over
//! TLS, and over a WebSocket through an HTTP proxy.
//!
//! The network is that of [`crate::onboarding`]. The robot's NAT is also its firewall.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::Namespace;
use gdp_tests::process::Process;
use gdp_tests::programs::Program;
use gdp_tests::wait::TIMEOUT;

use crate::onboarding::{Scene, first};

/// Where the robot reaches the HTTP proxy of its network.
const PROXY: &str = "192.168.5.1:3128";

#[test]
fn a_robot_without_udp_joins_and_its_topics_flow_over_tls() -> Result<()> {
    let mut scene = Scene::build()?;
    forbid(&scene.robot.nat, "meta l4proto udp drop")?;
    scene.up_with(&["--tls"])?;
    let line = scene.invite("robot7", &["--expose", "/chatter", "--import", "/cmd_vel"])?;
    ensure!(scene.ctl(&["domain", "show", &line])?.contains("tls://10.9.0.1:443, then wss://10.9.0.1:443"));
    scene.join("robot7", &line)?;
    let joined = scene.members[0].stdout();
    ensure!(joined.contains("at tls://10.9.0.1:443"), "{joined}");
    topics_flow(&scene)?;

    let links = scene.ctl(&["link", "list"])?;
    ensure!(links.contains("tls:10.9.0.2:"), "the peer's own address: {links}");
    let stderr = scene.up.as_ref().context("the server")?.stderr();
    ensure!(stderr.contains("links over TLS: on TCP 0.0.0.0:443"), "{stderr}");
    Ok(())
}

#[test]
fn a_robot_behind_an_http_proxy_joins_and_a_websocket_carries_its_topics() -> Result<()> {
    let mut scene = Scene::build()?;
    forbid(&scene.robot.nat, "meta l4proto { tcp, udp } drop")?;
    scene.up_with(&["--tls"])?;
    let line = scene.invite("robot7", &["--expose", "/chatter", "--import", "/cmd_vel"])?;
    let refused = scene.try_join("robot7", &line, &scene.robot.inside)?;
    ensure!(refused.contains("no path to the domain"), "without the proxy: {refused}");

    let connections = http_proxy(&scene.robot.nat)?;
    let mut joining = scene.join_command("robot7", &line, &scene.robot.inside)?;
    joining.arg("--no-run").env("HTTPS_PROXY", format!("http://{PROXY}"));
    let mut joining = Process::spawn("joining", joining, scene.files.path())?;
    joining.wait_until("the membership", TIMEOUT, |joining| joining.stdout().contains("Leave").then_some(()))?;
    ensure!(connections.load(Ordering::Relaxed) > 0, "the proxy was used");

    // Only the WebSocket is left to the robot.
    let config = scene.files.path().join("robot7/proxy.yaml");
    let text = std::fs::read_to_string(&config)?;
    let wss = text.lines().find_map(|line| Some(line.split_once("wss://")?.1.split_once('}')?.0));
    let links = format!("links: [{{to: \"wss://{}}}]", wss.context("a WebSocket in the configuration")?);
    let lines = text.lines().map(|line| if line.starts_with("links:") { &*links } else { line });
    std::fs::write(&config, lines.collect::<Vec<_>>().join("\n"))?;
    let before = connections.load(Ordering::Relaxed);
    let mut command = scene.robot.inside.command(scene.tools.gdp_proxy()?)?;
    command.arg(&config).env("HTTPS_PROXY", format!("http://{PROXY}"));
    let proxy = Process::spawn("robot7", command, scene.files.path())?;
    scene.members.push(proxy);
    topics_flow(&scene)?;
    ensure!(connections.load(Ordering::Relaxed) > before, "the proxy was used");
    Ok(())
}

/// Both directions carry messages.
fn topics_flow(scene: &Scene) -> Result<()> {
    let robot = &scene.robot.inside;
    let _talker = scene.talk(robot, "rt/chatter", 64, 20.0)?;
    first(&mut scene.listen(&scene.server, "rt/robot7/chatter")?).context("from the robot")?;
    let _commands = scene.talk(&scene.server, "rt/robot7/cmd_vel", 64, 20.0)?;
    first(&mut scene.listen(robot, "rt/cmd_vel")?).context("to the robot")
}

/// Makes a router drop what it would forward and matches the rule.
pub fn forbid(router: &Namespace, rule: &str) -> Result<()> {
    let rules = format!(
        "add table ip wall
         add chain ip wall through {{ type filter hook forward priority -1; }}
         add rule ip wall through {rule}"
    );
    gdp_tests::netns::execute(router.command(Program::Nft)?.arg(rules)).map(drop)
}

/// Ends what [`forbid`] did.
pub fn permit(router: &Namespace) -> Result<()> {
    gdp_tests::netns::execute(router.command(Program::Nft)?.arg("delete table ip wall")).map(drop)
}

/// Starts an HTTP proxy that does CONNECT only, and returns the number of its connections. It ends
/// with the test.
fn http_proxy(at: &Namespace) -> Result<Arc<AtomicUsize>> {
    let (door, connections) = (at.door()?, Arc::<AtomicUsize>::default());
    let listener = {
        let _inside = door.enter()?;
        TcpListener::bind(PROXY)?
    };
    let counted = connections.clone();
    std::thread::spawn(move || {
        for client in listener.incoming().flatten() {
            let inside = door.enter();
            let connected = connect(&client);
            drop(inside);
            if let Ok(server) = connected {
                counted.fetch_add(1, Ordering::Relaxed);
                for (mut from, mut to) in [(client.try_clone(), server.try_clone()), (Ok(server), Ok(client))]
                    .map(|(from, to)| (from.expect("a socket"), to.expect("a socket")))
                {
                    std::thread::spawn(move || {
                        let _ = std::io::copy(&mut from, &mut to);
                        let _ = to.shutdown(Shutdown::Both);
                    });
                }
            }
        }
    });
    Ok(connections)
}

/// Reads a request, connects to where it says, and answers.
fn connect(client: &TcpStream) -> Result<TcpStream> {
    // A client sends nothing more before the answer.
    let mut lines = BufReader::new(client).lines();
    let request = lines.next().context("a request")??;
    while !lines.next().context("a header")??.is_empty() {}
    let to = request.strip_prefix("CONNECT ").and_then(|rest| rest.strip_suffix(" HTTP/1.1"));
    let server = TcpStream::connect(to.context("a CONNECT")?)?;
    (&*client).write_all(b"HTTP/1.1 200 Connection established\r\n\r\n")?;
    Ok(server)
}
