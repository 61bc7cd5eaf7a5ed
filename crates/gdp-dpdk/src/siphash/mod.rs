//! Hop tags of many frames at once: SipHash-2-4 in the lanes of vectors. [`Header::tag_for`]
//! defines the tag. This module computes the same function for the frames of one burst, whose tags
//! are independent of each other.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "x86_64")]
mod lanes;
mod tags;

use gdp_wire::Header;
pub use tags::Tags;

impl Tags {
    /// Computes the tags of all added entries from these headers.
    #[inline]
    pub fn make(&mut self, headers: &[Header]) {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") {
                // SAFETY: the CPU has the feature.
                return unsafe { avx512::make(self, headers) };
            }
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the CPU has the feature.
                return unsafe { avx2::make(self, headers) };
            }
        }
        self.make_each(headers);
    }
}

#[cfg(test)]
#[path = "../../tests/unit/siphash.rs"]
mod tests;
