//! The XDP programs of the object: loads them, attaches the switch to interfaces, and runs it on
//! single packets. Part of [`super::kernel`].

use std::collections::HashMap;
use std::path::Path;

use aya::Ebpf;
use aya::programs::links::{FdLink, PinnedLink};
use aya::programs::xdp::{XdpLink, XdpLinkId, XdpMode};
use aya::programs::{ProgramError, ProgramFd, TestRun, TestRunOptions, Xdp};

use super::kernel_version::KernelVersion;
use super::object::Object;
use super::pins::Pins;
use super::verified;
use crate::attach_mode::Mode;
use crate::kernel_failures::{AttachError, LoadError};

/// First kernel whose XDP supports packets in several buffers.
const FRAGS: KernelVersion = KernelVersion(5, 18);

/// The program that resolves the egress of a link over UDP.
const ROUTE: &str = "gdp_route";

/// Memory layout of the packets of an interface. The object has a switch program for each layout;
/// their function is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Buffers {
    /// Packets in one buffer. A driver that accepts this program guarantees it, and refuses an MTU
    /// that would break it. The program then knows the packet length without a call into the
    /// kernel.
    One,
    /// Packets possibly in several buffers.
    Several,
}

impl Buffers {
    /// Returns the supported layouts, best first.
    fn known_to(version: KernelVersion) -> &'static [Self] {
        if version >= FRAGS { &[Self::One, Self::Several] } else { &[Self::One] }
    }

    fn program(self) -> &'static str {
        match self {
            Self::One => "gdp_switch_linear",
            Self::Several => "gdp_switch",
        }
    }
}

/// The action an XDP program returned in [`Programs::test_run`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum XdpAction {
    Drop,
    Pass,
    Redirect,
    Other(u32),
}

/// A switch program attached to an interface.
struct Attached {
    link: XdpLinkId,
    mode: Mode,
    buffers: Buffers,
}

/// The loaded programs. Dropping this value detaches them, unless they are pinned.
pub struct Programs {
    pub(crate) ebpf: Ebpf,
    pub(crate) pins: Option<Pins>,
    /// By interface index.
    attached: HashMap<u32, Attached>,
    /// The loaded switch programs.
    switches: &'static [Buffers],
    /// Name of the egress program.
    egress: &'static str,
}

impl Programs {
    /// Loads the programs, which the kernel verifies.
    pub(crate) fn load(object: &Object, version: KernelVersion, mut ebpf: Ebpf) -> Result<Self, LoadError> {
        let switches = Buffers::known_to(version);
        let egress = if version >= FRAGS { "gdp_egress" } else { "gdp_egress_linear" };
        for name in switches.iter().map(|buffers| buffers.program()).chain([egress, ROUTE]) {
            let program = xdp(&mut ebpf, name);
            let program = program.ok_or(LoadError::Mismatch { object: object.clone(), what: "program", name })?;
            verified::load(|| program.load())
                .map_err(|source| LoadError::Program { object: object.clone(), source: Box::new(source) })?;
        }
        Ok(Self { ebpf, pins: None, attached: HashMap::new(), switches, egress })
    }

    /// Returns the egress program.
    pub(crate) fn egress(&mut self, object: &Object) -> Result<ProgramFd, LoadError> {
        let fd = self.program(self.egress).fd().and_then(|fd| Ok(fd.try_clone()?));
        fd.map_err(|source| LoadError::Program { object: object.clone(), source: Box::new(source) })
    }

    /// Attaches the switch to an interface of this network namespace.
    pub fn attach(&mut self, ifindex: u32, mode: Mode) -> Result<(), AttachError> {
        let xdp_mode = match mode {
            Mode::Native => XdpMode::Driver,
            Mode::Generic => XdpMode::Skb,
        };
        let (buffers, mut link) =
            first_that(self.switches_for(mode), |buffers| self.switch(buffers).attach_to_if_index(ifindex, xdp_mode))?;
        if let Some(pin) = self.pins.as_ref().map(|pins| pins.link(ifindex, mode)) {
            let taken = FdLink::try_from(self.switch(buffers).take_link(link)?)?;
            let pinned = taken.pin(pin)?;
            link = self.switch(buffers).attach_to_link(XdpLink::try_from(FdLink::from(pinned))?)?;
        }
        self.attached.insert(ifindex, Attached { link, mode, buffers });
        Ok(())
    }

    /// Replaces the program that an earlier daemon left on an interface atomically, without losing
    /// packets. Returns `None` if there is no such program.
    pub fn take_over(&mut self, ifindex: u32) -> Result<Option<Mode>, AttachError> {
        let left = self.pins.iter().flat_map(Pins::links).find(|(at, _)| *at == ifindex);
        let Some((pin, mode)) = self.pins.as_ref().zip(left).map(|(pins, (_, mode))| (pins.link(ifindex, mode), mode))
        else {
            return Ok(None);
        };
        let replaced = first_that(self.switches_for(mode), |buffers| {
            let pinned = FdLink::from(PinnedLink::from_pin(&pin)?);
            Ok::<_, AttachError>(self.switch(buffers).attach_to_link(XdpLink::try_from(pinned)?)?)
        });
        match replaced {
            Ok((buffers, link)) => {
                self.attached.insert(ifindex, Attached { link, mode, buffers });
                Ok(Some(mode))
            }
            // The interface was deleted, and another interface now has its index.
            Err(AttachError::Program(ProgramError::SyscallError(error)))
                if error.io_error.raw_os_error() == Some(libc::ENOLINK) =>
            {
                unpin(&pin)?;
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Detaches the program from an interface. Does nothing if no program is attached.
    pub fn detach(&mut self, ifindex: u32) -> Result<(), AttachError> {
        let Some(Attached { link, mode, buffers }) = self.attached.remove(&ifindex) else { return Ok(()) };
        let pin = self.pins.as_ref().map(|pins| pins.link(ifindex, mode));
        self.switch(buffers).detach(link)?;
        pin.map_or(Ok(()), |pin| unpin(&pin))
    }

    /// Detaches an earlier daemon's programs from interfaces that this daemon has not taken over.
    pub fn drop_left_over(&mut self) -> Result<(), AttachError> {
        let Some(pins) = &self.pins else { return Ok(()) };
        let left = pins.links().into_iter().filter(|(ifindex, _)| !self.attached.contains_key(ifindex));
        left.into_iter().try_for_each(|(ifindex, mode)| unpin(&pins.link(ifindex, mode)))
    }

    /// Returns whether the kernel has JIT-compiled the switch; `None` if the kernel does not report
    /// it.
    pub fn is_jitted(&self) -> Option<bool> {
        let program: &Xdp = self.ebpf.program(self.switches[0].program())?.try_into().ok()?;
        Some(program.info().ok()?.size_jitted() != 0)
    }

    /// Returns the current egress interface of a link over UDP. The interface must be a port, its
    /// next hop resolved, and the kernel able to send frames of every length that the link allows.
    /// Returns `None` otherwise, and where copies could not look up the route. The program itself
    /// performs the lookup, in the calling thread's network namespace.
    pub fn route_of(&self, link: u32) -> Result<Option<u32>, ProgramError> {
        /// Minimum length of a test packet.
        const ETHERNET: usize = 14;
        let Some(program) = self.ebpf.program(ROUTE) else { return Ok(None) };
        let program: &Xdp = program.try_into()?;
        let mut packet = [0; ETHERNET];
        packet[..4].copy_from_slice(&link.to_ne_bytes());
        let mut options = TestRunOptions::new();
        options.data_in = Some(&packet);
        let interface = program.test_run(options)?.return_value;
        Ok((interface != 0).then_some(interface))
    }

    /// Returns whether any interface runs generic XDP. Generic XDP shares memory between copies, so
    /// a header change in one copy would affect all.
    pub fn has_generic(&self) -> bool {
        let pinned = self.pins.iter().flat_map(Pins::links).map(|(_, mode)| mode);
        self.attached.values().map(|attached| attached.mode).chain(pinned).any(|mode| mode == Mode::Generic)
    }

    /// Runs the switch on one Ethernet frame without an interface. Returns the action and the
    /// resulting frame.
    pub fn test_run(&mut self, buffers: Buffers, frame: &[u8]) -> Result<(XdpAction, Vec<u8>), ProgramError> {
        // The outer headers may grow.
        let mut out = vec![0; frame.len() + 64];
        let mut options = TestRunOptions::new();
        options.data_in = Some(frame);
        options.data_out = Some(&mut out);
        let result = self.switch(buffers).test_run(options)?;
        out.truncate(result.data_size_out as usize);
        let action = match result.return_value {
            1 => XdpAction::Drop,
            2 => XdpAction::Pass,
            4 => XdpAction::Redirect,
            other => XdpAction::Other(other),
        };
        Ok((action, out))
    }

    /// Returns the nanoseconds for each packet, measured over `repeat` runs on the same frame.
    /// Forwarding changes the frame, so only the first run processes the given frame.
    pub fn time(&mut self, buffers: Buffers, frame: &[u8], repeat: u32) -> Result<u32, ProgramError> {
        let mut options = TestRunOptions::new();
        options.data_in = Some(frame);
        options.repeat = repeat;
        Ok(self.switch(buffers).test_run(options)?.duration.subsec_nanos())
    }

    /// Returns the switch programs to try on an interface, in this order.
    fn switches_for(&self, mode: Mode) -> &'static [Buffers] {
        match mode {
            Mode::Native => self.switches,
            // In generic mode every driver accepts either program. With the one-buffer program, the
            // kernel would copy each large packet into one buffer.
            Mode::Generic => &self.switches[self.switches.len() - 1..],
        }
    }

    fn switch(&mut self, buffers: Buffers) -> &mut Xdp {
        self.program(buffers.program())
    }

    fn program(&mut self, name: &str) -> &mut Xdp {
        xdp(&mut self.ebpf, name).expect("`load` found the program")
    }
}

fn unpin(pin: &Path) -> Result<(), AttachError> {
    std::fs::remove_file(pin).map_err(|source| AttachError::Unpin { path: pin.into(), source })
}

/// Returns the first switch for which `attempt` succeeds, with the result; or the error of the
/// last.
fn first_that<T, E>(switches: &[Buffers], mut attempt: impl FnMut(Buffers) -> Result<T, E>) -> Result<(Buffers, T), E> {
    let (last, others) = switches.split_last().expect("one is loaded at least");
    let early = others.iter().find_map(|buffers| attempt(*buffers).ok().map(|done| (*buffers, done)));
    early.map_or_else(|| attempt(*last).map(|done| (*last, done)), Ok)
}

fn xdp<'a>(ebpf: &'a mut Ebpf, program: &str) -> Option<&'a mut Xdp> {
    ebpf.program_mut(program)?.try_into().ok()
}
