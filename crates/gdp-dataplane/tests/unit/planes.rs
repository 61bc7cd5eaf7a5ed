//! Unit tests of `planes`.

use super::*;

#[test]
fn routes_are_paged_in_the_order_of_their_digits_and_bounded() {
    let config = PlaneConfig { wanted: Wanted::Userspace, fib_capacity: 5, ..PlaneConfig::default() };
    let mut planes = Planes::open(config).unwrap();
    let name = |i: u8| Name::from_bytes(std::array::from_fn(|at| if at == 0 { i } else { 255 - i }));
    for i in [3, 1, 5, 2, 4] {
        planes.set_route(name(i), &PlaneRoute::default()).unwrap();
    }
    let error = planes.set_route(name(6), &PlaneRoute::default()).unwrap_err().to_string();
    assert!(error.contains("the FIB is full (5 names)"), "{error}");
    let read = PlaneRoute { readers: vec![7], ..PlaneRoute::default() };
    planes.set_route(name(5), &read).expect("it is there already");

    let page = |after: Option<u8>, limit| {
        let (page, more) = planes.routes_behind(after.map(name), limit).unwrap();
        (page.iter().map(|(name, _)| name.as_bytes()[0]).collect::<Vec<_>>(), more)
    };
    assert_eq!(page(None, 2), (vec![1, 2], true));
    assert_eq!(page(Some(2), 2), (vec![3, 4], true));
    assert_eq!(page(Some(4), 2), (vec![5], false));
    assert_eq!(page(None, 5), (vec![1, 2, 3, 4, 5], false));
    assert_eq!(page(Some(5), 2), (vec![], false));
}
