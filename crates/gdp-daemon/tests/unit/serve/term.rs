//! Unit tests of `serve::term`.

use super::*;

/// A deadline for what must happen. No test waits until its end.
const LONG: Duration = Duration::from_secs(60);

#[tokio::test]
async fn a_term_ends_when_its_lease_does_though_etcd_answers_nothing() {
    let start = Instant::now();
    let (first, last) = (start + Duration::from_secs(1), start + Duration::from_millis(1200));
    let term = Term::new(first);
    assert!(term.extend(last), "it was renewed");
    let ended = timeout(LONG, within(&term, std::future::pending())).await.expect("it ends");
    assert!(matches!(ended, StoreError::Fenced) && Instant::now() >= last);
    assert!(term.is_over() && !term.extend(start + LONG), "what may have been noticed is not taken back");
}

#[tokio::test]
async fn the_work_of_a_term_may_end_before_it() {
    let term = Term::new(Instant::now() + LONG);
    let ended = within(&term, async { StoreError::Contended }).await;
    assert!(matches!(ended, StoreError::Contended) && !term.is_over());
}

#[tokio::test]
async fn who_waits_is_told_whether_it_is_stored() {
    let term = Arc::new(Term::new(Instant::now() + LONG));
    let [first, second, third] = [term.ticket(), term.ticket(), term.ticket()];
    assert!(term.is_awaited(term.last_ticket()));
    term.done(2);
    term.failed(3, "no etcd");
    assert!(first.stored().await.is_ok() && second.stored().await.is_ok());
    let refused = third.stored().await.unwrap_err();
    assert!(refused.code == RefusalCode::Unreachable && refused.reason.contains("no etcd"), "{refused}");
    let late = term.ticket();
    term.done(4);
    assert!(late.stored().await.is_ok() && !term.is_awaited(term.last_ticket()));
}

#[tokio::test]
async fn what_a_term_left_undone_no_other_stores() {
    let (old, new) = [(); 2].map(|()| Arc::new(Term::new(Instant::now() + LONG))).into();
    let undone = old.ticket();
    old.end("it is over");
    new.done(new.ticket().number);
    // A later ticket holder gets the same reason.
    let refused = undone.stored().await.unwrap_err();
    assert!(refused.reason.contains("it is over"), "{refused}");
}
