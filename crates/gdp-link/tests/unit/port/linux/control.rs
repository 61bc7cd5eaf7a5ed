//! Unit tests of `port::linux::control`.

use super::*;

#[test]
fn what_was_put_in_comes_out() {
    let mut control = Control::new();
    control.push(1, 2, &7i32.to_ne_bytes());
    control.push(3, 4, &[9]);
    // SAFETY: plain integers and pointers.
    let mut header: libc::msghdr = unsafe { std::mem::zeroed() };
    control.attach(&mut header);
    let messages = |header: &libc::msghdr| {
        let mut messages = Vec::new();
        control.each(header, |level, kind, value| messages.push((level, kind, value)));
        messages
    };
    assert_eq!(messages(&header), [(1, 2, 7), (3, 4, 9)]);
    // The kernel truncates messages that do not fit.
    header.msg_controllen -= 8;
    assert_eq!(messages(&header), [(1, 2, 7)]);
    header.msg_controllen = 3;
    assert_eq!(messages(&header), []);
}
