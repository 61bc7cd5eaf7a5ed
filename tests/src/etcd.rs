//! Real etcd members, each in its own namespace, with addresses that reach one another.

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::netns::{Namespace, execute};
use crate::process::Process;
use crate::programs::Program;
use crate::wait::{TIMEOUT, wait_for};

const CLIENTS: u16 = 2379;
const PEERS: u16 = 2380;

/// Running members of one cluster. Dropping it ends them.
pub struct Etcd {
    members: Vec<Member>,
    folder: PathBuf,
}

struct Member {
    address: Ipv4Addr,
    process: Option<Process>,
}

impl Etcd {
    /// Starts a member at each address; its namespace must have the address. `folder`: the members'
    /// data and output.
    pub fn start(at: &[(&Namespace, Ipv4Addr)], folder: &Path) -> Result<Self> {
        let members = at.iter().map(|(_, address)| Member { address: *address, process: None }).collect();
        let mut etcd = Self { members, folder: folder.to_owned() };
        for (i, (namespace, _)) in at.iter().enumerate() {
            etcd.spawn(i, namespace)?;
        }
        wait_for("the members of etcd to be one cluster", TIMEOUT, || Ok(etcd.leader(at[0].0).ok()))
            .with_context(|| etcd.report())?;
        Ok(etcd)
    }

    /// Returns the section `etcd` of a daemon's configuration.
    pub fn config(&self) -> serde_json::Value {
        serde_json::json!({"endpoints": self.members.iter().map(Member::clients).collect::<Vec<_>>()})
    }

    /// Returns the index of the leader. The query runs in this namespace.
    pub fn leader(&self, from: &Namespace) -> Result<usize> {
        let leads = |member: &Member| -> Result<bool> {
            let mut etcdctl = from.command(Program::Etcdctl)?;
            etcdctl.env("ETCDCTL_API", "3").arg(format!("--endpoints={}", member.clients()));
            let answer = execute(etcdctl.args(["endpoint", "status", "-w", "json"]))?;
            let status = &serde_json::from_str::<serde_json::Value>(&answer)?[0]["Status"];
            Ok(status["header"]["member_id"].is_u64() && status["header"]["member_id"] == status["leader"])
        };
        let running = self.members.iter().enumerate().filter(|(_, member)| member.process.is_some());
        let mut leading = running.filter(|(_, member)| leads(member).unwrap_or(false)).map(|(i, _)| i);
        leading.next().context("no member of etcd leads")
    }

    /// Kills a member, as a machine failure would.
    pub fn kill(&mut self, i: usize) -> Result<()> {
        if let Some(mut process) = self.members[i].process.take() {
            process.kill()?;
        }
        Ok(())
    }

    /// Restarts a killed member with its existing data.
    pub fn start_again(&mut self, i: usize, at: &Namespace) -> Result<()> {
        self.spawn(i, at)
    }

    /// Returns the end of every member's output, for a failure message.
    pub fn report(&self) -> String {
        self.members.iter().filter_map(|member| Some(member.process.as_ref()?.report())).collect::<Vec<_>>().join("\n")
    }

    fn spawn(&mut self, i: usize, at: &Namespace) -> Result<()> {
        let all = self.members.iter().enumerate().map(|(i, member)| format!("m{i}={}", member.peers()));
        let all = all.collect::<Vec<_>>().join(",");
        let member = &self.members[i];
        let mut command = at.command(Program::Etcd)?;
        command
            .arg(format!("--name=m{i}"))
            .arg(format!("--data-dir={}", self.folder.join(format!("m{i}")).display()))
            .arg(format!("--listen-client-urls={}", member.clients()))
            .arg(format!("--advertise-client-urls={}", member.clients()))
            .arg(format!("--listen-peer-urls={}", member.peers()))
            .arg(format!("--initial-advertise-peer-urls={}", member.peers()))
            .arg(format!("--initial-cluster={all}"))
            .arg("--logger=zap");
        let process = Process::spawn(&format!("m{i}"), command, &self.folder);
        self.members[i].process = Some(process.context("etcd: `cargo xtask setup` installs it")?);
        Ok(())
    }
}

impl Member {
    fn clients(&self) -> String {
        format!("http://{}:{CLIENTS}", self.address)
    }

    fn peers(&self) -> String {
        format!("http://{}:{PEERS}", self.address)
    }
}
