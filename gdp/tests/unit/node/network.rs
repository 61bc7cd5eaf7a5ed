//! Unit tests of `node::network`.

use netlink_packet_core::ErrorMessage;

use super::super::{BETWEEN, until_led};
use super::*;

#[test]
fn an_interface_whose_carrier_was_lost_meanwhile_is_another() {
    let mut carriers = Carriers::default();
    let first = carriers.of(7);
    assert!(first.is_some(), "nothing was heard of it");
    carriers.set(7, true);
    assert_eq!(carriers.of(7), first, "a message about something else");
    carriers.set(7, false);
    assert_eq!(carriers.of(7), None);
    assert_eq!(carriers.of(8), first, "another one");
    carriers.set(7, true);
    assert!(carriers.of(7).is_some_and(|again| Some(again) != first));
}

#[tokio::test]
async fn an_address_on_this_machine_is_reached_and_nothing_changes_by_itself() {
    let network = HostNetwork::open(watch::Sender::default()).unwrap();
    let to = LinkAddr::udp("127.0.0.1:9".parse().unwrap());
    let way = network.way(to, None).await;
    let is_local = matches!(&way, NetworkPath::By(exit) if exit.source == Some("127.0.0.1".parse().unwrap()));
    assert!(is_local, "{way:?}");
    assert_eq!(network.way(to, None).await, way);
    assert_eq!(network.until_other(to, None, &NetworkPath::Nowhere).await, way, "at once, as it is another");
    assert_eq!(network.way(to, Some(u32::MAX >> 1)).await, NetworkPath::Nowhere, "by an interface that is not there");
}

#[tokio::test]
async fn a_kernel_that_does_not_say_is_not_taken_to_say_no() {
    let failed = |errno: i32| {
        let mut message = ErrorMessage::default();
        message.code = std::num::NonZeroI32::new(-errno);
        std::future::ready(Err(rtnetlink::Error::NetlinkError(message)))
    };
    for errno in [libc::ENETUNREACH, libc::EHOSTUNREACH, libc::EACCES, libc::ENODEV] {
        assert_eq!(Answer::of(failed(errno)).await, Answer::NoRoute, "{errno}");
    }
    for errno in [libc::EPERM, libc::ENOBUFS, libc::EINVAL, libc::EBUSY] {
        assert_eq!(Answer::of(failed(errno)).await, Answer::None, "{errno}");
    }
    assert_eq!(Answer::of(std::future::ready(Err(rtnetlink::Error::RequestFailed))).await, Answer::None);
    assert_eq!(Answer::of(std::future::ready(Ok(None))).await, Answer::None, "it says nothing");
    let answer = timeout(LONG, Answer::of(std::future::pending())).await;
    assert_eq!(answer, Ok(Answer::None), "nor ever will");
}

#[tokio::test]
async fn what_is_not_known_is_no_other_way() {
    let (told, changes) = watch::channel(());
    let found = Mutex::new(vec![by(2), NetworkPath::Unknown, by(1), NetworkPath::Unknown]);
    let look = || {
        told.send_replace(());
        std::future::ready(found.lock().pop().expect("not asked again"))
    };
    let way = timeout(LONG, until_other(changes.clone(), NetworkPath::Unknown, look)).await;
    assert_eq!((way, found.lock().len()), (Ok(by(2)), 0), "the one that was found first is the one that was");
}

#[tokio::test]
async fn only_news_of_another_way_to_the_switch_matter() {
    let (told, changes) = watch::channel(());
    let found = Mutex::new(vec![by(1), NetworkPath::Nowhere, by(1), by(1), by(1)]);
    let look = || {
        told.send_replace(());
        std::future::ready(found.lock().pop().expect("not asked again"))
    };
    timeout(LONG, until_led(changes.clone(), by(1), look)).await.expect("it was gone, and is back");
    assert_eq!(found.lock().len(), 0);
    let gone = async || until_led(changes.clone(), by(1), || std::future::ready(NetworkPath::Nowhere)).await;
    assert!(timeout(20 * BETWEEN, gone()).await.is_err(), "that there is no way any more is nothing to go by");
}

/// Queries have a minimum interval, however many notifications arrive.
#[tokio::test]
async fn a_stream_of_news_is_no_stream_of_questions() {
    let (told, changes) = watch::channel(());
    let asked = std::cell::Cell::new(0);
    let look = || {
        asked.set(asked.get() + 1);
        told.send_replace(());
        std::future::ready(by(1))
    };
    assert!(timeout(20 * BETWEEN, until_other(changes, by(1), look)).await.is_err());
    assert!((2..=21).contains(&asked.get()), "{asked:?}");
}

const LONG: Duration = Duration::from_secs(60);

fn by(interface: u32) -> NetworkPath {
    NetworkPath::By(Exit { interface, carrier: 0, source: None, router: None })
}
