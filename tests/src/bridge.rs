//! A cable with a kernel bridge in its middle, in a namespace of its own:
//!
//! ```text
//!  left ── w0 br0 w1 ── right
//! ```
//!
//! Both ends keep their carrier when the bridge passes nothing. Native XDP forwards frames past
//! every capture point. A bridge makes the frames visible and lets a test inject others.

use anyhow::Result;

use crate::netns::{End, Namespace, veth};

/// The interfaces of the bridge's namespace: the bridge, and its ports.
pub const BRIDGE: &str = "br0";
pub const LEFT: &str = "w0";
pub const RIGHT: &str = "w1";

/// The cable. Dropping it deletes it.
pub struct BridgedCable(Namespace);

impl BridgedCable {
    /// Lays a cable between two ends.
    pub fn lay(left: &End, right: &End, mtu: u32) -> Result<Self> {
        let at = Namespace::create("wire")?;
        at.ip(&[
            "link",
            "add",
            BRIDGE,
            "type",
            "bridge",
            "mcast_snooping",
            "0",
            "stp_state",
            "0",
            "forward_delay",
            "0",
        ])?;
        for (end, interface, number) in [(left, LEFT, 3), (right, RIGHT, 4)] {
            veth(end, &End { namespace: &at, interface, mac: [0x02, 0, 0, 0, 0xff, number] }, mtu)?;
            at.ip(&["link", "set", interface, "master", BRIDGE])?;
        }
        at.ip(&["link", "set", BRIDGE, "up"])?;
        Ok(Self(at))
    }

    pub fn namespace(&self) -> &Namespace {
        &self.0
    }

    /// Blocks every frame, or lets all frames pass again.
    pub fn cut(&self, cut: bool) -> Result<()> {
        let isolated = if cut { "on" } else { "off" };
        [LEFT, RIGHT].into_iter().try_for_each(|port| {
            self.0.ip(&["link", "set", port, "type", "bridge_slave", "isolated", isolated]).map(drop)
        })
    }
}
