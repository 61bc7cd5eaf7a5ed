//! What is known of a network interface.

/// An interface, as the kernel describes it.
#[derive(Clone, Debug)]
pub struct Interface {
    pub name: String,
    pub index: u32,
    pub mac: [u8; 6],
    /// Bytes after the Ethernet header.
    pub mtu: u32,
    /// The VLAN, if the interface is a VLAN on another interface.
    pub vlan: Option<Vlan>,
}

/// A VLAN on an interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vlan {
    /// Name of the interface that carries the tagged frames.
    pub lower: String,
    /// Index of `lower`.
    pub lower_index: u32,
    /// The IEEE 802.1Q VLAN id.
    pub id: u16,
}
