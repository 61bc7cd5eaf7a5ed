//! Unit tests of `automatic::omissions`.

use super::*;

#[test]
fn many_names_are_one_line_for_a_reason() {
    let (now, mut omissions) = (Instant::now(), Omissions::default());
    let mut all = omitted(0..20_000, &Reason::CatalogHasAllNames);
    all.insert("topic /other".into(), Reason::ServedHere);
    let mut lines: Vec<_> = omissions.update(now, all.clone()).iter().map(Line::to_string).collect();
    lines.sort();
    assert_eq!(
        lines,
        [
            "20000 names are not carried, such as topic /t00000: there are 1024 names in the catalog already",
            "topic /other is not carried: it is served here already; give the import a prefix",
        ]
    );
    assert_eq!(omissions.update(now + 2 * PERIOD, all), [], "nothing is news");
}

#[test]
fn names_that_come_and_go_are_one_line_in_a_period() {
    let (begin, mut omissions) = (Instant::now(), Omissions::default());
    let mut lines = Vec::new();
    // Ten minutes, in which ten names a second are replaced by others.
    for second in 0..600 {
        let now = begin + Duration::from_secs(second);
        let names = second as usize * 10..second as usize * 10 + 10;
        lines.extend(omissions.update(now, omitted(names, &Reason::NoFreeRoute(1024))));
    }
    let names: Vec<_> = lines.iter().map(|line| line.names).collect();
    assert_eq!(names, [10, 600, 600, 600, 600, 600, 600, 600, 600, 600]);
    assert_eq!(lines[1].what, "topic /t00600", "a new one is named");
}

#[test]
fn another_reason_is_news() {
    let (now, mut omissions) = (Instant::now(), Omissions::default());
    let failed = |error: &str| Reason::Failed(error.into());
    assert_eq!(omissions.update(now, omitted(0..1, &failed("one"))).len(), 1);
    assert_eq!(omissions.update(now, omitted(0..1, &Reason::ServedHere)).len(), 1);
    assert_eq!(omissions.update(now, omitted(0..1, &failed("two"))), [], "too early");
    let later = omissions.update(now + PERIOD, omitted(0..1, &failed("two")));
    assert_eq!(later.iter().map(Line::to_string).collect::<Vec<_>>(), ["topic /t00000 is not carried: two"]);
}

fn omitted(names: std::ops::Range<usize>, reason: &Reason) -> Omitted {
    names.map(|i| (format!("topic /t{i:05}"), reason.clone())).collect()
}
