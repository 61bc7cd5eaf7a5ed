//! Frames over UDP that go to the kernel as one piece, on paths that cannot carry them that way:
//!
//! ```text
//!  [ sender  a0 ]────────[ b0  receiver ]
//!   10.9.0.1              10.9.0.2
//! ```
//!
//! Tests without a path are in `crates/gdp-link/tests/unit/port/udp_tests.rs`.

use std::net::SocketAddr;

use anyhow::{Result, ensure};
use gdp_core::identity::Identity;
use gdp_link::port::{LinkAddr, OutFrame, Port, PortConfig, RecvBatch, Sent};
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};

const FRAMES: usize = 500;

#[tokio::test]
async fn runs_arrive_whether_or_not_devices_cut_and_join_them() -> Result<()> {
    let cable = Cable::new()?;
    // Devices that segment, that leave segmentation to the kernel, and that compute no checksums.
    // Without checksums, older kernels refuse runs.
    for (checksums, cut, join) in [("on", "on", "on"), ("on", "off", "off"), ("off", "off", "on"), ("on", "on", "off")]
    {
        cable.set("tx", checksums)?;
        if checksums == "on" {
            cable.set("tx-udp-segmentation", cut)?;
        }
        cable.set("gro", join)?;
        let frames = frames(1400);
        assert_eq!(cable.send(&frames), Sent { sent: FRAMES, lost: 0 }, "{checksums} {cut} {join}");
        cable.expect(&frames)?;
    }
    Ok(())
}

#[tokio::test]
async fn where_the_path_takes_less_too_large_frames_are_lost_and_others_are_not() -> Result<()> {
    let cable = Cable::new()?;
    cable.sender.ip(&["link", "set", "a0", "mtu", "1280"])?;
    let (large, small) = (frames(1400), frames(1280 - 28));
    assert_eq!(cable.send(&large), Sent { sent: 0, lost: FRAMES });
    assert_eq!(cable.send(&small), Sent { sent: FRAMES, lost: 0 });
    cable.expect(&small)?;
    // No fragment was sent.
    cable.expect(&[])?;

    // The last frame of a run is shorter: it fits alone.
    assert_eq!(cable.send(&[large[0].clone(), large[1].clone(), small[2].clone()]), Sent { sent: 1, lost: 2 });
    cable.expect(&small[2..3])
}

/// Returns numbered frames.
fn frames(length: usize) -> Vec<Vec<u8>> {
    let frame = |number: usize| [&[0x20, 0][..], &(number as u32).to_be_bytes(), &vec![7; length - 6]].concat();
    (0..FRAMES).map(frame).collect()
}

struct Cable {
    sender: Namespace,
    receiver: Namespace,
    from: Port,
    to: Port,
}

impl Cable {
    /// Builds the cable. Call within a tokio runtime.
    fn new() -> Result<Self> {
        let (sender, receiver) = (Namespace::create("sender")?, Namespace::create("receiver")?);
        let end = |namespace, interface, number| End { namespace, interface, mac: [2, 0, 0, 0, 0, number] };
        veth(&end(&sender, "a0", 1), &end(&receiver, "b0", 2), 1500)?;
        let open = |at: &Namespace, address: &str, interface| -> Result<Port> {
            at.ip(&["addr", "add", &format!("{address}/24"), "dev", interface])?;
            let _inside = at.enter()?;
            let any = SocketAddr::new(address.parse()?, 0);
            Ok(Port::udp(any, &PortConfig::endpoint(Identity::generate("endpoint")?))?)
        };
        let (from, to) = (open(&sender, "10.9.0.1", "a0")?, open(&receiver, "10.9.0.2", "b0")?);
        Ok(Self { sender, receiver, from, to })
    }

    fn set(&self, feature: &str, to: &str) -> Result<()> {
        for (namespace, interface) in [(&self.sender, "a0"), (&self.receiver, "b0")] {
            execute(namespace.command(Program::Ethtool)?.args(["-K", interface, feature, to]))?;
        }
        Ok(())
    }

    fn send(&self, frames: &[Vec<u8>]) -> Sent {
        let to = LinkAddr::Udp(self.to.udp_addr().expect("a UDP port"));
        self.from.data().send_batch(frames.iter().map(|frame| OutFrame { to, head: &frame[..6], body: &frame[6..] }))
    }

    /// Checks that these frames have arrived in this order, and no others.
    fn expect(&self, frames: &[Vec<u8>]) -> Result<()> {
        let (data, mut batch, mut received) = (self.to.data(), RecvBatch::new(1500), 0);
        wait_for("all frames", TIMEOUT, || {
            while data.try_recv_batch(&mut batch)? > 0 {
                for frame in batch.frames() {
                    ensure!(frames.get(received).is_some_and(|sent| *sent == frame.bytes), "frame {received}");
                    received += 1;
                }
            }
            Ok((received == frames.len()).then_some(()))
        })
    }
}
