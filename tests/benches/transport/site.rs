//! The network of all contenders, and its switch.

use std::net::{Ipv4Addr, SocketAddr};

use anyhow::{Context, Result, ensure};
use gdp_daemon::config::{Config, DataPlane};
use gdp_daemon::serve::{Running, start};
use gdp_faults::Faults;
use gdp_link::link::RekeySchedule;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::measure::cpu;
use gdp_tests::netns::Namespace;
use gdp_tests::wire::Wire;

use crate::Bench;
use crate::inside::{Inside, ROOT};

/// The cable between the switch and the cloud.
pub enum Cable {
    /// A plain cable, the fastest.
    Plain,
    /// A bridge with a port for an attacker.
    Tapped,
    /// A bad link with the same faults in both directions.
    Bad(Faults),
}

/// Robot, switch and cloud.
pub struct Site {
    // Fields drop in this order.
    switch: Option<(Running, Inside)>,
    wire: Option<Wire>,
    chain: Chain,
    _files: tempfile::TempDir,
}

/// One end and its tasks: a single thread on one CPU. Threads that it starts stay on that CPU too.
pub struct End {
    pub inside: Inside,
    /// The end's interface.
    pub interface: &'static str,
    pub address: Ipv4Addr,
    /// The switch's address for frames over UDP.
    pub switch: SocketAddr,
}

/// The source and the destination of messages.
pub struct Ends {
    pub robot: End,
    pub cloud: End,
}

/// The switch's UDP port for frames.
const PORT: u16 = 31_415;

const SEED: u64 = 12;

impl Site {
    pub fn build(cable: Cable, bench: &Bench) -> Result<Self> {
        let wire = (!matches!(cable, Cable::Plain)).then_some(1);
        let chain = Chain::build(ChainOptions { switches: 1, wire, ..Default::default() })?;
        chain.become_ip_routers()?;
        let files = tempfile::tempdir()?;
        let config = Config {
            identity: files.path().join("s1.pem"),
            socket: files.path().join("s1.sock"),
            interfaces: Some(vec!["l0".into(), "r0".into()]),
            all_interfaces: false,
            keep: false,
            udp: Some((Ipv4Addr::UNSPECIFIED, PORT).into()),
            tls: None,
            data_plane: DataPlane::Xdp,
            dpdk: Default::default(),
            rib: true,
            neighbours: Vec::new(),
            ebpf_object: Some(bench.ebpf_object.clone()),
            fib_capacity: 1024,
            bpffs: None,
            domain: None,
            public: Vec::new(),
            etcd: None,
            metrics: None,
            metrics_token: None,
            crypto: None,
            rekey: RekeySchedule::default(),
        };
        let inside = Inside::new(&chain.switches()[0], ROOT)?;
        let running = inside.run(start(config))??;
        let wire = match cable {
            Cable::Bad(faults) => Some(chain.disturb_wire([faults.clone(), faults], SEED)?),
            Cable::Plain | Cable::Tapped => None,
        };
        Ok(Self { switch: Some((running, inside)), wire, chain, _files: files })
    }

    /// Returns new ends on these CPUs.
    pub fn ends(&self, [robot, cloud]: [usize; 2]) -> Result<Ends> {
        let (from, to) = self.chain.ip_ends();
        // The switch's address on either subnet: it is the second host of the robot's, and the
        // first of the cloud's.
        let [from, to]: [Ipv4Addr; 2] = [from.parse()?, to.parse()?];
        let switch = |end: Ipv4Addr, host| (Ipv4Addr::from_octets([10, 9, end.octets()[2], host]), PORT).into();
        let end = |namespace: &Namespace, cpu, interface, address, switch| {
            let inside = Inside::new(namespace, ROOT)?;
            inside.run(async move { cpu::pin(cpu) })??;
            anyhow::Ok(End { inside, interface, address, switch })
        };
        let robot = end(self.chain.robot(), robot, "r0", from, switch(from, 2))?;
        Ok(Ends { robot, cloud: end(self.chain.cloud(), cloud, "l0", to, switch(to, 1))? })
    }

    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Fails if the harness lost frames: a bad cable kept up with its frames, and the switch with
    /// GDP frames.
    pub fn check(&self) -> Result<()> {
        if let Some(wire) = &self.wire {
            wire.check()?;
        }
        let (running, inside) = self.switch.as_ref().context("a site that has not ended")?;
        let status = inside.runtime.block_on(running.status());
        let userspace = status["counters_by_plane"]["delivered"]["userspace"].as_u64().unwrap_or(0);
        ensure!(userspace == 0, "{userspace} frames were forwarded in user space: {}", status["counters_by_plane"]);
        Ok(())
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        if let Some((running, inside)) = self.switch.take() {
            inside.runtime.block_on(running.stop());
        }
    }
}
