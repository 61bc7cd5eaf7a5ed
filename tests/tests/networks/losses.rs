//! Frames that are lost after the switch decided to redirect them: each is counted, and no other
//! frame is.
//!
//! ```text
//!   left:e0 ──── l0:switch:r0 ──── e0:right        left and other send, right takes
//!  other:e0 ──── m0:switch
//! ```

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, ensure};
use gdp_dataplane::kernel::{KernelPlane, Mode, pinned_stats};
use gdp_dataplane::pins::{self, PinLocation, Pins};
use gdp_tests::Tools;
use gdp_tests::fabric::Mounted;
use gdp_tests::frames::Frame;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::packet::PacketSocket;
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::table::{ANY_WRITER, Carrier};
use gdp_wire::{Counter, ETHERTYPE, FibEntry, LinkEntry, LinkRole, Name, SwitchConfig};

const OWN_BIT: u64 = 1;
const TOPIC: Name = Name::from_bytes([0xd0; 32]);
/// Link ids toward left, right and other, and their interfaces at the switch.
const LINKS: [(u32, &str); 3] = [(0x1001, "l0"), (0x1002, "r0"), (0x1003, "m0")];
const RIGHT: usize = 1;

#[test]
fn what_an_interface_does_not_take_any_more_is_counted() -> Result<()> {
    let site = Site::running()?;
    site.send(0, 1..=100)?;
    site.settled(100, 100)?;
    ensure!(site.lost()? == (0, 0));

    // The kernel refuses each frame at the redirect: the veth reports that it accepts none.
    site.right_end(Program::Ethtool, &["-K", "e0", "gro", "off"])?;
    site.send(0, 101..=150)?;
    site.settled(150, 100)?;
    ensure!(site.lost()? == (50, 50), "{:?}", site.lost());

    // The veth accepts frames again, and its other end goes down: the driver refuses whole batches.
    site.right_end(Program::Ethtool, &["-K", "e0", "gro", "on"])?;
    site.send(0, 151..=160)?;
    site.settled(160, 110)?;
    site.right_end(Program::Ip, &["link", "set", "e0", "down"])?;
    site.send(0, 161..=200)?;
    site.settled(200, 110)?;
    ensure!(site.lost()? == (90, 90), "{:?}", site.lost());

    // The interface itself goes down.
    site.right_end(Program::Ip, &["link", "set", "e0", "up"])?;
    site.switch.ip(&["link", "set", "r0", "down"])?;
    site.send(0, 201..=210)?;
    site.settled(210, 110)?;
    ensure!(site.lost()? == (100, 100), "{:?}", site.lost());
    Ok(())
}

/// In generic mode the kernel refuses redirects to an interface that is down. It sends all others
/// like ordinary packets; later losses appear in the interface's own statistics.
#[test]
fn in_generic_mode_only_what_the_kernel_refuses_is_counted() -> Result<()> {
    let mut site = Site::build()?;
    site.start(Mode::Generic, None)?;
    site.send(0, 1..=10)?;
    site.settled(10, 10)?;
    site.right_end(Program::Ip, &["link", "set", "e0", "down"])?;
    site.send(0, 11..=15)?;
    wait_for("the interface to count", TIMEOUT, || {
        Ok((site.statistic(&site.switch, "r0", "tx", "dropped")? == 5).then_some(()))
    })?;
    ensure!(site.lost()? == (0, 0), "{:?}", site.lost());

    site.right_end(Program::Ip, &["link", "set", "e0", "up"])?;
    site.switch.ip(&["link", "set", "r0", "down"])?;
    site.send(0, 16..=20)?;
    wait_for("five lost frames", TIMEOUT, || Ok((site.lost()? == (5, 5)).then_some(())))?;
    ensure!((site.count(Counter::Delivered)?, site.received()?) == (20, 10));
    Ok(())
}

/// Two processors send as fast as they can to one interface. Its ring has 256 entries, and one of
/// the two processors must empty it.
#[test]
fn what_does_not_fit_into_a_full_ring_is_counted() -> Result<()> {
    let site = Site::running()?;
    // Each socket receives every frame, which slows the receiving end.
    let _listeners = (0..100).map(|_| PacketSocket::open(&site.ends[RIGHT], "e0")).collect::<Result<Vec<_>>>()?;
    let stop = AtomicBool::new(false);
    let sent = std::thread::scope(|scope| -> Result<u64> {
        let senders = [0, 2].map(|from| {
            let (site, stop) = (&site, &stop);
            scope.spawn(move || -> Result<u64> {
                stay_on(from / 2)?;
                let socket = PacketSocket::open(&site.ends[from], "e0")?;
                let mut count = 0;
                while !stop.load(Ordering::Relaxed) {
                    count += 1;
                    socket.send(&site.frame(from, count).bytes())?;
                }
                Ok(count)
            })
        });
        let lost = wait_for("frames to be lost", 3 * TIMEOUT, || Ok((site.lost()?.0 > 0).then_some(())));
        stop.store(true, Ordering::Relaxed);
        let sent = senders.map(|sender| sender.join().expect("no panic"));
        lost?;
        sent.into_iter().sum()
    })?;
    // A veth also drops frames that exceed its ring before the switch; such a drop is no redirect
    // loss.
    let (delivered, received) = wait_for("the last frames", TIMEOUT, || {
        let (delivered, received) = (site.count(Counter::Delivered)?, site.received()?);
        Ok((delivered == received + site.lost()?.0).then_some((delivered, received)))
    })?;
    ensure!(received < delivered && delivered <= sent, "{received} of {delivered} of {sent}");
    ensure!(site.lost()? == (delivered - received, delivered - received));
    Ok(())
}

#[test]
fn losses_are_counted_while_no_daemon_runs_and_by_the_next_one() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let mounted = Mounted(folder.path().join("bpf"));
    let pins = || Pins::open(&PinLocation { bpffs: mounted.0.clone(), switch: TOPIC, replaces: false });
    let mut site = Site::build()?;
    site.start(Mode::Native, Some(pins()?))?;
    site.right_end(Program::Ip, &["link", "set", "e0", "down"])?;
    site.send(0, 1..=10)?;
    site.settled(10, 0)?;

    site.plane = None;
    site.send(0, 11..=15)?;
    let right = site.ifindex(RIGHT)?;
    wait_for("losses without a daemon", TIMEOUT, || {
        let stats = pinned_stats(&pins::find(&mounted.0)?[0].folder)?;
        Ok((stats.losses.get(&right) == Some(&15)).then_some(()))
    })?;

    site.start(Mode::Native, Some(pins()?))?;
    site.send(0, 16..=20)?;
    site.settled(20, 0)?;
    ensure!(site.lost()? == (20, 20), "each once: {:?}", site.lost());
    Ok(())
}

/// Interface numbers repeat across namespaces.
#[test]
fn the_losses_of_others_are_not_counted() -> Result<()> {
    let theirs = Site::running()?;
    let ours = Site::running()?;
    ensure!(theirs.ifindex(RIGHT)? == ours.ifindex(RIGHT)?, "two of the same number");
    theirs.right_end(Program::Ip, &["link", "set", "e0", "down"])?;
    theirs.send(0, 1..=20)?;
    theirs.settled(20, 0)?;
    ensure!((theirs.lost()?, ours.lost()?) == ((20, 20), (0, 0)));
    Ok(())
}

struct Site {
    plane: Option<KernelPlane>,
    switch: Namespace,
    /// The ends left, right and other.
    ends: [Namespace; 3],
}

impl Site {
    fn build() -> Result<Self> {
        let [left, switch, right, other] = ["left", "switch", "right", "other"].map(Namespace::create);
        let (switch, ends) = (switch?, [left?, right?, other?]);
        for (i, (_, interface)) in LINKS.into_iter().enumerate() {
            let end = End { namespace: &ends[i], interface: "e0", mac: mac(i, 1) };
            veth(&end, &End { namespace: &switch, interface, mac: mac(i, 2) }, 1500)?;
        }
        Ok(Self { plane: None, switch, ends })
    }

    fn running() -> Result<Self> {
        let mut site = Self::build()?;
        site.start(Mode::Native, None)?;
        Ok(site)
    }

    /// Attaches the switch to its interfaces, or takes over its earlier state.
    fn start(&mut self, mode: Mode, pins: Option<Pins>) -> Result<()> {
        let _inside = self.switch.enter()?;
        self.plane = Some(start(mode, pins)?);
        Ok(())
    }

    fn plane(&self) -> Result<&KernelPlane> {
        self.plane.as_ref().context("no switch runs")
    }

    /// Returns the `count`th frame for the topic from this end.
    fn frame(&self, from: usize, count: u64) -> Frame {
        Frame {
            to_mac: mac(from, 2),
            from_mac: mac(from, 1),
            link_id: LINKS[from].0,
            link_counter: count,
            key: [from as u64, 1],
            destination: TOPIC.to_bytes(),
            ..Frame::default()
        }
    }

    fn send(&self, from: usize, counts: impl IntoIterator<Item = u64>) -> Result<()> {
        let socket = PacketSocket::open(&self.ends[from], "e0")?;
        counts.into_iter().try_for_each(|count| socket.send(&self.frame(from, count).bytes()))
    }

    /// Waits until the switch has counted this many frames as delivered, and as many have arrived
    /// or are counted as lost.
    fn settled(&self, delivered: u64, received: u64) -> Result<()> {
        wait_for(&format!("{delivered} delivered, {received} received"), TIMEOUT, || {
            let now = (self.count(Counter::Delivered)?, self.received()?, self.lost()?.0);
            Ok((now == (delivered, received, delivered - received)).then_some(()))
        })
        .with_context(|| format!("{:?} received, {:?} lost", self.received(), self.lost()))
    }

    /// Returns the lost frames according to the counter, and according to the map for the right
    /// interface.
    fn lost(&self) -> Result<(u64, u64)> {
        let right = self.plane()?.losses()?.get(&self.ifindex(RIGHT)?).copied().unwrap_or(0);
        ensure!(self.plane()?.uncounted().is_none(), "{:?}", self.plane()?.uncounted());
        Ok((self.count(Counter::RedirectLost)?, right))
    }

    fn count(&self, counter: Counter) -> Result<u64> {
        Ok(self.plane()?.counters()?[counter as usize])
    }

    /// Returns the frames that the right end itself counts.
    fn received(&self) -> Result<u64> {
        self.statistic(&self.ends[RIGHT], "e0", "rx", "packets")
    }

    fn statistic(&self, at: &Namespace, interface: &str, direction: &str, what: &str) -> Result<u64> {
        let shown: serde_json::Value = serde_json::from_str(&at.ip(&["-j", "-s", "link", "show", interface])?)?;
        shown[0]["stats64"][direction][what].as_u64().with_context(|| format!("no {direction} {what} in {shown}"))
    }

    fn ifindex(&self, i: usize) -> Result<u32> {
        let _inside = self.switch.enter()?;
        ifindex(LINKS[i].1)
    }

    fn right_end(&self, program: Program, arguments: &[&str]) -> Result<()> {
        execute(self.ends[RIGHT].command(program)?.args(arguments)).map(drop)
    }
}

/// Starts a plane in the namespace of the switch.
fn start(mode: Mode, pins: Option<Pins>) -> Result<KernelPlane> {
    let mut plane = KernelPlane::load_pinned(&Tools::beside_this_test()?.ebpf_object()?, 16, pins)?;
    plane.set_config(SwitchConfig { own_bit: OWN_BIT, ethertype: ETHERTYPE.into(), host_pair: 0 })?;
    for (i, (id, interface)) in LINKS.into_iter().enumerate() {
        let port = ifindex(interface)?;
        plane.set_port(port, port)?;
        if plane.take_over(port)?.is_none() {
            plane.programs.attach(port, mode)?;
        }
        plane.set_link(&LinkEntry {
            id,
            peer_id: id + 0x1000,
            role: LinkRole::Endpoint as u32,
            port,
            mtu: 1500,
            rx_keys: [[i as u64, 1]; 2],
            carrier: Carrier::ethernet(mac(i, 1), mac(i, 2)),
            ..LinkEntry::default()
        })?;
    }
    let (local_link, writer_link) = (LINKS[RIGHT].0, ANY_WRITER);
    plane.set_route(&TOPIC, FibEntry { egress_bits: OWN_BIT, local_link, writer_link, ..FibEntry::default() })?;
    Ok(plane)
}

/// Pins the calling thread to one processor.
fn stay_on(cpu: usize) -> Result<()> {
    // SAFETY: zero is the empty set of processors.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: `cpu` is 0 or 1, and the set has room for 1024.
    unsafe { libc::CPU_SET(cpu, &mut set) };
    // SAFETY: pointer and length are of one live set.
    match unsafe { libc::sched_setaffinity(0, size_of_val(&set), &raw const set) } {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error()).with_context(|| format!("cannot run on processor {cpu}")),
    }
}

fn ifindex(interface: &str) -> Result<u32> {
    let name = std::ffi::CString::new(interface)?;
    // SAFETY: a C string that outlives the call.
    match unsafe { libc::if_nametoindex(name.as_ptr()) } {
        0 => Err(std::io::Error::last_os_error()).context(interface.to_owned()),
        index => Ok(index),
    }
}

fn mac(link: usize, end: u8) -> [u8; 6] {
    [2, 0, 0, 0, link as u8 + 1, end]
}
