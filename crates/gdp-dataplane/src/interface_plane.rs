//! Report of the plane of an interface, for operators.

/// The plane that serves an interface, and the reason for this choice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InterfacePlane {
    pub interface: String,
    /// `xdp-native`, `xdp-generic`, `dpdk` or `userspace`.
    pub kind: &'static str,
    /// Explanation for the operator.
    pub reason: String,
    /// The daemon would attach XDP, or attempt generic mode, if the operator named the interface.
    pub left_alone: bool,
}

/// Default reason for native XDP on an interface.
pub const SUPPORTED: &str = "the driver supports it";

impl InterfacePlane {
    /// Describes an interface that only the userspace plane serves.
    pub(crate) fn userspace(interface: &str, reason: &str) -> Self {
        Self { interface: interface.to_owned(), kind: "userspace", reason: reason.to_owned(), left_alone: false }
    }

    /// Logs the plane of a new interface.
    pub fn log(&self) {
        let Self { interface, kind, reason, left_alone } = self;
        let remedy = if *left_alone { format!("; `--interface {interface}` has it attached") } else { String::new() };
        tracing::info!("{interface}: data plane {kind}: {reason}{remedy}");
    }
}
