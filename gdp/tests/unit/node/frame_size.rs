//! Unit tests of `node::frame_size`.

use super::*;

#[test]
fn only_too_big_lowers_it_and_nothing_raises_it() {
    let size = FrameSize::default();
    let learn = |code: ErrorCode, mtu: u32| {
        let mut error = Header::default();
        error.become_error(code, mtu);
        size.learn(code, &error);
        size.get()
    };
    assert_eq!(learn(ErrorCode::NoRoute, 0), u32::MAX);
    assert_eq!(learn(ErrorCode::TooBig, 1452), 1452);
    assert_eq!(learn(ErrorCode::TooBig, 1472), 1452);
    assert_eq!(learn(ErrorCode::TooBig, 7), 1452, "not an MTU");
    assert_eq!(learn(ErrorCode::NoRoute, 1000), 1452);
    assert_eq!(learn(ErrorCode::TooBig, 1200), 1200);
}
