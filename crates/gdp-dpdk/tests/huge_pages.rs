//! DPDK with huge pages. The test needs root to reserve huge pages while it runs. It is a separate
//! process, because each process can initialize DPDK only once.

use std::fs;
use std::time::Duration;

use gdp_dpdk::{Burst, Eal, EalConfig, Memory, Pool, Port, PortConfig};

const RESERVED: &str = "/proc/sys/vm/nr_hugepages";

/// Number of huge pages for DPDK.
const WANTED: u64 = 48;

/// Huge pages reserved in addition to the existing number.
struct Pages {
    before: u64,
}

impl Pages {
    fn reserve() -> Self {
        let before = count("HugePages_Total:");
        let pages = Self { before };
        // Used memory may be fragmented, so try several times.
        for _ in 0..10 {
            fs::write(RESERVED, (before + WANTED).to_string()).expect("root reserves huge pages");
            if count("HugePages_Free:") >= WANTED {
                return pages;
            }
            fs::write("/proc/sys/vm/drop_caches", "3").expect("root empties caches");
            fs::write("/proc/sys/vm/compact_memory", "1").expect("root compacts memory");
            std::thread::sleep(Duration::from_secs(1));
        }
        panic!("this machine has no memory left for {WANTED} huge pages");
    }
}

impl Drop for Pages {
    fn drop(&mut self) {
        // DPDK's pages are freed when this process ends.
        fs::write(RESERVED, self.before.to_string()).expect("root gives huge pages back");
    }
}

/// Returns a value from the kernel's memory statistics.
fn count(of: &str) -> u64 {
    let all = fs::read_to_string("/proc/meminfo").unwrap();
    let line = all.lines().find_map(|line| line.strip_prefix(of));
    line.and_then(|rest| rest.split_whitespace().next()).and_then(|number| number.parse().ok()).unwrap()
}

#[test]
fn packets_lie_in_huge_pages_and_none_is_lost() {
    let _pages = Pages::reserve();
    let free = count("HugePages_Free:");
    let eal = Eal::begin(&EalConfig { memory: Memory::HugePages, pci: Vec::new() }).expect("DPDK begins");
    let pool = Pool::new(eal, 16383, 2048).unwrap();
    // The packets alone need more.
    assert!(free - count("HugePages_Free:") >= 16, "{} of {free} are free", count("HugePages_Free:"));

    let device = PortConfig { device: "net_null0,size=200".into(), receive_queues: 1, send_queues: 1, mtu: 1500 };
    let (port, mut receives, mut sends) = Port::open(eal, &device, &pool).unwrap();
    for _ in 0..1000 {
        let mut burst = Burst::new();
        assert_eq!(receives[0].receive(&mut burst), Burst::SIZE);
        assert!(burst.iter_mut().all(|mbuf| mbuf.bytes_mut().is_some_and(|bytes| bytes.len() == 200)));
        assert_eq!(sends[0].send(&mut burst), 0);
    }
    drop((port, receives, sends));
    assert_eq!(pool.in_use(), 0);
}
