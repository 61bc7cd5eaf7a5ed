//! The route of a probe. A probe follows the path of a data frame to one egress switch. No name is
//! looked up, nothing is copied, and a drop draws no error. Changes nothing.

use super::route::lowest_bit;
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole};

/// Returns the egress link of a probe, or `None` if the probe ends here and the daemon may receive
/// it. A probe ends if its hop limit is used up or this is the egress switch. A probe from another
/// domain also ends here, because the topology of this domain is hidden.
#[inline(always)]
pub fn next<'t, T: Tables>(
    header: &Header,
    ingress: &LinkEntry,
    tables: &'t T,
) -> Result<Option<&'t LinkEntry>, Counter> {
    if ingress.role == LinkRole::Endpoint as u32 {
        return Err(Counter::Unknown);
    }
    let (bits, is_foreign) = (header.egress_bits(), ingress.role == LinkRole::Border as u32);
    if !is_foreign && !bits.is_power_of_two() {
        return Err(Counter::NoEgress);
    }
    if is_foreign || header.hop_limit <= 1 || bits == tables.own_bit() {
        return if tables.may_punt(ingress) { Ok(None) } else { Err(Counter::PuntLimit) };
    }
    let link = tables.link(tables.next_hop(lowest_bit(bits))).ok_or(Counter::NoEgress)?;
    if bits & !link.reach != 0 {
        return Err(Counter::NoEgress);
    }
    if link.id == ingress.id {
        return Err(Counter::Hairpin);
    }
    if header.frame_len() > link.mtu as usize { Err(Counter::TooBig) } else { Ok(Some(link)) }
}
