//! The plane that an interface got, for people.

/// Which plane forwards what arrives on an interface, and why that one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InterfacePlane {
    pub interface: String,
    /// `xdp-native`, `xdp-generic`, `dpdk` or `userspace`.
    pub kind: &'static str,
    /// For people.
    pub reason: String,
    /// XDP would be attached, or attempted in its generic mode, if the interface were named.
    pub left_alone: bool,
}

/// Why native XDP is on an interface, if there is nothing more to say.
pub const SUPPORTED: &str = "the driver supports it";

impl InterfacePlane {
    /// No plane before the userspace plane takes what arrives.
    pub(crate) fn userspace(interface: &str, reason: &str) -> Self {
        Self { interface: interface.to_owned(), kind: "userspace", reason: reason.to_owned(), left_alone: false }
    }

    /// Tells people which plane an interface got that was not there before.
    pub fn log(&self) {
        let Self { interface, kind, reason, left_alone } = self;
        let remedy = if *left_alone { format!("; `--interface {interface}` has it attached") } else { String::new() };
        tracing::info!("{interface}: data plane {kind}: {reason}{remedy}");
    }
}
