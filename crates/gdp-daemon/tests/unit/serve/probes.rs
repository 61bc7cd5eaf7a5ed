//! Unit tests of `serve::core::probes`.

use super::*;

#[test]
fn no_domain_uses_up_what_is_for_others() {
    let (mut probes, [one, other]) = (Probes::default(), [1, 2].map(|i| Name::from_bytes([i; 32])));
    let mut cookies = 0..;
    let mut fill = |probes: &mut Probes, asked_by| {
        let mut wait = || probes.wait(asked_by, cookies.next().unwrap()).ok();
        std::iter::from_fn(&mut wait).take(1000).collect::<Vec<_>>()
    };
    let of_one = fill(&mut probes, Some(one));
    assert_eq!((of_one.len(), probes.room(Some(one))), (MAX_FOR_NEIGHBOUR, 0));
    let (of_other, mut own) = (fill(&mut probes, Some(other)), fill(&mut probes, None));
    assert_eq!((of_other.len(), own.len()), (MAX_FOR_NEIGHBOUR, MAX_OUTSTANDING));

    // The first cookie is one of the first domain. An answer and a dropped receiver both make room.
    let name = Name::from_bytes([3; 32]);
    probes.answer(Traced { cookie: 0, switch: name, end: None });
    assert_eq!((probes.room(Some(one)), probes.room(None)), (1, 0));
    own.truncate(10);
    assert_eq!((probes.room(Some(one)), probes.room(None)), (1, MAX_OUTSTANDING - 10));
    drop(of_one);
    assert_eq!(probes.room(Some(one)), MAX_FOR_NEIGHBOUR);
    assert_eq!(probes.room(Some(other)), 0);
}
