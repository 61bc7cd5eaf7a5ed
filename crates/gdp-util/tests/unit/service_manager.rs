//! A socket in the service manager's place receives the notifications.

use std::os::linux::net::SocketAddrExt as _;

use super::*;

const WATCHDOG: Duration = Duration::from_secs(10);

struct Received(UnixDatagram);

impl Received {
    fn next(&self) -> Option<String> {
        let mut buffer = [0; 2048];
        let length = self.0.recv(&mut buffer).ok()?;
        Some(String::from_utf8_lossy(&buffer[..length]).into_owned())
    }
}

fn at_path() -> (tempfile::TempDir, Received, ServiceManager) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_nonblocking(true).unwrap();
    let manager = ServiceManager::connect(path.as_os_str(), Some(WATCHDOG)).unwrap();
    (folder, Received(socket), manager)
}

#[test]
fn it_is_ready_reloads_and_stops_with_a_status() {
    let (_folder, received, mut manager) = at_path();
    manager.ready("3 links\nREADY=0");
    assert_eq!(received.next().as_deref(), Some("READY=1\nSTATUS=3 links READY=0"));
    manager.reloading();
    let text = received.next().unwrap();
    let time = text.strip_prefix("RELOADING=1\nMONOTONIC_USEC=").unwrap();
    assert!(time.parse::<u64>().unwrap() > 0);
    manager.status(&"ä".repeat(2000));
    assert_eq!(received.next().unwrap().len(), "STATUS=".len() + MAX_STATUS);
    manager.stopping();
    assert_eq!(received.next().as_deref(), Some("STOPPING=1"));
}

#[test]
fn the_watchdog_is_answered_once_in_half_of_its_time() {
    let (_folder, received, mut manager) = at_path();
    let begun = Instant::now();
    manager.alive(begun);
    assert_eq!(received.next().as_deref(), Some("WATCHDOG=1"));
    manager.alive(begun + WATCHDOG / 2 - Duration::from_millis(1));
    assert_eq!(received.next(), None);
    manager.alive(begun + WATCHDOG / 2);
    assert_eq!(received.next().as_deref(), Some("WATCHDOG=1"));
}

#[test]
fn abstract_sockets_are_reached_and_others_refused() {
    let name = format!("gdp-service-manager-{}", std::process::id());
    let address = SocketAddr::from_abstract_name(&name).unwrap();
    let received = Received(UnixDatagram::bind_addr(&address).unwrap());
    let mut manager = ServiceManager::connect(OsStr::new(&format!("@{name}")), None).unwrap();
    manager.ready("");
    assert_eq!(received.next().as_deref(), Some("READY=1\nSTATUS="));
    // Without a watchdog, nothing is sent.
    manager.alive(Instant::now());
    manager.stopping();
    assert_eq!(received.next().as_deref(), Some("STOPPING=1"));
    assert!(ServiceManager::connect(OsStr::new("vsock:2:1"), None).is_err());
}

#[test]
fn a_service_manager_that_does_not_read_stops_nothing() {
    let (_folder, _received, manager) = at_path();
    (0..10_000).for_each(|_| manager.stopping());
    ServiceManager::default().stopping();
}
