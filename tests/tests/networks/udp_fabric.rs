//! Daemons and SDK nodes over Ethernet, IPv4 and IPv6, with a router between the daemons:
//!
//! ```text
//!   robot:e0 ──── l0:edge:r0 ──── s0:router:c0 ──── e0:cloud:f0 ──── e0:far
//!    writer       switch, 10.1.0.1           switch, RIB, 10.2.0.9   reader
//!    Ethernet                UDP over IPv4              UDP over IPv6
//! ```

use std::path::Path;

use anyhow::{Context, Result, ensure};
use gdp::unstable::{Node, NodeConfig, PublishOptions, SubscribeOptions};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::config::{Config, DataPlane, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_dataplane::dpdk::{DpdkConfig, DpdkPort};
use gdp_e2e::seal::Encoding;
use gdp_tests::Tools;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::Value;

use crate::inside::{Inside, ROOT};

#[test]
fn messages_cross_three_carriers_without_leaving_the_kernel() -> Result<()> {
    messages_cross_three_carriers(DataPlane::Xdp, "kernel")
}

/// DPDK owns the interfaces of both switches. The kernel retains addresses, ARP, neighbour
/// discovery and QUIC.
#[test]
fn messages_cross_three_carriers_in_dpdk() -> Result<()> {
    messages_cross_three_carriers(DataPlane::Dpdk, "dpdk")
}

/// Sends small messages, one that is split into many frames, and small ones again. `plane`: the
/// forwarding plane's name in the status.
fn messages_cross_three_carriers(data_plane: DataPlane, plane: &str) -> Result<()> {
    let site = Site::build()?;
    let folder = tempfile::tempdir()?;
    let [edge, cloud] = site.start_switches(folder.path(), data_plane)?;
    let owner = SigningKey::generate()?;
    let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None)?;
    let (robot, far) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
    let (name, not_before, not_after) = (card.name(), 0, 4_000_000_000);
    let (to, serial) = (Grantee::Entity(far.name()), 1);
    let grant = issue(&owner, &ReadGrant { name, to, serial, not_before, not_after })?.into();
    let cert = AdCert { name, entity: robot.name(), scope: vec![], serial, not_before, not_after };
    let cert = issue(&owner, &cert)?.into();

    let reader = Inside::new(&site.far, ROOT)?;
    let reading = reader.run(Node::connect(NodeConfig::new(far, "udp://[2001:db8:3::9]:31415".parse()?)))??;
    let subscribe = reading.subscribe(card.proof(), grant, SubscribeOptions::reliable());
    let mut subscription = reader.runtime.block_on(subscribe)?;
    let writer = Inside::new(&site.robot, ROOT)?;
    let writing = writer.run(Node::connect(NodeConfig::new(robot, "eth://e0".parse()?)))??;
    let mut publisher = writer.runtime.block_on(writing.publish(card.proof(), cert, PublishOptions::reliable()))?;
    let mut exchange = |body: &[u8]| -> Result<()> {
        writer.runtime.block_on(publisher.send(Encoding::Bytes, body))?;
        let next = reader.runtime.block_on(async { tokio::time::timeout(TIMEOUT, subscription.recv()).await });
        let message = next.context("not received")?.context("a live subscription")?;
        ensure!(message.body == body, "another message");
        Ok(())
    };
    exchange(b"first").context("a first message")?;
    // The first frames determine the path's MTU.
    exchange(&vec![7; 1 << 18]).context("a large message")?;
    for i in 0..50u32 {
        exchange(&i.to_be_bytes()).with_context(|| format!("message {i}"))?;
    }
    for (switch, to) in [(&edge, "forwarded"), (&cloud, "delivered")] {
        let status = switch.status();
        let count = |plane: &str| status["counters_by_plane"][to][plane].as_u64().unwrap_or(0);
        ensure!(count(plane) > 200 && count("userspace") < 10, "{}", status["counters_by_plane"]);
    }
    writer.runtime.block_on(writing.close());
    reader.runtime.block_on(reading.close());
    [edge, cloud].into_iter().for_each(Switch::stop);
    Ok(())
}

/// Returns the DPDK ports of a switch. Both switches share this process, where device names must be
/// unique.
fn devices(label: &str) -> Vec<DpdkPort> {
    let interfaces = if label == "edge" { ["l0", "r0"] } else { ["e0", "f0"] };
    let port = |interface| DpdkPort {
        interface: format!("g{interface}"),
        device: format!("net_af_packet_{label}_{interface},iface={interface}"),
        mtu: None,
    };
    interfaces.map(port).into()
}

struct Switch {
    running: Running,
    inside: Inside,
}

impl Switch {
    fn status(&self) -> Value {
        self.inside.runtime.block_on(self.running.status())
    }

    fn stop(self) {
        self.inside.runtime.block_on(self.running.stop());
    }
}

struct Site {
    robot: Namespace,
    edge: Namespace,
    _router: Namespace,
    cloud: Namespace,
    far: Namespace,
}

impl Site {
    fn build() -> Result<Self> {
        let [robot, edge, router, cloud, far] = ["robot", "edge", "router", "cloud", "far"].map(Namespace::create);
        let (robot, edge, router, cloud, far) = (robot?, edge?, router?, cloud?, far?);
        [&cloud, &far].into_iter().try_for_each(|side| side.enable_ipv6())?;
        let end = |namespace, interface, number| End { namespace, interface, mac: [2, 0, 0, 0, 0, number] };
        veth(&end(&robot, "e0", 1), &end(&edge, "l0", 2), 1500)?;
        veth(&end(&edge, "r0", 3), &end(&router, "s0", 4), 1500)?;
        veth(&end(&router, "c0", 5), &end(&cloud, "e0", 6), 1500)?;
        veth(&end(&cloud, "f0", 7), &end(&far, "e0", 8), 1500)?;
        for (side, interface) in [(&robot, "e0"), (&router, "s0"), (&router, "c0"), (&far, "e0")] {
            for state in ["off", "on"] {
                execute(side.command(Program::Ethtool)?.args(["-K", interface, "gro", state]))?;
            }
        }
        for (side, command) in [
            (&edge, "addr add 10.1.0.1/24 dev r0"),
            (&router, "addr add 10.1.0.254/24 dev s0"),
            (&router, "addr add 10.2.0.254/24 dev c0"),
            (&cloud, "addr add 10.2.0.9/24 dev e0"),
            (&cloud, "addr add 2001:db8:3::9/64 dev f0"),
            (&far, "addr add 2001:db8:3::1/64 dev e0"),
            (&edge, "route add default via 10.1.0.254"),
            (&cloud, "route add 10.1.0.0/24 via 10.2.0.254"),
        ] {
            side.ip(&command.split(' ').collect::<Vec<_>>())?;
        }
        {
            let _inside = router.enter()?;
            std::fs::write("/proc/sys/net/ipv4/ip_forward", "1")?;
        }
        Ok(Self { robot, edge, _router: router, cloud, far })
    }

    /// Moves the kernel's addresses from the interfaces to the ports.
    fn give_addresses_to_dpdk(&self) -> Result<()> {
        for (side, commands) in [
            (
                &self.edge,
                &["addr flush dev r0", "addr add 10.1.0.1/24 dev gr0", "route add default via 10.1.0.254"][..],
            ),
            (
                &self.cloud,
                &[
                    "addr flush dev e0",
                    "addr flush dev f0",
                    "addr add 10.2.0.9/24 dev ge0",
                    "addr add 2001:db8:3::9/64 dev gf0 nodad",
                    "route add 10.1.0.0/24 via 10.2.0.254",
                ],
            ),
        ] {
            for command in commands {
                side.ip(&command.split(' ').collect::<Vec<_>>())?;
            }
        }
        Ok(())
    }

    /// Starts the edge and the cloud, with a link between them.
    fn start_switches(&self, folder: &Path, data_plane: DataPlane) -> Result<[Switch; 2]> {
        let ebpf_object = Some(Tools::beside_this_test()?.ebpf_object()?);
        let identity = |label: &str| folder.join(format!("{label}.pem"));
        let place = |label: &str, addr: &str| -> Result<NeighbourAddress> {
            let switch = Identity::load_or_generate(&identity(label), "switch")?.name();
            Ok(NeighbourAddress { switch, via: Via::Udp(addr.parse()?) })
        };
        let (edge, cloud) = (place("edge", "10.1.0.1:31415")?, place("cloud", "10.2.0.9:31415")?);
        let config = |label: &str, near: &NeighbourAddress, bind: &str| -> Result<Config> {
            Ok(Config {
                identity: identity(label),
                socket: folder.join(format!("{label}.sock")),
                all_interfaces: false,
                keep: false,
                interfaces: Some(match (label, data_plane) {
                    ("edge", DataPlane::Dpdk) => vec!["gl0".into()],
                    ("edge", _) => vec!["l0".into()],
                    _ => vec![],
                }),
                udp: Some(bind.parse()?),
                tls: None,
                data_plane,
                dpdk: DpdkConfig { ports: devices(label), ..DpdkConfig::default() },
                rib: label == "cloud",
                neighbours: vec![Neighbour {
                    address: near.clone(),
                    cost: None,
                    dial: false,
                    parent: false,
                    tls: None,
                }],
                ebpf_object: ebpf_object.clone(),
                fib_capacity: 1024,
                bpffs: None,
                domain: None,
                public: Vec::new(),
                etcd: None,
                metrics: None,
                metrics_token: None,
                crypto: None,
                rekey: Default::default(),
            })
        };
        let switch = |namespace: &Namespace, config: Config| -> Result<Switch> {
            let inside = Inside::new(namespace, ROOT)?;
            Ok(Switch { running: inside.run(start(config))??, inside })
        };
        let switches = [
            switch(&self.edge, config("edge", &cloud, "0.0.0.0:31415")?)?,
            switch(&self.cloud, config("cloud", &edge, "[::]:31415")?)?,
        ];
        if data_plane == DataPlane::Dpdk {
            self.give_addresses_to_dpdk()?;
        }
        wait_for("the switches to be neighbours", TIMEOUT, || {
            let linked = |switch: &Switch| switch.status()["links"].as_array().is_some_and(|links| links.len() == 1);
            Ok(switches.iter().all(linked).then_some(()))
        })?;
        Ok(switches)
    }
}
