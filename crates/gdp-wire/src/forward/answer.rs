//! Frames that return to the neighbour that sent them: errors and answers to echoes.

use super::route::Refusal;
use crate::forward::verdict::Verdict;
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole};

/// Answers an echo.
#[inline(always)]
pub fn echo<'t, T: Tables>(
    header: &mut Header,
    ingress: &'t LinkEntry,
    hop: T::NextHop,
    tables: &T,
) -> Verdict<'t, T::NextHop> {
    header.become_answer();
    tables.stamp(header, ingress);
    Verdict::Answer(ingress, hop, Counter::Echoed)
}

/// Removes the code from a refusal unless an error goes to the neighbour. No error is sent for
/// frames to several egress switches, or above the error rate of the link.
#[inline(always)]
pub fn as_disclosed<T: Tables>(refusal: Refusal, header: &Header, ingress: &LinkEntry, tables: &T) -> Refusal {
    let bits = header.egress_bits();
    let is_multicast = ingress.role == LinkRole::Switch as u32 && bits & bits.wrapping_sub(1) != 0;
    let is_disclosed = refusal.code.is_some() && !is_multicast && tables.may_send_error(ingress);
    Refusal { code: if is_disclosed { refusal.code } else { None }, ..refusal }
}

/// Drops a data frame, and sends an error to the neighbour if the refusal has a code.
#[inline(always)]
pub fn send_error<'t, T: Tables>(
    header: &mut Header,
    refusal: Refusal,
    ingress: &'t LinkEntry,
    hop: T::NextHop,
    tables: &T,
) -> Verdict<'t, T::NextHop> {
    let Some(code) = refusal.code else { return Verdict::Drop(refusal.counter) };
    tables.send_error(ingress);
    header.become_error(code, refusal.mtu);
    tables.stamp(header, ingress);
    Verdict::Answer(ingress, hop, refusal.counter)
}
