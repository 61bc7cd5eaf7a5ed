//! Control messages (`cmsg(3)`): the ancillary data of a datagram.

use std::mem::size_of;

const HEADER: usize = size_of::<libc::cmsghdr>();

/// Maximum size of a value: an integer and padding to a word.
const VALUE: usize = 8;

const ROOM: usize = 3 * (HEADER + VALUE);

/// A buffer for three control messages with an integer each, aligned as the kernel requires.
#[derive(Clone, Copy)]
#[repr(C, align(8))]
pub struct Control {
    bytes: [u8; ROOM],
    length: usize,
}

impl Control {
    pub const fn new() -> Self {
        Self { bytes: [0; ROOM], length: 0 }
    }

    /// Adds a message with a value of at most 8 bytes. The buffer takes three messages.
    pub fn push(&mut self, level: libc::c_int, kind: libc::c_int, value: &[u8]) {
        let message = &mut self.bytes[self.length..][..HEADER + VALUE];
        message[..size_of::<usize>()].copy_from_slice(&(HEADER + value.len()).to_ne_bytes());
        message[HEADER - 8..HEADER - 4].copy_from_slice(&level.to_ne_bytes());
        message[HEADER - 4..HEADER].copy_from_slice(&kind.to_ne_bytes());
        message[HEADER..][..value.len()].copy_from_slice(value);
        self.length += message.len();
    }

    /// Sets the added messages as the control messages that `header` sends.
    pub fn attach(&self, header: &mut libc::msghdr) {
        header.msg_control = self.bytes.as_ptr().cast_mut().cast();
        header.msg_controllen = self.length as _;
    }

    /// Sets this buffer for the control messages that `header` receives.
    pub fn make_room(&mut self, header: &mut libc::msghdr) {
        header.msg_control = self.bytes.as_mut_ptr().cast();
        header.msg_controllen = ROOM as _;
    }

    /// Calls `found` with level, kind and value of each message that was received with `header`. A
    /// value is an integer or one byte.
    pub fn each(&self, header: &libc::msghdr, mut found: impl FnMut(libc::c_int, libc::c_int, libc::c_int)) {
        // The type differs with musl.
        #[allow(clippy::unnecessary_cast)]
        let mut rest = &self.bytes[..(header.msg_controllen as usize).min(ROOM)];
        while let Some((start, _)) = rest.split_at_checked(HEADER) {
            let [level, kind] = [HEADER - 8, HEADER - 4].map(|at| integer(&start[at..]));
            let Some(length) = start.first_chunk().map(|length| usize::from_ne_bytes(*length)) else { return };
            let Some(value) = rest.get(HEADER..length) else { return };
            found(level, kind, integer(value));
            rest = rest.get(length.next_multiple_of(size_of::<usize>())..).unwrap_or_default();
        }
    }
}

fn integer(bytes: &[u8]) -> libc::c_int {
    match (bytes, bytes.first_chunk()) {
        (_, Some(all)) => libc::c_int::from_ne_bytes(*all),
        ([one, ..], None) => (*one).into(),
        ([], None) => 0,
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/port/linux/control.rs"]
mod tests;
