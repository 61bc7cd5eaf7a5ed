//! Sends packets through devices that need no network. The pools' counts prove that no path leaks
//! packets.

use gdp_dpdk::{Burst, Eal, EalConfig, Pool, Port, PortConfig};
use parking_lot::{Mutex, MutexGuard};

/// Lets one test run at a time: the process has a single DPDK, and the counts must come from one
/// test.
static TURN: Mutex<()> = Mutex::new(());

fn begin() -> (Eal, MutexGuard<'static, ()>) {
    let turn = TURN.lock();
    (Eal::begin(&EalConfig::default()).expect("DPDK begins without huge pages"), turn)
}

fn device(name: &str) -> PortConfig {
    PortConfig { device: name.into(), receive_queues: 1, send_queues: 1, mtu: 1500 }
}

#[test]
fn a_pool_gives_what_it_has_and_gets_it_back() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 511, 2048).unwrap();
    let held: Vec<_> = std::iter::from_fn(|| pool.alloc()).collect();
    assert_eq!((held.len(), pool.in_use(), pool.size()), (511, 511, 511));
    drop(held);
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn packets_are_reshaped_within_their_room_only() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 63, 2000).unwrap();
    let mut mbuf = pool.alloc().unwrap();
    assert!(mbuf.is_empty() && mbuf.reshape(0, 2000) && !mbuf.reshape(0, 2001) && mbuf.len() == 2000);
    mbuf.bytes_mut().unwrap()[..3].copy_from_slice(&[1, 2, 3]);
    assert!(mbuf.reshape(-1, 2) && mbuf.bytes() == [2, 3]);
    assert!(mbuf.reshape(1, 3) && mbuf.bytes() == [1, 2, 3]);
    assert!(mbuf.reshape(128, 3) && !mbuf.reshape(1, 3) && mbuf.len() == 3, "no more headroom");
    assert!(!mbuf.reshape(isize::MIN, 1) && !mbuf.reshape(isize::MAX, 1));
    drop(mbuf);
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn nothing_is_lost_in_a_ring_or_with_a_port_that_goes() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 4095, 2048).unwrap();
    for _ in 0..3 {
        let (port, mut receives, mut sends) = Port::open(eal, &device("net_ring0"), &pool).unwrap();
        let (receive, send) = (&mut receives[0], &mut sends[0]);
        for round in 0..100 {
            let mut burst = Burst::new();
            while !burst.is_full() {
                let mut mbuf = pool.alloc().unwrap();
                assert!(mbuf.reshape(0, 60 + round));
                burst.push(mbuf).ok().unwrap();
            }
            let lost = send.send(&mut burst);
            assert!(burst.is_empty());
            let mut got = Burst::new();
            assert_eq!(receive.receive(&mut got) + lost, Burst::SIZE);
            assert!(got.iter().all(|mbuf| mbuf.len() == 60 + round));
            // The burst drops half of the packets, and the caller of `drain` drops the other half.
            if round % 2 == 0 {
                assert_eq!(got.drain().take(5).count(), 5);
            }
        }
        assert_eq!(port.counters().sent, 6400);
        // Some packets remain in the device.
        let mut burst = Burst::new();
        burst.push(pool.alloc().unwrap()).ok().unwrap();
        assert_eq!(send.send(&mut burst), 0);
        let mut last = Burst::new();
        assert_eq!(receive.receive(&mut last), 1);
        drop((last, port, receives, sends));
        assert_eq!(pool.in_use(), 0);
    }
}

/// A second port would be the same device, and would close it.
#[test]
fn a_device_is_opened_once() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 1023, 2048).unwrap();
    let opened = Port::open(eal, &device("net_null1,size=64"), &pool).unwrap();
    let again = Port::open(eal, &device("net_null1,size=128"), &pool).err().unwrap().to_string();
    assert!(again.contains("taken"), "{again}");
    drop(opened);
    let (_port, mut receives, _) = Port::open(eal, &device("net_null1,size=128"), &pool).unwrap();
    let mut burst = Burst::new();
    assert!(receives[0].receive(&mut burst) > 0 && burst[0].len() == 128);
}

/// Packets retain their memory after the last reference to the pool is dropped.
#[test]
fn packets_outlive_their_pool() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 63, 2048).unwrap();
    let mut mbuf = pool.alloc().unwrap();
    drop(pool);
    assert!(mbuf.reshape(0, 100));
    mbuf.bytes_mut().unwrap().fill(7);
    assert_eq!(mbuf.to_vec(), [7; 100]);
}

#[test]
fn nothing_is_lost_with_a_device_that_makes_packets() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 4095, 2048).unwrap();
    let (port, mut receives, mut sends) = Port::open(eal, &device("net_null0,size=200"), &pool).unwrap();
    for _ in 0..1000 {
        let mut burst = Burst::new();
        assert_eq!(receives[0].receive(&mut burst), Burst::SIZE);
        assert!(burst.iter().all(|mbuf| mbuf.is_linear() && mbuf.bytes().len() == 200));
        assert_eq!(sends[0].send(&mut burst), 0);
    }
    drop((port, receives, sends));
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn what_cannot_be_opened_is_named() {
    let (eal, _turn) = begin();
    let pool = Pool::new(eal, 63, 2048).unwrap();
    for name in ["net_nonsense0", "net_af_packet0,iface=nowhere", "0000:ff:1f.7", "a\0b"] {
        let error = Port::open(eal, &device(name), &pool).err().expect(name).to_string();
        assert!(error.contains(name), "{error}");
    }
    let otherwise = Eal::begin(&EalConfig { pci: vec!["0000:ff:1f.7".into()], ..EalConfig::default() });
    assert!(otherwise.unwrap_err().to_string().contains("already"));
    assert_eq!(pool.in_use(), 0);
}
