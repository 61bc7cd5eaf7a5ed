//! What neighbours said to this node itself: errors about frames it forwarded to them, and answers to its echoes. Written by the
//! userspace plane's threads, read by the daemon; an array of atomics, so that no neighbour's flood costs memory or hides
//! what another said.

use std::sync::atomic::{AtomicU64, Ordering};

use gdp_wire::table::{MAX_LINKS, link_index};
use gdp_wire::{ErrorCode, FrameType, Header};

/// By link index.
pub struct Notices(Box<[Heard]>);

/// What came on one link.
#[derive(Default)]
struct Heard {
    errors: [AtomicU64; ErrorCode::COUNT],
    /// Cookie of the latest answer to an echo.
    answer: AtomicU64,
}

impl Default for Notices {
    fn default() -> Self {
        Self((0..MAX_LINKS).map(|_| Heard::default()).collect())
    }
}

impl Notices {
    /// Forgets what came on the link that had the index before.
    pub fn begin(&self, id: u32) {
        let heard = self.of(id);
        heard.errors.iter().chain([&heard.answer]).for_each(|word| word.store(0, Ordering::Relaxed));
    }

    /// Takes a frame that is for this node, from the neighbour on link `id`. `false` for what nobody knows.
    pub fn take(&self, id: u32, header: &Header) -> bool {
        let heard = self.of(id);
        if header.version_type == FrameType::Echo.first_byte() && header.egress_set == Header::ANSWERS {
            heard.answer.store(header.egress_bits(), Ordering::Relaxed);
            return true;
        }
        match ErrorCode::from_number(header.egress_set) {
            Some(code) if header.version_type == FrameType::Error.first_byte() => {
                heard.errors[code.index()].fetch_add(1, Ordering::Relaxed);
                true
            }
            _ => false,
        }
    }

    /// Errors that came on a link, in the order of [`ErrorCode::ALL`].
    pub fn errors(&self, id: u32) -> [u64; ErrorCode::COUNT] {
        std::array::from_fn(|i| self.of(id).errors[i].load(Ordering::Relaxed))
    }

    /// The cookie of the latest answer to an echo on a link; 0 before the first.
    pub fn answer(&self, id: u32) -> u64 {
        self.of(id).answer.load(Ordering::Relaxed)
    }

    fn of(&self, id: u32) -> &Heard {
        &self.0[link_index(id) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_link_has_its_own_and_a_new_one_has_nothing() {
        let notices = Notices::default();
        let (a, b) = (0x1000_0001, 0x1000_0002);
        let mut error = Header::default();
        error.become_error(ErrorCode::HopLimit, 0);
        let mut answer = Header::echo(77);
        assert!(!notices.take(a, &answer), "a question is for the plane, not for this node");
        answer.become_answer();
        assert!(notices.take(a, &error) && notices.take(a, &error) && notices.take(b, &answer));
        error.egress_set = 9;
        assert!(!notices.take(a, &error));
        assert_eq!((notices.errors(a), notices.errors(b)), ([0, 0, 2, 0], [0; 4]));
        assert_eq!(notices.answer(b), 77);
        notices.begin(a ^ 0x2000_0000);
        assert_eq!((notices.errors(a), notices.answer(b)), ([0; 4], 77));
    }
}
