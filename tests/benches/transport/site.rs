//! The network of all contenders, and the switch in it.

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

/// What is between the switch and the cloud.
pub enum Cable {
    /// Nothing: the fastest there is.
    Plain,
    /// A bridge, where an attacker may sit.
    Tapped,
    /// A bad link, the same both ways.
    Bad(Faults),
}

/// Robot, switch and cloud.
pub struct Site {
    // Order is the order of the end.
    switch: Option<(Running, Inside)>,
    wire: Option<Wire>,
    chain: Chain,
    _files: tempfile::TempDir,
}

/// One end with what runs there: a single thread that stays on its CPU, as do the threads that it
/// starts.
pub struct End {
    pub inside: Inside,
    /// Its interface.
    pub interface: &'static str,
    pub address: Ipv4Addr,
    /// Where the switch takes frames over UDP.
    pub switch: SocketAddr,
}

/// Where messages come from, and where they go.
pub struct Ends {
    pub robot: End,
    pub cloud: End,
}

/// Of the switch, for frames over UDP.
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
            udp: Some((Ipv4Addr::UNSPECIFIED, PORT).into()),
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

    /// New ends on these CPUs.
    pub fn ends(&self, [robot, cloud]: [usize; 2]) -> Result<Ends> {
        let (from, to) = self.chain.ip_ends();
        // Its address on either subnet: the switch is the second host of the robot's, and the first
        // of the cloud's.
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

    /// Nothing was lost but by what was measured: a bad cable kept up with its frames, and the
    /// switch with those of GDP.
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
