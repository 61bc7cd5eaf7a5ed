//! Unit tests of `crossing`.

use super::*;

#[test]
fn no_domain_is_entered_twice_and_no_more_than_the_budget() {
    let ways: Vec<Name> = (0..=MAX_PATH as u8).map(name).collect();
    let mut path = Vec::new();
    for pair in ways.windows(2) {
        path = path_on(&path, pair[0], &pair[1]).unwrap();
        assert!(check_path(&path, &pair[0], &pair[1]).is_ok());
        assert_eq!(path_on(&path, pair[1], &pair[0]), Err(Crossing::Loop), "where it came from");
        assert_eq!(path_on(&path, pair[1], &ways[0]), Err(Crossing::Loop), "where it began");
        assert_eq!(path_on(&path, pair[1], &pair[1]), Err(Crossing::Loop), "where it is");
    }
    assert_eq!(path.len(), MAX_PATH);
    assert_eq!(path_on(&path, name(MAX_PATH as u8), &name(99)), Err(Crossing::TooFar));
}

#[test]
fn a_path_ends_with_who_asks() {
    let (home, from, third) = (name(1), name(2), name(3));
    for (path, needle) in [
        (vec![], "path of 0"),
        (vec![from; MAX_PATH + 1], "path of 17"),
        (vec![third], "does not end with"),
        (vec![home, from], "already"),
    ] {
        let refusal = check_path(&path, &from, &home).expect_err(needle);
        assert!(refusal.reason.contains(needle), "{refusal}");
    }
    assert!(check_path(&[third, from], &from, &home).is_ok());
}

#[test]
fn what_a_domain_answers_is_bounded_and_of_itself() {
    let (domain, entry) = (name(1), name(2));
    let said = |depth, crossing| TracedDomain { depth, domain: name(9), entry: name(9), rtt_us: None, crossing };
    let depths = |depths: &[u8]| depths.iter().map(|depth| said(*depth, Crossing::Unanswered)).collect();
    let of = |answer| taken(domain, entry, answer);
    for wrong in [&[][..], &[0], &[2], &[1, 1], &[1, 3], &[1, 2, 0]] {
        assert!(of(depths(wrong)).is_none(), "{wrong:?}");
    }
    let answer = of(depths(&[1, 2, 3, 2])).unwrap();
    assert_eq!((answer[0].domain, answer[0].entry, answer[1].domain), (domain, entry, name(9)));
    let deep: Vec<u8> = (1..=MAX_PATH as u8 + 1).collect();
    assert!(of(depths(&deep)).is_none());
    assert_eq!(of(depths(&[&[1][..], &[2; 99]].concat())).unwrap().len(), MAX_TRACED_DOMAINS);

    let switches = |count| {
        let switch = TracedSwitch { hop: 1, switch: None, rtt_us: None };
        Crossing::Traced { links: 0, time_us: None, switches: Some(vec![switch; count]) }
    };
    let masked = Crossing::Traced { links: 0, time_us: None, switches: None };
    let answer = of(vec![
        said(1, switches(MAX_TRACED_SWITCHES - 1)),
        said(2, switches(2)),
        said(2, switches(1)),
        said(2, Crossing::Refused { reason: "é".repeat(1000) }),
    ]);
    let answer = answer.unwrap();
    assert_eq!([&answer[1].crossing, &answer[2].crossing], [&masked, &switches(1)], "as long as there is room");
    assert!(matches!(&answer[3].crossing, Crossing::Refused { reason } if reason.len() == MAX_REASON));
}

#[test]
fn the_largest_answer_fits_a_message() {
    let full = || TracedDomain {
        depth: 1,
        domain: name(255),
        entry: name(255),
        rtt_us: Some(u64::MAX),
        crossing: refused("x".repeat(MAX_REASON)),
    };
    let switch = TracedSwitch { hop: 255, switch: Some(name(255)), rtt_us: Some(u64::MAX) };
    let switches = Some(vec![switch; MAX_TRACED_SWITCHES]);
    let crossing = Crossing::Traced { links: u32::MAX, time_us: Some(u64::MAX), switches };
    let domains = composed(TracedDomain { crossing, ..full() }, vec![vec![full(); 99]]);
    assert_eq!((domains.len(), domains[1].depth), (MAX_TRACED_DOMAINS, 2));
    assert!(matches!(&domains[0].crossing, Crossing::Traced { switches: Some(_), .. }));
    gdp_proto::control::encode(&gdp_proto::control::Response::TracedOn { domains }).unwrap();
}

#[test]
fn the_slowest_way_counts_and_one_that_does_not_answer_hides_it() {
    let to = |links, millis| Walk { switches: vec![], end: Some((links, Duration::from_millis(millis))) };
    let traced = |links, time_us| Crossing::Traced { links, time_us, switches: None };
    assert_eq!(inside(vec![to(1, 2), to(2, 1)], false), traced(3, Some(2000)));
    assert_eq!(inside(vec![to(1, 2), Walk::default()], false), traced(1, None));
    assert!(matches!(inside(vec![], true), Crossing::Traced { links: 0, switches: Some(_), .. }));
}

#[test]
fn a_neighbour_may_ask_so_often() {
    let (mut allowance, start) = (Allowance::default(), Duration::from_secs(100));
    let granted = (0..20).filter(|_| allowance.take(start)).count();
    assert_eq!((granted, allowance.refused()), (BURST as usize, 20 - u64::from(BURST)));
    assert!(!allowance.take(start + INTERVAL - Duration::from_millis(1)));
    assert!(allowance.take(start + INTERVAL) && !allowance.take(start + INTERVAL));
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}
