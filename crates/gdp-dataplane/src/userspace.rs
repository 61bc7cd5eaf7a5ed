//! What the userspace plane does with one frame. Pure: no sockets, no threads; [`super::forwarder`]
//! has those. Complete: it is the slow path of XDP and the whole path where XDP does not run.

use gdp_link::port::LinkAddr;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::tables::Tables;
use gdp_wire::{Counter, Header};
use zerocopy::{FromBytes, IntoBytes};

use super::tables::View;

/// What becomes of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Its first `length` bytes go there, rewritten in place; it is counted so unless that fails.
    Send {
        link: u32,
        to: LinkAddr,
        length: usize,
        counter: Counter,
    },
    /// Copies of it go where [`copies`] says; it is counted as replicated.
    Copies {
        ingress: u32,
        group: u32,
    },
    /// It is for the control plane.
    Control,
    /// It tells this node something: an error, the answer to an echo, or a probe that ends here,
    /// from the neighbour on this link.
    Notice {
        link: u32,
        header: Header,
    },
    Drop(Counter),
}

/// A copy of a frame: the header that takes the place of the frame's own, and where that goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CopyOut {
    pub link: u32,
    pub to: LinkAddr,
    pub header: Header,
    pub counter: Counter,
}

/// Decides about a GDP frame (without what carried it) and rewrites it for its next link.
/// `congested`: what carried it was marked.
pub fn handle(frame: &mut [u8], congested: bool, tables: &View<'_>) -> Outcome {
    match frame.first().copied().map(forward::classify) {
        Some(Kind::Headed) => {}
        Some(Kind::Control) => return Outcome::Control,
        Some(Kind::Unknown) => return Outcome::Drop(Counter::Unknown),
        None => return Outcome::Drop(Counter::Truncated),
    }
    // A copy, because a frame may lie anywhere.
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
        // Only the kernel has someone to leave a frame to.
        Verdict::Slow => return Outcome::Drop(Counter::RedirectFailed),
        Verdict::Drop(counter) => return Outcome::Drop(counter),
    };
    let Some(to) = tables.address(link) else { return Outcome::Drop(Counter::NoLink) };
    frame[..Header::LEN].copy_from_slice(header.as_bytes());
    Outcome::Send { link, to, length, counter }
}

/// Makes the copies of a frame that [`handle`] wants copied. Calls `send` with each, and `count`
/// with why there is none where there should be.
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
