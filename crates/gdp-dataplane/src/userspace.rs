//! Processing of one frame in the userspace plane, as pure functions without sockets or threads;
//! [`super::forwarder`] has those. The implementation is complete: it is the slow path of XDP, and
//! the whole path where XDP does not run.

use gdp_link::port::LinkAddr;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::tables::Tables;
use gdp_wire::{Counter, Header};
use zerocopy::{FromBytes, IntoBytes};

use super::tables::View;

/// Outcome for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Sends the first `length` bytes, rewritten in place. `counter` counts the frame unless
    /// sending fails.
    Send {
        link: u32,
        to: LinkAddr,
        length: usize,
        counter: Counter,
    },
    /// Sends copies as [`copies`] determines. The frame counts as replicated.
    Copies {
        ingress: u32,
        group: u32,
    },
    /// Passes the frame to the control plane.
    Control,
    /// Notifies this node of an error, an echo reply, or a probe that ends here, from the neighbour
    /// on this link.
    Notice {
        link: u32,
        header: Header,
    },
    Drop(Counter),
}

/// A copy of a frame: the header that replaces the frame's own, and the address to send it to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CopyOut {
    pub link: u32,
    pub to: LinkAddr,
    pub header: Header,
    pub counter: Counter,
}

/// Decides on a GDP frame without its outer headers, and rewrites it for its next link.
/// `congested`: the outer packet carried a congestion mark.
pub fn handle(frame: &mut [u8], congested: bool, tables: &View<'_>) -> Outcome {
    match frame.first().copied().map(forward::classify) {
        Some(Kind::Headed) => {}
        Some(Kind::Control) => return Outcome::Control,
        Some(Kind::Unknown) => return Outcome::Drop(Counter::Unknown),
        None => return Outcome::Drop(Counter::Truncated),
    }
    // Copy the header, because a frame may be unaligned.
    let Ok((mut header, _)) = Header::read_from_prefix(frame) else { return Outcome::Drop(Counter::Truncated) };
    let ingress = header.link_id();
    let traffic = if congested { Header::CONGESTED } else { 0 };
    let (link, length, counter) = match forward::decide(&mut header, frame.len(), traffic, tables) {
        Verdict::Send(link, (), counter) => (link.id, header.frame_len(), counter),
        Verdict::Answer(link, (), counter) => (link.id, Header::LEN, counter),
        Verdict::Copies(group) => {
            frame[..Header::LEN].copy_from_slice(header.as_bytes());
            return Outcome::Copies { ingress, group };
        }
        Verdict::Notice(link) => return Outcome::Notice { link: link.id, header },
        // Only the kernel plane has a slow path.
        Verdict::Slow => return Outcome::Drop(Counter::RedirectFailed),
        Verdict::Drop(counter) => return Outcome::Drop(counter),
    };
    let Some(to) = tables.address(link) else { return Outcome::Drop(Counter::NoLink) };
    frame[..Header::LEN].copy_from_slice(header.as_bytes());
    Outcome::Send { link, to, length, counter }
}

/// Makes the copies of a frame for which [`handle`] returned [`Outcome::Copies`]. Calls `send` for
/// each copy, and `count` with the reason for each missing copy.
pub fn copies(
    frame: &[u8],
    (ingress, group): (u32, u32),
    tables: &View<'_>,
    mut send: impl FnMut(CopyOut),
    mut count: impl FnMut(Counter),
) {
    let (Some(ingress), Ok((original, _))) = (tables.link(ingress), Header::read_from_prefix(frame)) else { return };
    for id in tables.members(group) {
        let (Some(link), Some(to)) = (tables.link(id), tables.address(id)) else { continue };
        let mut header = original;
        match forward::copy(&mut header, original.frame_len(), link, ingress, tables) {
            Copy::Send(counter) => send(CopyOut { link: id, to, header, counter }),
            Copy::Drop(counter) => count(counter),
            Copy::None => {}
        }
    }
}
