//! Permits of one list that are not in another.

use gdp_wire::Permit;

/// Those that are not among `others`.
pub fn without(permits: &[Permit], others: &[Permit]) -> Vec<Permit> {
    permits.iter().filter(|permit| !others.contains(permit)).copied().collect()
}
