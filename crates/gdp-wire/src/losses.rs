//! What the programs that count lost redirects must know of the running kernel: where in its
//! structures the number of an interface and that of its network namespace are. Found in the
//! kernel's BTF by the daemon, read by the eBPF object.

/// Byte offsets in structures of the kernel, and the namespace whose interfaces count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct NetDevices {
    /// Inode number of the network namespace; numbers of interfaces repeat in others. 0: count
    /// nothing.
    pub namespace: u32,
    /// `struct net_device`, `ifindex`: 4 bytes.
    pub ifindex: u32,
    /// `struct net_device`, `nd_net.net`: a pointer to a `struct net`.
    pub net: u32,
    /// `struct net`, `ns.inum`: 4 bytes.
    pub inum: u32,
}

#[cfg(feature = "aya")]
// SAFETY: plain integers in `repr(C)` without padding.
unsafe impl aya::Pod for NetDevices {}
