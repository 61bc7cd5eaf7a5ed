//! Difference of two lists of permits.

use gdp_wire::Permit;

/// Returns the permits that are not among `others`.
pub fn without(permits: &[Permit], others: &[Permit]) -> Vec<Permit> {
    permits.iter().filter(|permit| !others.contains(permit)).copied().collect()
}
