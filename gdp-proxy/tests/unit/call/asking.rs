//! Unit tests of `call::asking`.

use super::*;

#[test]
fn of_several_failures_the_servers_own_is_returned() {
    let failed = |code, text: &str| Failed::from(Failure::new(code, text));
    let most_useful = |all: Vec<Failed>| {
        let found = all.into_iter().fold(None, |one, other| Some(more_useful(one, other))).unwrap();
        found.failure.text().to_owned()
    };
    let all = [
        (FailureCode::ServerLeft, "left"),
        (FailureCode::Busy, "busy"),
        (FailureCode::Refused, "refused"),
        (FailureCode::Malformed, "malformed"),
    ];
    for turn in 0..all.len() {
        let turned = all.iter().cycle().skip(turn).take(all.len());
        assert_eq!(most_useful(turned.map(|(code, text)| failed(*code, text)).collect()), "refused");
    }
    let earlier = vec![failed(FailureCode::Busy, "first"), failed(FailureCode::Busy, "second")];
    assert_eq!(most_useful(earlier), "first");
}
