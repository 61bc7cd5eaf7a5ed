use std::time::Duration;

#[test]
fn idle_time_is_that_of_all_processors() {
    let text = "cpu  10 0 20 300 50 0 7 0 0 0\ncpu0 5 0 10 150 25 0 7 0 0 0\ncpu1 5 0 10 150 25 0 0 0 0 0\nintr 1\n";
    let (idle, processors) = super::parse(text).unwrap();
    assert_eq!((idle, processors), (Duration::from_millis(3500), 2));
    assert!(super::parse("intr 1\n").is_none());
}
