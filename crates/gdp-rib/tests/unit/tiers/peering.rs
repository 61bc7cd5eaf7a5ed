//! Unit tests of `tiers::peering`.

use super::*;

const NOW: Duration = Duration::from_secs(1);

#[test]
fn one_of_two_domains_dials_and_never_one_that_cannot_be_reached() {
    for (a, b) in [(&[1][..], &[2][..]), (&[1], &[-2]), (&[-1], &[2]), (&[-1, 4], &[2, -3]), (&[-1, -4], &[9, 8])] {
        let (a, b) = (borders(a), borders(b));
        let (from_a, from_b) = (choose(&a, &b), choose(&b, &a));
        assert!(from_a.is_some() != from_b.is_some(), "{from_a:?} {from_b:?}");
        let peering = from_a.or(from_b).unwrap();
        let dialled = a.iter().chain(&b).find(|border| border.switch == peering.peer).unwrap();
        assert_eq!(dialled.addresses, peering.addrs);
    }
    assert_eq!(choose(&borders(&[-1]), &borders(&[-2])), None, "behind NAT on both sides");
    assert_eq!(choose(&borders(&[]), &borders(&[2])), None);
}

#[test]
fn a_peering_outlives_a_short_silence() {
    let (mut peerings, other) = (Peerings::default(), name(1));
    assert_eq!(peerings.follow(NOW, [other].into_iter()), [other].into());
    assert_eq!(peerings.follow(NOW + IDLE / 2, [].into_iter()), [other].into());
    assert_eq!(peerings.follow(NOW + IDLE, [].into_iter()), [].into());
}

/// One for each number; those with a negative one can only dial.
fn borders(numbers: &[i8]) -> Vec<SwitchStatement> {
    let border = |number: &i8| {
        let at = |port| SocketAddr::from(([192, 0, 2, *number as u8], port));
        let addresses = if *number > 0 { vec![at(31415), at(443)] } else { Vec::new() };
        let switch = name(number.unsigned_abs());
        SwitchStatement { switch, domain: name(0), addresses, serial: 1, not_after: 1 }
    };
    numbers.iter().map(border).collect()
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
