//! Kernel structure offsets for the programs that count lost redirects. They locate the index of an
//! interface and its network namespace. The daemon finds them in the kernel's BTF; the eBPF object
//! reads them.

/// Byte offsets in structures of the kernel, and the namespace of the watched interfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct NetDevices {
    /// Inode number of the network namespace, because interface indices repeat across namespaces.
    /// 0: count nothing.
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
