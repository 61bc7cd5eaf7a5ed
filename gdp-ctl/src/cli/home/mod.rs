//! The commands of a domain's administrator: `up`, `invite`, `robots` and `revoke`, and the join
//! service. They keep everything of the domain in one folder.
//!
//! | file | content |
//! | --- | --- |
//! | `domain.pem`, `domain.card` | the domain's key, and its card with the ledger beside it |
//! | `successor.pem` | the key that may sign for the domain if `domain.pem` is lost |
//! | `switch.pem`, `switch.member`, `gdp.yaml` | the switch with the RIB |
//! | `join.pem`, `join.member` | the join service |
//! | `*.renewal` | what lets the join service renew the memberships of the server |
//! | `enrollments`, `renewals` | the newest Enrollment and RenewalDelegation of each label |
//! | `memberships` | memberships that the domain's key signed in exchange for others |
//! | `directory.members` | the members that have joined |
//! | `applications`, `decisions` | machines that ask to join, and what became of them |
//! | `audit.log` | what was issued and revoked, a JSON object a line |
//! | `address` | the address that members dial, and the switch there |
//! | `server/` | keys and configuration of this machine's own proxy |

mod admin;
mod applications;
mod create;
mod enrollments;
mod files;
mod fleet;
mod invite;
mod join_metrics;
mod join_service;
mod members;
mod renewals;
mod revoke;
mod robots;
mod rotate;
mod up;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use gdp_core::card::NameCard;
use gdp_core::link_target::LinkTarget;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

use super::domain::{Authority, DomainLedger};

pub use admin::{BackupOutput, LogOutput};
pub use applications::{ApproveOptions, DecisionOutput, DenyOptions, approve, deny};
pub use fleet::ApplyOutput;
pub use invite::InviteOutput;
#[cfg(test)]
pub use robots::MemberOutput;
pub use robots::{RobotsOutput, robots_of};
pub use rotate::RotationOutput;
pub use {admin::Command as AdminCommand, admin::run as admin};
pub use {fleet::Options as ApplyOptions, fleet::run as apply};
pub use {invite::Options as InviteOptions, invite::run as invite};
pub use {join_service::Options as JoinServiceOptions, join_service::run as join_service};
pub use {revoke::Options as RevokeOptions, revoke::run as revoke};
pub use {robots::Options as RobotsOptions, robots::run as robots};
pub use {up::Options as UpOptions, up::run as up};

/// Label of the invitation with which machines ask to join.
const APPLICANTS: &str = "applicants";

const DAY: u64 = 86400;
const HOUR: u64 = 3600;

#[derive(Clone, Debug, Args)]
pub struct HomeOptions {
    /// Folder of the domain's keys and files. Default: /etc/gdp/home for root, else
    /// ~/.config/gdp/home.
    #[arg(long, value_name = "FOLDER", env = "GDP_HOME")]
    dir: Option<PathBuf>,
    /// Private key of the domain, if it is stored elsewhere, or that of its successor. Default:
    /// domain.pem in the folder.
    #[arg(long, value_name = "FILE", env = "GDP_DOMAIN_KEY")]
    key: Option<PathBuf>,
}

impl HomeOptions {
    fn home(&self) -> anyhow::Result<Home> {
        let default = || Some(gdp_util::folders::configuration()?.join("home"));
        let folder = self.dir.clone().or_else(default).context("no place for the domain: say where with --dir")?;
        if gdp_util::ownership::is_foreign_link(&folder) {
            anyhow::bail!("{} is a symbolic link of another user, and root does not follow it", folder.display());
        }
        Ok(Home { folder, key: self.key.clone() })
    }
}

/// The folder of a domain, and its key's file if that is elsewhere.
struct Home {
    folder: PathBuf,
    key: Option<PathBuf>,
}

/// Where members find the domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct DomainAddress {
    at: String,
    switch: Name,
    /// Address and port of the switch on this machine.
    udp: SocketAddr,
    /// Address and port of the switch for links over TLS, if it takes them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tls: Option<SocketAddr>,
    /// Whether the switch may attach XDP programs.
    xdp: bool,
    /// Seconds for which a membership lasts without a renewal.
    #[serde(default = "default_lifetime")]
    lifetime: u64,
}

fn default_lifetime() -> u64 {
    60 * DAY
}

impl Home {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn folder(&self) -> &Path {
        &self.folder
    }

    /// Opens the domain's key and ledger, and locks them.
    fn authority(&self) -> anyhow::Result<Authority> {
        self.check_exists()?;
        let key = self.key.clone().unwrap_or_else(|| self.path("domain.pem"));
        if !key.exists() {
            anyhow::bail!(
                "the domain's key is needed and {} does not exist: say where it is with --key",
                key.display()
            );
        }
        Authority::open(&key, Some(&self.path("domain.card")))
    }

    /// Opens the ledger without the domain's key, and locks it.
    fn ledger(&self) -> anyhow::Result<DomainLedger> {
        self.check_exists()?;
        DomainLedger::open(&self.path("domain.card"))
    }

    fn check_exists(&self) -> anyhow::Result<()> {
        if !self.path("domain.card").exists() {
            let folder = self.folder.display();
            anyhow::bail!("there is no domain in {folder}: make one with `gdp-ctl up`, or say where with --dir");
        }
        Ok(())
    }

    fn card(&self) -> anyhow::Result<NameCard> {
        Ok(NameCard::load(&self.path("domain.card"))?)
    }

    /// Returns the path of the domain's newest revocation, which exists after the first one.
    fn revocation_path(&self) -> PathBuf {
        self.path("domain.card.revocation")
    }

    fn address(&self) -> anyhow::Result<DomainAddress> {
        let path = self.path("address");
        let text = std::fs::read_to_string(&path).with_context(|| format!("{}: run `gdp-ctl up`", path.display()))?;
        serde_json::from_str(&text).with_context(|| path.display().to_string())
    }
}

impl DomainAddress {
    /// Returns where programs on this machine reach the switch.
    fn local(&self) -> LinkTarget {
        let ip = if self.udp.ip().is_unspecified() { IpAddr::V4(Ipv4Addr::LOCALHOST) } else { self.udp.ip() };
        let (host, port) = (ip.to_string(), self.udp.port());
        LinkTarget::Udp { host, port, interface: None }
    }

    fn target(&self) -> anyhow::Result<LinkTarget> {
        self.at.parse().with_context(|| format!("address: {} is no address", self.at))
    }

    /// Returns where members reach the switch if no UDP passes: inside TLS, and inside a WebSocket,
    /// because some proxies pass only HTTP.
    fn tls_targets(&self) -> anyhow::Result<Vec<LinkTarget>> {
        let (LinkTarget::Udp { host, .. }, Some(tls)) = (self.target()?, self.tls) else { return Ok(Vec::new()) };
        let target = |websocket| LinkTarget::Tls { host: host.clone(), port: tls.port(), websocket };
        Ok([false, true].map(target).into())
    }
}
