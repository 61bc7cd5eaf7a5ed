//! Frames that go back to the neighbour they came from: errors and the answers to echoes.

use super::route::Refusal;
use super::{Verdict, stamp};
use crate::table::Tables;
use crate::{Counter, Header, LinkEntry};

/// Answers an echo.
#[inline(always)]
pub fn echo<'t, T: Tables>(header: &mut Header, ingress: &'t LinkEntry, tables: &T) -> Verdict<'t> {
    header.become_answer();
    stamp(header, ingress, tables.next_count(ingress));
    Verdict::Answer(ingress, Counter::Echoed)
}

/// Drops a data frame, and tells the neighbour why if it should know: not about frames for several egress switches, and
/// not faster than the link's rate.
#[inline(always)]
pub fn complain<'t, T: Tables>(
    header: &mut Header,
    refusal: Refusal,
    ingress: &'t LinkEntry,
    tables: &T,
) -> Verdict<'t> {
    let bits = header.egress_bits();
    let is_multicast = ingress.role == crate::LinkRole::Switch as u32 && bits & bits.wrapping_sub(1) != 0;
    match refusal.code {
        Some(code) if !is_multicast && tables.may_complain(ingress) && (T::LAST || tables.can_send(ingress)) => {
            tables.complain(ingress);
            header.become_error(code, refusal.mtu);
            stamp(header, ingress, tables.next_count(ingress));
            Verdict::Answer(ingress, refusal.counter)
        }
        _ => Verdict::Drop(refusal.counter),
    }
}
