//! Ports: devices that DPDK drives, and their receive and send queues.

use std::collections::BTreeSet;
use std::ffi::{CStr, CString, c_void};
use std::sync::Arc;

use crate::mbuf::{Burst, Pool};
use crate::{DpdkError, Eal, sys};
use parking_lot::Mutex;

/// Number of descriptors in each queue, unless the device requires another number.
const DESCRIPTORS: u16 = 1024;

/// Maximum number of packets in a queue. The rings of `net_af_xdp` have this size, regardless of
/// the requested size.
pub(crate) const MAX_QUEUED: usize = 2048;

/// Default MTU of a device.
const DEFAULT_MTU: u16 = 1500;

/// Size in bytes of an Ethernet header and the trailing checksum.
const ETHERNET: u32 = 14 + 4;

/// Input of the hash that spreads packets over queues: fields that differ between UDP flows. Frames
/// on Ethernet lack these fields, so they all arrive at the first queue.
const SPREAD_BY: u64 = sys::GDP_SPREAD_BY;

/// A device and its configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortConfig {
    /// Device in DPDK notation: a PCI address, or a driver name with a suffix and arguments, such
    /// as `net_af_packet_e0,iface=e0`.
    pub device: String,
    /// Maximum number of receive queues: one for each loop.
    pub receive_queues: u16,
    /// Maximum number of send queues.
    pub send_queues: u16,
    /// Size in bytes of the largest packet without its Ethernet header.
    pub mtu: u16,
}

/// A device on which packets arrive and leave. It stays in use until its queues are dropped as
/// well.
pub struct Port(Arc<Device>);

/// A receive queue.
pub struct Receive {
    device: Arc<Device>,
    queue: u16,
}

/// A send queue.
pub struct Send {
    device: Arc<Device>,
    queue: u16,
}

struct Device {
    id: u16,
    name: String,
    _claim: Claim,
    mac: [u8; 6],
    mtu: u16,
    /// Whether the device accepts chained packets.
    gathers: bool,
    numa: i32,
    handle: *mut sys::rte_device,
    /// Pool of received packets.
    _pool: Pool,
    _eal: Eal,
}

/// Exclusive claim of a device within this process.
struct Claim(String);

static CLAIMED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());

impl Claim {
    fn of(name: &str) -> Option<Self> {
        let is_new = CLAIMED.lock().insert(name.to_owned());
        is_new.then(|| Self(name.to_owned()))
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        CLAIMED.lock().remove(&self.0);
    }
}

// SAFETY: DPDK owns the memory behind the pointer. The pointer is used only once more, when the
// last reference to the device is dropped.
unsafe impl std::marker::Send for Device {}
// SAFETY: as above.
unsafe impl Sync for Device {}

/// Counters of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    pub received: u64,
    pub sent: u64,
    /// Packets that arrived and were lost because the queue was full, no mbuf was available, or
    /// they were corrupt.
    pub missed: u64,
    /// Packets passed to the device that did not leave.
    pub failed: u64,
}

impl Port {
    /// Opens a device in the network namespace of the calling thread. Returns its queues: possibly
    /// fewer than requested, but at least one of each kind.
    pub fn open(eal: Eal, config: &PortConfig, pool: &Pool) -> Result<(Self, Vec<Receive>, Vec<Send>), DpdkError> {
        let what = |doing: &str| format!("device {}: {doing}", config.device);
        let fail = |doing: &'static str| move |code: i32| DpdkError::check(code, || what(doing));
        let text = CString::new(config.device.as_str()).map_err(|_| DpdkError::new(what("its name"), libc::EINVAL))?;
        let name = config.device.split(',').next().unwrap_or_default().to_owned();
        // DPDK would return the same device again.
        let claim = Claim::of(&name).ok_or_else(|| DpdkError::new(what("its name is taken"), libc::EEXIST))?;
        // SAFETY: the string outlives the call.
        fail("no driver takes it")(unsafe { sys::rte_dev_probe(text.as_ptr()) })?;
        let short = CString::new(name.as_str()).map_err(|_| DpdkError::new(what("its name"), libc::EINVAL))?;
        let mut id = 0;
        // SAFETY: the string outlives the call, and the result pointer is valid.
        fail("it is no network device")(unsafe { sys::rte_eth_dev_get_port_by_name(short.as_ptr(), &raw mut id) })?;
        let info = info(id).map_err(|code| DpdkError::new(what("it tells nothing of itself"), code))?;
        let mut device = Device {
            id,
            name,
            _claim: claim,
            mac: [0; 6],
            mtu: config.mtu,
            gathers: info.tx_offload_capa & sys::GDP_GATHERS != 0,
            // SAFETY: the port exists.
            numa: unsafe { sys::rte_eth_dev_socket_id(id) },
            handle: info.device,
            _pool: pool.clone(),
            _eal: eal,
        };
        // From here on, dropping `device` releases the device.
        let receives = config.receive_queues.clamp(1, info.max_rx_queues.max(1));
        let sends = config.send_queues.clamp(1, info.max_tx_queues.max(1));
        let mtu = configured_mtu(&info, config.mtu).map_err(|most| {
            let what = what(&format!("it takes no MTU of {}, but one from {} to {most}", config.mtu, info.min_mtu));
            DpdkError::new(what, libc::EINVAL).with_remedy("; choose another `mtu` for it")
        })?;
        fail("it takes no such queues")(configure(id, &info, (receives, sends), mtu))?;
        let (mut arriving, mut leaving) = (DESCRIPTORS, DESCRIPTORS);
        // SAFETY: the port exists, and both result pointers are valid.
        fail("it takes no such queues")(unsafe {
            sys::rte_eth_dev_adjust_nb_rx_tx_desc(id, &raw mut arriving, &raw mut leaving)
        })?;
        let numa = device.numa as u32;
        for queue in 0..receives {
            // SAFETY: the port exists and is stopped; the pool lives at least as long as the port.
            let code = unsafe { sys::rte_eth_rx_queue_setup(id, queue, arriving, numa, std::ptr::null(), pool.raw()) };
            fail("a queue to receive by")(code)?;
        }
        for queue in 0..sends {
            // SAFETY: the port exists and is stopped.
            let code = unsafe { sys::rte_eth_tx_queue_setup(id, queue, leaving, numa, std::ptr::null()) };
            fail("a queue to send by")(code)?;
        }
        // SAFETY: the queues of the port are set up.
        fail("it does not start")(unsafe { sys::rte_eth_dev_start(id) })?;
        // SAFETY: the port exists. A device without promiscuous mode receives only packets to its
        // own address, which suffices.
        unsafe { sys::rte_eth_promiscuous_enable(id) };
        device.mac = mac(id).map_err(|code| DpdkError::new(what("it has no address"), code))?;
        let device = Arc::new(device);
        let receives = (0..receives).map(|queue| Receive { device: device.clone(), queue }).collect();
        let sends = (0..sends).map(|queue| Send { device: device.clone(), queue }).collect();
        Ok((Self(device), receives, sends))
    }

    /// Returns the device without its arguments.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    pub fn mac(&self) -> [u8; 6] {
        self.0.mac
    }

    /// Returns the size in bytes of the largest packet without its Ethernet header.
    pub fn mtu(&self) -> u16 {
        self.0.mtu
    }

    /// Returns whether the driver reports a carrier. Also returns `true` if the driver cannot tell.
    pub fn has_carrier(&self) -> bool {
        let mut link = sys::rte_eth_link::default();
        // SAFETY: the port exists, and the result pointer is valid.
        let code = unsafe { sys::rte_eth_link_get_nowait(self.0.id, &raw mut link) };
        code < 0 || link.link_status() != 0
    }

    pub fn counters(&self) -> PortCounters {
        let mut stats = sys::rte_eth_stats::default();
        // SAFETY: the port exists, and the result pointer is valid.
        unsafe { sys::rte_eth_stats_get(self.0.id, &raw mut stats) };
        PortCounters {
            received: stats.ipackets,
            sent: stats.opackets,
            missed: stats.imissed + stats.ierrors + stats.rx_nombuf,
            failed: stats.oerrors,
        }
    }
}

impl Receive {
    /// Appends arrived packets to the burst. Returns their number.
    pub fn receive(&mut self, burst: &mut Burst) -> usize {
        // SAFETY: the queue belongs to a running port, no other code uses it, and the array has
        // enough room.
        burst.fill(|room, count| unsafe { sys::gdp_rx_burst(self.device.id, self.queue, room.cast(), count) })
    }
}

impl Send {
    /// Sends all packets of the burst. Returns the number of packets that did not fit, which are
    /// lost.
    pub fn send(&mut self, burst: &mut Burst) -> usize {
        // SAFETY: the queue belongs to a running port, and no other code uses it. The array has
        // this number of packets, which the device then owns.
        burst.empty(|mbufs, count| unsafe { sys::gdp_tx_burst(self.device.id, self.queue, mbufs.cast(), count) })
    }

    /// Returns whether packets may be chained.
    pub fn gathers(&self) -> bool {
        self.device.gathers
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: the port exists, and nothing uses it any more. Stopping a stopped port has no
        // effect.
        let result = unsafe {
            sys::rte_eth_dev_stop(self.id);
            sys::rte_eth_dev_close(self.id);
            sys::rte_dev_remove(self.handle)
        };
        if result < 0 {
            let error = DpdkError::new(format!("device {}", self.name), result);
            tracing::warn!(%error, "a device stays in use");
        }
    }
}

fn info(port: u16) -> Result<sys::rte_eth_dev_info, i32> {
    let mut info = sys::rte_eth_dev_info::default();
    // SAFETY: the result pointer is valid.
    match unsafe { sys::rte_eth_dev_info_get(port, &raw mut info) } {
        0 => Ok(info),
        code => Err(code),
    }
}

fn mac(port: u16) -> Result<[u8; 6], i32> {
    let mut mac = [0u8; 6];
    // SAFETY: the result pointer is valid for six bytes.
    match unsafe { sys::rte_eth_macaddr_get(port, mac.as_mut_ptr().cast::<c_void>().cast()) } {
        0 => Ok(mac),
        code => Err(code),
    }
}

/// Returns the MTU to configure if the device supports this MTU; otherwise the largest MTU it
/// supports.
fn configured_mtu(info: &sys::rte_eth_dev_info, mtu: u16) -> Result<u16, u16> {
    // SAFETY: this is the name of a loaded driver.
    let driver = unsafe { CStr::from_ptr(info.driver_name) };
    // This driver reports 1518 bytes regardless of its frame size, and ignores its MTU.
    if driver == c"net_af_packet" {
        return Ok(mtu.min(DEFAULT_MTU));
    }
    // DPDK computes it in the same way: with the checksum, unless the device reports its overhead
    // besides the MTU.
    let beside = match info.max_rx_pktlen.checked_sub(info.max_mtu.into()) {
        Some(beside) if info.max_mtu != u16::MAX && beside > 0 => beside,
        _ => ETHERNET,
    };
    let most = info.max_rx_pktlen.saturating_sub(beside).min(info.max_mtu.into()) as u16;
    if (info.min_mtu..=most).contains(&mtu) { Ok(mtu) } else { Err(most) }
}

fn configure(port: u16, info: &sys::rte_eth_dev_info, (receives, sends): (u16, u16), mtu: u16) -> i32 {
    let mut conf = sys::rte_eth_conf::default();
    conf.rxmode.mtu = mtu.into();
    let spread = info.flow_type_rss_offloads & SPREAD_BY;
    if receives > 1 && spread != 0 {
        conf.rxmode.mq_mode = sys::rte_eth_rx_mq_mode_RTE_ETH_MQ_RX_RSS;
        conf.rx_adv_conf.rss_conf.rss_hf = spread;
    }
    // Offloads for chained packets, if the device supports them.
    conf.txmode.offloads = info.tx_offload_capa & sys::GDP_GATHERS;
    // SAFETY: the port exists and is stopped, and the configuration outlives the call.
    unsafe { sys::rte_eth_dev_configure(port, receives, sends, &raw const conf) }
}
