//! Unit tests of `check::cited_tests`.

use super::*;

const SOURCE: &str = "\
#[test]
fn it_holds() {}

#[tokio::test(flavor = \"multi_thread\")]
async fn it_holds_for_long() {}

fn a_helper() {}
";

#[test]
fn a_name_that_is_no_test_is_found() {
    let tests = names_of_tests(SOURCE);
    let named = "`it_holds`, `it_holds_for_…`, `a_helper`, `it_does_not`, `it_does_…`, `gdp-ctl a_b`, `docs/a_b.md`";
    assert_eq!(unknown(named, &tests), ["a_helper", "it_does_not", "it_does_…"]);
}
