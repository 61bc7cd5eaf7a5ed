//! Two alternatives to the endpoints' way of sending on Ethernet, both by memory shared with the
//! kernel. They are the transmit ring of a packet socket, and an AF_XDP socket (in copy mode, the
//! only mode of veths). Each implements just enough for the measurement.

use std::io;
use std::mem::{size_of, zeroed};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::ptr::null_mut;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::{Context, Result, ensure};
use gdp_link::port::BATCH;
use gdp_wire::ETHERTYPE;

/// The largest frame in bytes, with the kernel's header in front.
const SLOT: usize = 2048;

/// Frames in flight in a ring.
const SLOTS: usize = 256;

/// The common part: a socket, and memory in slots that are filled one after another.
pub trait Ring {
    /// Copies a frame into the next slot, in pieces, its Ethernet header first.
    fn put(&mut self, pieces: [&[u8]; 3]) -> Result<()>;
    /// Makes the kernel send the filled slots.
    fn send(&mut self) -> Result<()>;
}

/// The ring of a packet socket (`PACKET_TX_RING`, packet(7)).
pub struct PacketRing {
    socket: OwnedFd,
    memory: Mapping,
    next: usize,
}

impl PacketRing {
    /// Opens the ring on an interface of the calling thread's network namespace.
    pub fn open(ifindex: u32) -> Result<Self> {
        let socket = open_socket(libc::AF_PACKET, libc::SOCK_RAW)?;
        set(&socket, libc::SOL_PACKET, libc::PACKET_VERSION, &(libc::tpacket_versions::TPACKET_V2 as libc::c_int))?;
        let block = SLOT * 64;
        let request = libc::tpacket_req {
            tp_block_size: block as u32,
            tp_block_nr: (SLOTS * SLOT / block) as u32,
            tp_frame_size: SLOT as u32,
            tp_frame_nr: SLOTS as u32,
        };
        set(&socket, libc::SOL_PACKET, libc::PACKET_TX_RING, &request)?;
        let memory = Mapping::of(&socket, SLOTS * SLOT, 0)?;
        // SAFETY: plain integers.
        let mut addr: libc::sockaddr_ll = unsafe { zeroed() };
        addr.sll_family = libc::AF_PACKET as u16;
        addr.sll_protocol = ETHERTYPE.to_be();
        addr.sll_ifindex = ifindex as i32;
        bind(&socket, &addr)?;
        Ok(Self { socket, memory, next: 0 })
    }
}

impl Ring for PacketRing {
    fn put(&mut self, pieces: [&[u8]; 3]) -> Result<()> {
        const DATA: usize = size_of::<libc::tpacket2_hdr>().next_multiple_of(16);
        let at = self.next % SLOTS * SLOT;
        let status = self.memory.word(at);
        ensure!(status.load(Ordering::Acquire) == libc::TP_STATUS_AVAILABLE, "the ring is full");
        let length = self.memory.write(at + DATA, pieces);
        self.memory.word(at + 4).store(length as u32, Ordering::Relaxed);
        self.memory.word(at).store(libc::TP_STATUS_SEND_REQUEST, Ordering::Release);
        self.next += 1;
        Ok(())
    }

    fn send(&mut self) -> Result<()> {
        kick(&self.socket)
    }
}

/// An AF_XDP socket that only sends.
pub struct XdpSocket {
    socket: OwnedFd,
    frames: Mapping,
    transmit: Mapping,
    completion: Mapping,
    offsets: libc::xdp_mmap_offsets,
    sent: u32,
}

impl XdpSocket {
    /// Opens the socket on the first queue of an interface of the calling thread's network
    /// namespace.
    pub fn open(ifindex: u32) -> Result<Self> {
        let socket = open_socket(libc::AF_XDP, libc::SOCK_RAW)?;
        let frames = Mapping::anonymous(SLOTS * SLOT)?;
        // SAFETY: plain integers.
        let mut register: libc::xdp_umem_reg = unsafe { zeroed() };
        register.addr = frames.address as u64;
        register.len = frames.length as u64;
        register.chunk_size = SLOT as u32;
        set(&socket, libc::SOL_XDP, libc::XDP_UMEM_REG, &register)?;
        for ring in [libc::XDP_UMEM_FILL_RING, libc::XDP_UMEM_COMPLETION_RING, libc::XDP_TX_RING] {
            set(&socket, libc::SOL_XDP, ring, &(SLOTS as u32))?;
        }
        // SAFETY: plain integers.
        let mut offsets: libc::xdp_mmap_offsets = unsafe { zeroed() };
        let mut length = size_of::<libc::xdp_mmap_offsets>() as u32;
        // SAFETY: the kernel writes at most `length` bytes into `offsets`.
        let got = unsafe {
            let offsets = (&raw mut offsets).cast();
            libc::getsockopt(socket.as_raw_fd(), libc::SOL_XDP, libc::XDP_MMAP_OFFSETS, offsets, &mut length)
        };
        check(got as isize)?;
        let transmit = offsets.tx.desc as usize + SLOTS * size_of::<libc::xdp_desc>();
        let transmit = Mapping::of(&socket, transmit, libc::XDP_PGOFF_TX_RING as libc::off_t)?;
        let completion = offsets.cr.desc as usize + SLOTS * size_of::<u64>();
        let completion = Mapping::of(&socket, completion, libc::XDP_UMEM_PGOFF_COMPLETION_RING as libc::off_t)?;
        // SAFETY: plain integers.
        let mut addr: libc::sockaddr_xdp = unsafe { zeroed() };
        addr.sxdp_family = libc::AF_XDP as u16;
        addr.sxdp_flags = libc::XDP_COPY;
        addr.sxdp_ifindex = ifindex;
        bind(&socket, &addr)?;
        Ok(Self { socket, frames, transmit, completion, offsets, sent: 0 })
    }

    fn completed(&self) -> u32 {
        let done = self.completion.word(self.offsets.cr.producer as usize).load(Ordering::Acquire);
        self.completion.word(self.offsets.cr.consumer as usize).store(done, Ordering::Release);
        done
    }
}

impl Ring for XdpSocket {
    fn put(&mut self, pieces: [&[u8]; 3]) -> Result<()> {
        // Frames complete in the order they were sent.
        let slot = self.sent as usize % SLOTS;
        ensure!((self.sent.wrapping_sub(self.completed()) as usize) < SLOTS, "the ring is full");
        let length = self.frames.write(slot * SLOT, pieces);
        let at = self.offsets.tx.desc as usize + slot * size_of::<libc::xdp_desc>();
        let address = ((slot * SLOT) as u64).to_ne_bytes();
        self.transmit.write(at, [&address, &(length as u32).to_ne_bytes(), &[0; 4]]);
        self.sent = self.sent.wrapping_add(1);
        Ok(())
    }

    fn send(&mut self) -> Result<()> {
        self.transmit.word(self.offsets.tx.producer as usize).store(self.sent, Ordering::Release);
        // One call sends half of a batch.
        let consumed = || self.transmit.word(self.offsets.tx.consumer as usize).load(Ordering::Acquire);
        for _ in 0..BATCH {
            if consumed() == self.sent {
                return Ok(());
            }
            kick(&self.socket)?;
        }
        anyhow::bail!("the kernel took {} of {} frames", consumed(), self.sent)
    }
}

/// Memory shared with the kernel.
struct Mapping {
    address: *mut u8,
    length: usize,
}

impl Mapping {
    fn of(socket: &OwnedFd, length: usize, offset: libc::off_t) -> Result<Self> {
        Self::map(length, libc::MAP_SHARED | libc::MAP_POPULATE, socket.as_raw_fd(), offset)
    }

    fn anonymous(length: usize) -> Result<Self> {
        Self::map(length, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_POPULATE, -1, 0)
    }

    fn map(length: usize, flags: libc::c_int, file: libc::c_int, offset: libc::off_t) -> Result<Self> {
        // SAFETY: a new mapping, at no given address.
        let address =
            unsafe { libc::mmap(null_mut(), length, libc::PROT_READ | libc::PROT_WRITE, flags, file, offset) };
        ensure!(address != libc::MAP_FAILED, "cannot map {length} bytes: {}", io::Error::last_os_error());
        Ok(Self { address: address.cast(), length })
    }

    fn word(&self, at: usize) -> &AtomicU32 {
        assert!(at.is_multiple_of(4) && at + 4 <= self.length);
        // SAFETY: within the mapping and aligned, because mappings begin at pages. Words that the
        // kernel writes are only used by atomic operations.
        unsafe { &*self.address.add(at).cast() }
    }

    /// Writes the pieces one after another and returns their total length.
    fn write(&mut self, at: usize, pieces: [&[u8]; 3]) -> usize {
        let length = pieces.iter().map(|piece| piece.len()).sum::<usize>();
        assert!(at + length <= self.length);
        let mut to = at;
        for piece in pieces {
            // SAFETY: the bounds check above keeps it within the mapping; no piece lies in the
            // mapping.
            unsafe { std::ptr::copy_nonoverlapping(piece.as_ptr(), self.address.add(to), piece.len()) };
            to += piece.len();
        }
        length
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped by the constructor, and owned by this value alone.
        unsafe { libc::munmap(self.address.cast(), self.length) };
    }
}

fn open_socket(family: libc::c_int, kind: libc::c_int) -> Result<OwnedFd> {
    // SAFETY: no pointers; the descriptor is owned from here on.
    unsafe { Ok(OwnedFd::from_raw_fd(check(libc::socket(family, kind | libc::SOCK_CLOEXEC, 0) as isize)? as i32)) }
}

fn set<T>(socket: &OwnedFd, level: libc::c_int, option: libc::c_int, value: &T) -> Result<()> {
    // SAFETY: pointer and length describe `value`.
    let result = unsafe {
        let length = size_of::<T>() as u32;
        libc::setsockopt(socket.as_raw_fd(), level, option, (&raw const *value).cast(), length)
    };
    check(result as isize).with_context(|| format!("socket option {level}/{option}")).map(drop)
}

fn bind<T>(socket: &OwnedFd, addr: &T) -> Result<()> {
    // SAFETY: pointer and length describe `addr`.
    let result = unsafe { libc::bind(socket.as_raw_fd(), (&raw const *addr).cast(), size_of::<T>() as u32) };
    check(result as isize).context("bind").map(drop)
}

/// Makes the kernel process the ring. `EAGAIN`, `EBUSY` and `ENOBUFS` mean that it has begun.
fn kick(socket: &OwnedFd) -> Result<()> {
    // SAFETY: nothing is read.
    let result = unsafe { libc::sendto(socket.as_raw_fd(), null_mut(), 0, libc::MSG_DONTWAIT, null_mut(), 0) };
    match check(result) {
        Err(error) if !matches!(error.raw_os_error(), Some(libc::EAGAIN | libc::EBUSY | libc::ENOBUFS)) => {
            Err(error).context("cannot send")
        }
        _ => Ok(()),
    }
}

fn check(result: isize) -> io::Result<isize> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}
