//! The forwarding decision: "Names at the edge, bits inside". The ingress switch looks up the
//! destination and stamps the egress switches as bits (after BIER, RFC 8279). A transit switch
//! looks at the bits only. The egress switch finds its own bit and looks up the name for its local
//! links.
//!
//! [`decide`] calls the parts `arrival`, `route`, `probe` and `answer` in order. [`copy()`] is the
//! decision that remains for each link of a group.

mod answer;
mod arrival;
mod copy;
mod frame_type;
mod probe;
mod rewrite;
mod route;
mod verdict;

use crate::forward::frame_type::frame_type;
use crate::forward::rewrite::{carry_mark, rewrite_hop, wait};
pub use crate::forward::verdict::{Kind, Verdict};
pub use arrival::{accept, keyed};
pub use copy::{Copy, copy};

use crate::header::FrameType;
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole, replay};

use arrival::{Arrival, arrival};
use route::{Egress, Refusal, is_foreign, route};

/// Classifies a frame by its first byte.
#[inline(always)]
pub fn classify(first_byte: u8) -> Kind {
    match frame_type(first_byte) {
        Some(FrameType::Control) => Kind::Control,
        Some(_) => Kind::Headed,
        None => Kind::Unknown,
    }
}

/// Decides the verdict for a frame of `available` bytes, including the header, and rewrites its
/// header accordingly. `traffic` is the DSCP and ECN byte of the IP header that carried the frame,
/// or 0 on Ethernet. Of `traffic`, only a router's mark counts (CE, RFC 3168). Bytes after the
/// payload, such as Ethernet padding, are not part of the frame; the caller removes them. The
/// header is unchanged if the verdict is [`Verdict::Notice`], [`Verdict::Slow`] or
/// [`Verdict::Drop`].
#[inline(always)]
pub fn decide<'t, T: Tables>(
    header: &mut Header,
    available: usize,
    traffic: u8,
    tables: &'t T,
) -> Verdict<'t, T::NextHop> {
    let Arrival { link: ingress, window, count } = match arrival(header, available, tables) {
        Ok(arrival) => arrival,
        Err(counter) => return Verdict::Drop(counter),
    };
    let decision = classify_action(header, ingress, tables).joined(tables);
    let mut hop = T::NextHop::default();
    // A frame for another plane stays unchanged. That plane shares the window, so it would refuse a
    // count recorded here.
    if !T::LAST && !is_for_this_plane(&decision, header.frame_len(), tables, &mut hop) {
        return Verdict::Slow;
    }
    if !replay::take(&window, count) {
        return Verdict::Drop(Counter::Replayed);
    }
    match decision.what {
        ActionKind::Send => {
            if !carry_mark(header, traffic) {
                return Verdict::Drop(Counter::Congested);
            }
            rewrite_hop(header, ingress, decision.bits, decision.set);
            wait(header, decision.link, tables);
            tables.stamp(header, decision.link);
            Verdict::Send(decision.link, hop, decision.counter)
        }
        ActionKind::Copy => {
            if !carry_mark(header, traffic) {
                return Verdict::Drop(Counter::Congested);
            }
            rewrite_hop(header, ingress, decision.bits, decision.set);
            Verdict::Copies(decision.group)
        }
        ActionKind::Refuse => answer::send_error(header, decision.refusal, ingress, hop, tables),
        ActionKind::Echo => answer::echo(header, ingress, hop, tables),
        ActionKind::Notice => Verdict::Notice(ingress),
        ActionKind::Punt => {
            tables.punt(ingress);
            Verdict::Notice(ingress)
        }
    }
}

/// The decision for a frame, before this plane checks whether it can carry the decision out.
///
/// Every field is always initialised. With an enum that omits fields, the compiler spills an
/// uninitialised register around calls into a plane, which the kernel's verifier rejects.
struct Decision<'t> {
    what: ActionKind,
    /// The egress link, or the ingress link if the frame does not leave.
    link: &'t LinkEntry,
    group: u32,
    bits: u64,
    set: u8,
    counter: Counter,
    refusal: Refusal,
}

impl Decision<'_> {
    /// Applies [`Tables::joined`] to what the rest of the decision branches on.
    #[inline(always)]
    fn joined(self, tables: &impl Tables) -> Self {
        let refusal = Refusal {
            counter: tables.joined(self.refusal.counter),
            code: tables.joined(self.refusal.code),
            ..self.refusal
        };
        Self { what: tables.joined(self.what), counter: tables.joined(self.counter), refusal, ..self }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum ActionKind {
    Send,
    Copy,
    Refuse,
    Echo,
    Notice,
    /// A notice with a rate limit.
    Punt,
}

#[inline(always)]
fn classify_action<'t, T: Tables>(header: &Header, ingress: &'t LinkEntry, tables: &'t T) -> Decision<'t> {
    let refusal = Refusal { counter: Counter::Unknown, code: None, mtu: 0 };
    let none = Decision {
        what: ActionKind::Notice,
        link: ingress,
        group: 0,
        bits: 0,
        set: 0,
        counter: Counter::Notice,
        refusal,
    };
    if header.version_type == FrameType::Data.first_byte() {
        match route(header, header.frame_len(), ingress, tables) {
            Ok(Egress::One { link, bits, set, counter }) => {
                Decision { what: ActionKind::Send, link, bits, set, counter, ..none }
            }
            Ok(Egress::Many { group, bits, set }) => Decision { what: ActionKind::Copy, group, bits, set, ..none },
            Err(refusal) => {
                let refusal = answer::as_disclosed(refusal, header, ingress, tables);
                Decision { what: ActionKind::Refuse, refusal, ..none }
            }
        }
    } else if header.version_type == FrameType::Probe.first_byte() {
        match probe::next(header, ingress, tables) {
            Ok(Some(link)) => {
                let (bits, set, counter) = (header.egress_bits(), header.egress_set, Counter::Forwarded);
                Decision { what: ActionKind::Send, link, bits, set, counter, ..none }
            }
            Ok(None) => Decision { what: ActionKind::Punt, ..none },
            Err(counter) => Decision { what: ActionKind::Refuse, refusal: counter.into(), ..none },
        }
    } else if header.version_type == FrameType::Echo.first_byte() && header.egress_set == Header::ASKS {
        Decision { what: ActionKind::Echo, ..none }
    } else if header.version_type == FrameType::Error.first_byte() && ingress.role == LinkRole::Endpoint as u32 {
        // Nothing is sent to an endpoint that it could refuse, so its errors are invalid.
        Decision { what: ActionKind::Refuse, ..none }
    } else {
        none
    }
}

#[inline(always)]
fn is_for_this_plane<T: Tables>(decision: &Decision<'_>, length: usize, tables: &T, hop: &mut T::NextHop) -> bool {
    match decision.what {
        ActionKind::Send | ActionKind::Echo => tables.resolve(decision.link, hop),
        ActionKind::Copy => tables.can_copy(decision.group, decision.bits, length),
        ActionKind::Refuse => decision.refusal.code.is_none() || tables.resolve(decision.link, hop),
        ActionKind::Notice | ActionKind::Punt => false,
    }
}
