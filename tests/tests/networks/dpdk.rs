//! DPDK in real networks: ROS messages across its switches, alone and between others; the host
//! behind its ports; the cost of idle loops. Single frames are tested in `generated` and `kernel`,
//! links over UDP in `udp_fabric`.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_dataplane::dpdk::{DpdkConfig, DpdkPort};
use gdp_dataplane::{PlaneConfig, PlaneError, Planes, Wanted};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::peers::{Conversation, Side, Traffic, Vendor};
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::Value;

#[test]
fn messages_cross_three_switches_in_dpdk() -> Result<()> {
    messages_cross(&["net_af_packet"], 1500)
}

#[test]
fn messages_cross_three_switches_in_dpdk_in_large_frames() -> Result<()> {
    messages_cross(&["net_af_packet"], 4016)
}

#[test]
fn messages_cross_three_switches_in_dpdk_by_af_xdp() -> Result<()> {
    messages_cross(&["net_af_xdp"], 1500)
}

#[test]
fn messages_cross_a_switch_of_each_plane() -> Result<()> {
    messages_cross(&["xdp", "net_af_packet", "userspace"], 1500)
}

/// Sends messages of many frames, each as large as the MTU, between two vendors' programs. Every
/// switch must forward in its configured plane.
fn messages_cross(data_planes: &'static [&'static str], mtu: u32) -> Result<()> {
    let chain = ChainOptions { mtu, ..Default::default() };
    let options = FabricOptions { chain, data_planes, ..Default::default() };
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    fabric.start_proxies()?;
    let traffic = Traffic { count: 20, size: 100_000, ..Default::default() };
    let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
    let started = Conversation::start(&fabric.tools, talks, hears, fabric.folder());
    let mut both = started.with_context(|| fabric.report())?;
    both.open()?;
    let messages = both.finish(TIMEOUT, TIMEOUT).with_context(|| fabric.report())?;
    let complete = messages.len() as u64 == traffic.count && messages.iter().all(|message| message.intact);
    ensure!(complete, "{messages:?}\n{}", fabric.report());
    // Headers take a few per cent of a frame, and other frames add to the count.
    let frames = traffic.count * traffic.size as u64 / u64::from(mtu);
    for i in 0..fabric.switches.len() {
        let status = fabric.status(i)?;
        let (first, reported) = match data_planes[i % data_planes.len()] {
            "userspace" => ("userspace", "userspace"),
            "xdp" => ("kernel", "xdp-native"),
            _ => ("dpdk", "dpdk"),
        };
        let sent = |plane: &str| -> u64 {
            let of = |counter: &str| status["counters_by_plane"][counter][plane].as_u64().unwrap_or(0);
            of("forwarded") + of("delivered")
        };
        ensure!(status["data_plane"] == reported, "s{}: {status:#}", i + 1);
        ensure!(sent(first) > frames, "s{}: {:#}", i + 1, status["counters_by_plane"]);
        // The statistics of the robot's proxy are up to a second old.
        wait_for(&format!("s{} to have sent each frame once", i + 1), TIMEOUT, || {
            let given = fabric.proxy_stats("robot")["topics"][0]["fabric"]["frames"].as_u64().unwrap_or(0);
            Ok((sent(first) < given + frames / 2).then_some(()))
        })
        .with_context(|| fabric.report())?;
        ensure!(first == "userspace" || sent("userspace") == 0, "s{}: {:#}", i + 1, status["counters_by_plane"]);
        ensure!(errors(&status).is_empty(), "s{}: {:?}", i + 1, errors(&status));
    }
    Ok(())
}

fn errors(status: &Value) -> Vec<String> {
    status["errors"].as_array().into_iter().flatten().map(Value::to_string).collect()
}

/// The host's addresses are on its side of the port. The host answers ARP, datagrams and
/// connections once each, and what it sends arrives. The same holds with a driver that leaves all
/// packets visible to the kernel.
#[test]
fn the_host_is_reached_through_a_port() -> Result<()> {
    for driver in gdp_tests::dpdk::DRIVERS {
        let site = Site::build()?;
        let _planes = site.planes(driver)?;
        site.host.ip(&["addr", "add", "10.7.0.2/24", "dev", HOST])?;
        ensure!(site.host.ip(&["link", "show", HOST])?.contains("MULTICAST,UP"), "DDS looks for it");
        let (udp, tcp) = {
            let _inside = site.host.enter()?;
            (UdpSocket::bind("10.7.0.2:7000")?, TcpListener::bind("10.7.0.2:7000")?)
        };
        let _inside = site.other.enter()?;
        let asking = UdpSocket::bind("10.7.0.1:0")?;
        let mut buffer = [0; 2000];
        for i in 0..20u8 {
            asking.send_to(&[i; 1200], "10.7.0.2:7000")?;
            udp.set_read_timeout(Some(TIMEOUT))?;
            let (length, from) = udp.recv_from(&mut buffer).with_context(|| format!("{driver}: datagram {i}"))?;
            ensure!(buffer[..length] == [i; 1200], "{driver}: another datagram");
            udp.send_to(&[i], from)?;
            asking.set_read_timeout(Some(TIMEOUT))?;
            ensure!(asking.recv(&mut buffer)? == 1 && buffer[0] == i, "{driver}: answer {i}");
        }
        udp.set_read_timeout(Some(Duration::from_millis(50)))?;
        ensure!(udp.recv_from(&mut buffer).is_err(), "{driver}: a datagram came twice");

        stream(&tcp).with_context(|| format!("{driver}: over TCP"))?;
        ensure!(site.truncated()? == 0, "{driver}: packets arrived joined, and were cut off");
    }
    Ok(())
}

/// Sends some megabytes over TCP to the host, from the calling thread's namespace. This is fast
/// unless segments are lost.
fn stream(to: &TcpListener) -> Result<()> {
    let mut near = TcpStream::connect("10.7.0.2:7000").context("no connection")?;
    let (mut far, _) = to.accept()?;
    let sent = vec![0x5a; 3_000_000];
    let writing = std::thread::spawn(move || near.write_all(&sent).map(|()| near));
    let mut received = vec![0; 3_000_000];
    far.set_read_timeout(Some(TIMEOUT))?;
    far.read_exact(&mut received)?;
    ensure!(received.iter().all(|byte| *byte == 0x5a), "other bytes");
    drop(writing.join().expect("no panic")?);
    Ok(())
}

/// Each loop has a queue of the device; a datagram's flow selects its queue. Connections lose no
/// segments either.
#[test]
fn loops_share_a_port() -> Result<()> {
    let site = Site::build()?;
    let planes = site.planes_on("net_af_packet0,iface=r0,qpairs=2", vec![0, 1])?;
    ensure!(planes.dpdk_processor_time().len() == 2, "a loop for each core");
    site.host.ip(&["addr", "add", "10.7.0.2/24", "dev", HOST])?;
    let (hears, tcp) = {
        let _inside = site.host.enter()?;
        (UdpSocket::bind("10.7.0.2:7000")?, TcpListener::bind("10.7.0.2:7000")?)
    };
    hears.set_read_timeout(Some(TIMEOUT))?;
    let _inside = site.other.enter()?;
    let mut buffer = [0; 2000];
    for flow in 0..40u8 {
        let asks = UdpSocket::bind("10.7.0.1:0")?;
        asks.set_read_timeout(Some(TIMEOUT))?;
        asks.send_to(&[flow], "10.7.0.2:7000")?;
        let (length, from) = hears.recv_from(&mut buffer).with_context(|| format!("flow {flow}"))?;
        ensure!(buffer[..length] == [flow], "another datagram");
        hears.send_to(&[flow], from)?;
        ensure!(asks.recv(&mut buffer)? == 1 && buffer[0] == flow, "answer {flow}");
    }
    for connection in 0..8 {
        stream(&tcp).with_context(|| format!("connection {connection}"))?;
    }
    ensure!(site.truncated()? == 0, "packets arrived joined, and were cut off");
    Ok(())
}

/// Packets of the host as large as the MTU cross in both directions, including the largest MTU of
/// the device's frames. Afterwards the device's interface has its original MTU again.
#[test]
fn large_packets_reach_the_host() -> Result<()> {
    let site = Site::build()?;
    site.other.ip(&["link", "set", "l0", "mtu", "4016"])?;
    let mtu =
        |interface: &str| -> Result<bool> { Ok(site.host.ip(&["link", "show", interface])?.contains("mtu 4016 ")) };
    let planes = {
        let _inside = site.host.enter()?;
        Planes::open(config(vec![port("net_af_packet0,iface=r0,framesz=4096,blocksz=4096", Some(4016))]))?
    };
    ensure!(mtu("r0")? && mtu(HOST)?);
    site.host.ip(&["addr", "add", "10.7.0.2/24", "dev", HOST])?;
    let hears = {
        let _inside = site.host.enter()?;
        UdpSocket::bind("10.7.0.2:7000")?
    };
    {
        let _inside = site.other.enter()?;
        let asks = UdpSocket::bind("10.7.0.1:0")?;
        let mut buffer = [0; 5000];
        for length in [3000, 4016 - 28] {
            asks.send_to(&vec![7; length], "10.7.0.2:7000")?;
            hears.set_read_timeout(Some(TIMEOUT))?;
            let (received, from) = hears.recv_from(&mut buffer).with_context(|| format!("{length} B"))?;
            ensure!(buffer[..received] == vec![7; length], "another datagram of {received} B");
            hears.send_to(&buffer[..received], from)?;
            asks.set_read_timeout(Some(TIMEOUT))?;
            ensure!(asks.recv(&mut buffer)? == length, "an answer of {length} B");
        }
    }
    let _inside = site.host.enter()?;
    drop(planes);
    ensure!(!mtu("r0")?, "the MTU stays");
    Ok(())
}

/// The host's interface loses its carrier when the other end of the device's link disappears, and
/// regains it afterwards.
#[test]
fn the_host_sees_a_cable_that_is_pulled() -> Result<()> {
    for driver in gdp_tests::dpdk::DRIVERS {
        let site = Site::build()?;
        let mut planes = site.planes(driver)?;
        let carrier = || -> Result<bool> { Ok(site.host.ip(&["link", "show", HOST])?.contains("LOWER_UP")) };
        ensure!(carrier()?, "{driver}: at first");
        for up in [false, true, false] {
            site.other.ip(&["link", "set", "l0", if up { "up" } else { "down" }])?;
            let _inside = site.host.enter()?;
            planes.refresh()?;
            ensure!(carrier()? == up, "{driver}: the link is {}", if up { "up" } else { "down" });
        }
        let _inside = site.host.enter()?;
        drop(planes);
    }
    Ok(())
}

/// The interfaces on the host's side report the device's counters.
#[test]
fn devices_tell_what_they_counted() -> Result<()> {
    let site = Site::build()?;
    let planes = site.planes("net_af_packet")?;
    let _inside = site.other.enter()?;
    let sends = UdpSocket::bind("10.7.0.1:0")?;
    // The address has no owner, so only ARP requests arrive.
    sends.send_to(&[0], "10.7.0.2:7000")?;
    let device = wait_for("a packet at the device", TIMEOUT, || {
        let device = *planes.dpdk_devices().get(HOST).context("no device")?;
        Ok((device.received > 0).then_some(device))
    })?;
    ensure!((device.missed, device.failed) == (0, 0), "{device:?}");
    Ok(())
}

/// The loop sleeps between polls, which costs little even in a test build.
#[test]
fn a_loop_without_traffic_leaves_its_core_to_others() -> Result<()> {
    let site = Site::build()?;
    let planes = site.planes("net_af_packet")?;
    let time = || planes.dpdk_processor_time().iter().sum::<Duration>();
    let (start, before) = (Instant::now(), time());
    ensure!(!before.is_zero(), "there is a loop");
    std::thread::sleep(Duration::from_secs(1));
    let share = (time() - before).as_secs_f64() / start.elapsed().as_secs_f64();
    ensure!(share < 0.5, "an idle loop took {:.0} % of a core", 100.0 * share);
    Ok(())
}

/// The host's interface disappears with the plane. The device's settings are restored, and the
/// device can be used again.
#[test]
fn a_plane_that_ends_leaves_nothing() -> Result<()> {
    let site = Site::build()?;
    let settings = || -> Result<Vec<String>> {
        let _inside = site.host.enter()?;
        let paths = ["ipv4/conf/r0/rp_filter", "ipv4/conf/r0/arp_ignore", "ipv6/conf/r0/disable_ipv6"];
        let all = paths.iter().map(|path| Ok(std::fs::read_to_string(format!("/proc/sys/net/{path}"))?));
        all.chain([gro(&site)]).collect()
    };
    let before = settings()?;
    for driver in gdp_tests::dpdk::DRIVERS {
        let planes = site.planes(driver)?;
        ensure!(settings()? != before && site.host.ip(&["link", "show", HOST]).is_ok());
        {
            let _inside = site.host.enter()?;
            drop(planes);
        }
        ensure!(settings()? == before, "{driver}: {:?} instead of {before:?}", settings()?);
        ensure!(site.host.ip(&["link", "show", HOST]).is_err(), "{driver}: {HOST} is still there");
    }
    Ok(())
}

/// Returns the `gro_max_size` of the host's `r0`, as `ip` prints it.
fn gro(site: &Site) -> Result<String> {
    let told = site.host.ip(&["-d", "link", "show", "r0"])?;
    let words = told.split_whitespace().skip_while(|word| *word != "gro_max_size");
    Ok(words.take(2).collect::<Vec<_>>().join(" "))
}

/// A file lists the settings that a killed daemon did not restore. The next daemon restores them,
/// except those that were changed since.
#[test]
fn settings_outlive_a_daemon_that_is_killed() -> Result<()> {
    let site = Site::build()?;
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("run/ctl.settings");
    std::fs::create_dir(folder.path().join("run"))?;
    std::fs::write(&file, "r0 ipv4/rp_filter 2 1\nr0 ipv4/arp_ignore 3 8\nr0 gro_max_size 9000 1\ngone mtu 1 2\n")?;
    site.host.ip(&["link", "set", "r0", "gro_max_size", "1"])?;
    let _inside = site.host.enter()?;
    let setting = |name: &str| std::fs::read_to_string(format!("/proc/sys/net/ipv4/conf/r0/{name}"));
    std::fs::write("/proc/sys/net/ipv4/conf/r0/rp_filter", "1")?;
    std::fs::write("/proc/sys/net/ipv4/conf/r0/arp_ignore", "5")?;
    let open = || {
        let ports = vec![port("net_af_packet0,iface=r0", None)];
        Planes::open(PlaneConfig { dpdk_settings: Some(file.clone()), ..config(ports) })
    };
    let planes = open()?;
    let kept = std::fs::read_to_string(&file)?;
    ensure!(kept.contains("r0 ipv4/rp_filter 2 1\n") && kept.contains("r0 ipv4/arp_ignore 5 8\n"), "{kept}");
    drop(planes);
    ensure!(!file.exists(), "the file stays");
    ensure!((setting("rp_filter")?.trim(), setting("arp_ignore")?.trim()) == ("2", "5"));
    ensure!(gro(&site)? == "gro_max_size 9000", "{}", gro(&site)?);

    std::fs::write(&file, "r0 ipv4/rp_filter 0 2\n")?;
    let other = PlaneConfig { wanted: Wanted::Userspace, dpdk_settings: Some(file.clone()), ..config(vec![]) };
    drop(Planes::open(other.clone())?);
    ensure!(setting("rp_filter")?.trim() == "0" && !file.exists(), "a daemon with another plane puts back nothing");
    std::fs::write(&file, "elsewhere mtu 1500 9000\n")?;
    drop(Planes::open(other)?);
    ensure!(file.exists(), "what could not be put back is forgotten");
    Ok(())
}

#[test]
fn what_dpdk_cannot_drive_is_named() -> Result<()> {
    let site = Site::build()?;
    for (device, needle) in [("net_af_packet9,iface=nowhere", "net_af_packet9"), ("net_nonsense0", "net_nonsense0")] {
        let Err(error) = site.planes_of(device) else { anyhow::bail!("{device} is driven") };
        ensure!(error.to_string().contains(needle) && error.to_string().contains("dpdk"), "{error}");
    }
    let long = DpdkPort { interface: "a-name-that-is-too-long".into(), ..port("net_null9", None) };
    let _inside = site.host.enter()?;
    for (device, mtu, needle) in
        [("net_af_xdp9,iface=r0", 9000, "net_af_xdp9"), ("net_af_packet9,iface=nowhere", 1600, "nowhere")]
    {
        let Err(error) = Planes::open(config(vec![port(device, Some(mtu))])) else { anyhow::bail!("{device}: {mtu}") };
        ensure!(error.to_string().contains(needle) && error.to_string().contains(&format!("MTU of {mtu}")), "{error}");
    }
    let Err(error) = Planes::open(config(vec![long])) else { anyhow::bail!("such a name") };
    ensure!(error.to_string().contains("a-name-that-is-too-long"), "{error}");
    let Err(error) = Planes::open(config(vec![])) else { anyhow::bail!("no ports") };
    ensure!(error.to_string().contains("dpdk.ports"), "{error}");
    Ok(())
}

/// The host's side of its port.
const HOST: &str = "gr0";

/// ```text
///   other:l0 ──── r0:host(:gr0)
/// ```
struct Site {
    other: Namespace,
    host: Namespace,
}

impl Site {
    fn build() -> Result<Self> {
        let (other, host) = (Namespace::create("other")?, Namespace::create("host")?);
        veth(
            &End { namespace: &other, interface: "l0", mac: [2, 0, 0, 0, 7, 1] },
            &End { namespace: &host, interface: "r0", mac: [2, 0, 0, 0, 7, 2] },
            1500,
        )?;
        other.ip(&["addr", "add", "10.7.0.1/24", "dev", "l0"])?;
        Ok(Self { other, host })
    }

    /// Starts planes with the host's `r0` as a device of this driver.
    fn planes(&self, driver: &str) -> Result<Planes> {
        Ok(self.planes_of(&format!("{driver}0,iface=r0"))?)
    }

    fn planes_of(&self, device: &str) -> Result<Planes, PlaneError> {
        self.planes_on(device, Vec::new())
    }

    /// Returns the number of packets that the host received shorter than their headers state.
    fn truncated(&self) -> Result<u64> {
        let _inside = self.host.enter()?;
        let text = std::fs::read_to_string("/proc/thread-self/net/netstat")?;
        let mut lines = text.lines().filter(|line| line.starts_with("IpExt:")).map(str::split_whitespace);
        let (names, values) = lines.next().zip(lines.next()).context("no counters of IP")?;
        let found = names.zip(values).find(|(name, _)| *name == "InTruncatedPkts");
        Ok(found.context("no such counter")?.1.parse()?)
    }

    fn planes_on(&self, device: &str, cores: Vec<usize>) -> Result<Planes, PlaneError> {
        let _inside = self.host.enter().expect("a namespace that is there");
        let mut config = config(vec![port(device, None)]);
        config.dpdk.cores = cores;
        Planes::open(config)
    }
}

fn port(device: &str, mtu: Option<u16>) -> DpdkPort {
    DpdkPort { interface: HOST.into(), device: device.into(), mtu }
}

fn config(ports: Vec<DpdkPort>) -> PlaneConfig {
    let dpdk = DpdkConfig { ports, ..DpdkConfig::default() };
    PlaneConfig { wanted: Wanted::Dpdk, dpdk, ..PlaneConfig::default() }
}
