//! The harness itself: the features that other tests rely on, without the project's programs.

use std::net::UdpSocket;
use std::time::Duration;

use anyhow::{Result, ensure};
use gdp_tests::Tools;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::packet::GDP_ETHERTYPE;
use gdp_tests::peers::{Conversation, Side, Traffic, Vendor};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::wait::{TIMEOUT, wait_for};

#[test]
fn a_chain_routes_ip_from_end_to_end() -> Result<()> {
    let chain = Chain::build(ChainOptions { wire: Some(1), ..Default::default() })?;
    chain.become_ip_routers()?;
    let (_, cloud) = chain.ip_ends();
    let socket_in = |namespace: &Namespace| -> Result<UdpSocket> {
        let _inside = namespace.enter()?;
        let socket = UdpSocket::bind("0.0.0.0:4000")?;
        socket.set_read_timeout(Some(Duration::from_millis(100)))?;
        Ok(socket)
    };
    let (from, to) = (socket_in(chain.robot())?, socket_in(chain.cloud())?);
    // The bridge in the wire needs a short time before it forwards.
    wait_for("a datagram through three routers", TIMEOUT, || {
        from.send_to(b"hello", (cloud.as_str(), 4000))?;
        Ok(to.recv(&mut [0; 16]).ok())
    })?;
    Ok(())
}

#[test]
fn the_wire_shows_what_passes_and_lets_one_add_to_it() -> Result<()> {
    let chain = Chain::build(ChainOptions { switches: 1, wire: Some(1), ..Default::default() })?;
    let (eavesdropper, attacker) = (chain.wire_from_robot()?, chain.wire_to_cloud()?);
    let switch = gdp_tests::packet::PacketSocket::open(&chain.switches()[0], "r0")?;
    let cloud = gdp_tests::packet::PacketSocket::open(chain.cloud(), "l0")?;
    let ours = |mark: u8| {
        let mut frame = vec![0xff; 12];
        frame.extend(GDP_ETHERTYPE.to_be_bytes());
        frame.resize(80, mark);
        frame
    };
    switch.send(&ours(1))?;
    eavesdropper.receive(TIMEOUT, |frame| frame == ours(1))?;
    attacker.send(&ours(2))?;
    cloud.receive(TIMEOUT, |frame| frame == ours(2))?;
    Ok(())
}

#[test]
fn guards_clean_up_after_a_panic() -> Result<()> {
    let (sender, receiver) = std::sync::mpsc::channel();
    let panicked = std::thread::spawn(move || {
        let namespace = Namespace::create("panic").expect("create");
        let folder = tempfile::tempdir().expect("folder");
        let mut sleep = namespace.command(Program::Sleep).expect("command");
        sleep.arg("1000");
        let process = Process::spawn("sleep", sleep, folder.path()).expect("spawn");
        sender.send((namespace.name().to_owned(), process.pid())).expect("send");
        panic!("on purpose");
    })
    .join()
    .is_err();
    let (name, pid) = receiver.recv()?;
    ensure!(panicked);
    ensure!(!std::path::Path::new("/run/netns").join(&name).exists(), "{name} is still there");
    ensure!(!std::path::Path::new(&format!("/proc/{pid}")).exists(), "{pid} still runs");
    Ok(())
}

#[test]
fn entering_a_namespace_ends_with_its_guard() -> Result<()> {
    let here = std::fs::read_link("/proc/thread-self/ns/net")?;
    let namespace = Namespace::create("enter")?;
    {
        let _inside = namespace.enter()?;
        ensure!(std::fs::read_link("/proc/thread-self/ns/net")? != here);
        let links = execute(Program::Ip.command().args(["-o", "link"]))?;
        ensure!(links.lines().all(|line| !line.contains("eth0")), "{links}");
    }
    ensure!(std::fs::read_link("/proc/thread-self/ns/net")? == here);
    Ok(())
}

/// The peers interoperate without this project: a failure in another test is then this project's.
#[test]
fn the_dds_vendors_understand_each_other() -> Result<()> {
    let tools = Tools::beside_this_test()?;
    for (from, to) in [(Vendor::Cyclone, Vendor::FastDds), (Vendor::FastDds, Vendor::Cyclone)] {
        let site = Namespace::create("site")?;
        site.enable_loopback_multicast()?;
        let folder = tempfile::tempdir()?;
        let traffic = Traffic { count: 5, ..Default::default() };
        let [talks, hears] = [from, to].map(|vendor| Side { at: &site, vendor, traffic: &traffic });
        let mut both = Conversation::start(&tools, talks, hears, folder.path())?;
        both.open()?;
        let messages = both.finish(TIMEOUT, TIMEOUT)?;
        ensure!(messages.len() == 5, "{messages:?}");
        ensure!(messages.iter().all(|m| m.intact && m.bytes == 64), "{messages:?}");
    }
    Ok(())
}
