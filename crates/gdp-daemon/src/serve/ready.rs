//! The line that reports a ready daemon: what is on, what is off and why, and the command that
//! changes it.

use std::net::SocketAddr;
use std::path::PathBuf;

use gdp_dataplane::{InterfacePlane, Planes, SUPPORTED, host_pair};
use gdp_wire::Name;

/// The resources of a ready daemon.
#[derive(Clone, Debug)]
pub struct Ready {
    pub switch: Name,
    /// Whether this daemon hosts the RIB, or one of its replicas.
    pub rib: bool,
    pub udp: Option<SocketAddr>,
    pub tls: Option<SocketAddr>,
    /// The interfaces with links directly on Ethernet.
    pub ethernet: Vec<String>,
    /// The configured interfaces that are not usable yet.
    pub awaited: Vec<String>,
    /// The data plane of each interface, ordered by interface name.
    pub planes: Vec<InterfacePlane>,
    /// The reason why XDP is off altogether, if it is.
    pub no_xdp: Option<String>,
    /// What the userspace plane handles instead of XDP, and why.
    pub in_userspace: Vec<String>,
    pub socket: PathBuf,
    /// The address that serves metrics, if any.
    pub metrics: Option<SocketAddr>,
}

impl Ready {
    /// Copies the state of the data planes.
    pub(super) fn look_at(&mut self, planes: &Planes) {
        let made = planes.report().into_iter().filter(|plane| !host_pair::is_end(&plane.interface));
        self.planes = made.collect();
        self.no_xdp = planes.xdp().err();
        if self.no_xdp.is_some() {
            // Without XDP, all of it is in userspace.
            self.in_userspace.clear();
            return;
        }
        let families = planes.udp_in_userspace().into_iter().zip(["IPv4", "IPv6"]);
        let is_taken = |family: &str| self.udp.is_some_and(|udp| udp.is_ipv6() || family == "IPv4");
        let families = families.filter(|(_, family)| is_taken(family));
        let left = families.filter_map(|(reason, family)| Some(format!("links over {family}, because {}", reason?)));
        self.in_userspace.extend(left.collect::<Vec<_>>());
    }

    /// Returns the ready line. `command` is the command line that started the daemon, to which
    /// hints add options.
    pub fn line(&self, command: &str) -> String {
        let udp = self.udp.map_or("off, by `udp: null`".into(), |udp| format!("on {udp}"));
        let mut parts = vec![
            format!("switch {}", self.switch),
            format!("RIB: {}", if self.rib { "here" } else { "elsewhere" }),
            format!("links over UDP: {udp}"),
        ];
        parts.extend(self.tls.map(|tls| format!("links over TLS: on TCP {tls}")));
        parts.extend([format!("links on Ethernet: {}", self.on_ethernet(command)), self.by_plane(command)]);
        parts.extend(self.in_userspace.iter().map(|what| format!("in userspace: {what}")));
        parts.extend(self.metrics.map(|metrics| format!("metrics: on http://{metrics}{}", gdp_http::metrics::PATH)));
        parts.push(format!("admin socket: {}", self.socket.display()));
        format!("ready: {}", parts.join("; "))
    }

    fn on_ethernet(&self, command: &str) -> String {
        let on = (!self.ethernet.is_empty()).then(|| format!("on {}", self.ethernet.join(", ")));
        let awaited = (!self.awaited.is_empty()).then(|| format!("waiting for {}", self.awaited.join(", ")));
        match [on, awaited].into_iter().flatten().collect::<Vec<_>>() {
            none if none.is_empty() => format!("off, no interface is named (`{command} --interface DEV`)"),
            some => some.join(", "),
        }
    }

    fn by_plane(&self, command: &str) -> String {
        let is_dpdk = self.planes.iter().any(|plane| plane.kind == "dpdk");
        if let (Some(reason), false) = (&self.no_xdp, is_dpdk) {
            return format!("XDP: off, {reason}");
        }
        let kinds =
            [("dpdk", "on"), ("xdp-native", "native on"), ("xdp-generic", "generic on"), ("userspace", "off on")];
        let planes = kinds.into_iter().flat_map(|(kind, word)| self.groups(kind, word, command)).collect::<Vec<_>>();
        match (is_dpdk, planes.is_empty()) {
            (true, _) => format!("DPDK: {}", planes.join(", ")),
            (_, true) => "XDP: on no interface, none has an address and none is named".into(),
            _ => format!("XDP: {}", planes.join(", ")),
        }
    }

    /// Describes the interfaces of a plane, grouped by reason.
    fn groups(&self, kind: &str, word: &str, command: &str) -> Vec<String> {
        let mut groups: Vec<(&str, Vec<&InterfacePlane>)> = Vec::new();
        for plane in self.planes.iter().filter(|plane| plane.kind == kind) {
            match groups.iter_mut().find(|(reason, _)| *reason == plane.reason) {
                Some((_, group)) => group.push(plane),
                None => groups.push((&plane.reason, vec![plane])),
            }
        }
        let line = |(reason, group): (&str, Vec<&InterfacePlane>)| {
            let left_alone = group.iter().filter(|plane| plane.left_alone);
            let options: String = left_alone.map(|plane| format!(" --interface {}", plane.interface)).collect();
            let reason = Some(reason.to_owned()).filter(|reason| reason != SUPPORTED);
            let remedy = (!options.is_empty()).then(|| format!("`{command}{options}` attaches it"));
            let why: Vec<String> = reason.into_iter().chain(remedy).collect();
            let why = if why.is_empty() { String::new() } else { format!(" ({})", why.join("; ")) };
            let names: Vec<&str> = group.iter().map(|plane| &*plane.interface).collect();
            format!("{word} {}{why}", names.join(", "))
        };
        groups.into_iter().map(line).collect()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/ready.rs"]
mod tests;
