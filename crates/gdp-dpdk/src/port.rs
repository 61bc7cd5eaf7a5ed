//! Ports: devices that DPDK drives, and the queues that packets come and go by.

use std::collections::BTreeSet;
use std::ffi::{CStr, CString, c_void};
use std::sync::Arc;

use crate::mbuf::{Burst, Pool};
use crate::{DpdkError, Eal, sys};
use parking_lot::Mutex;

/// Places in each queue, unless the device wants others.
const DESCRIPTORS: u16 = 1024;

/// Packets that a queue may hold: `net_af_xdp` has rings of so many, whatever it is asked for.
pub(crate) const HELD: usize = 2048;

/// Of a device that is told no other.
const DEFAULT_MTU: u16 = 1500;

/// Bytes of an Ethernet header and of the checksum at the end.
const ETHERNET: u32 = 14 + 4;

/// Seen by the hash that spreads packets over queues: what UDP frames differ in. Frames on Ethernet
/// have no such thing, and all come by the first queue.
const SPREAD_BY: u64 = sys::GDP_SPREAD_BY;

/// A device, and how it is used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortConfig {
    /// As DPDK writes devices: a PCI address, or a driver's name with a number or text behind it,
    /// and arguments of it: `net_af_packet_e0,iface=e0`.
    pub device: String,
    /// By which packets arrive, at most: one for each loop.
    pub receive_queues: u16,
    /// By which packets leave, at most.
    pub send_queues: u16,
    /// Bytes of the largest packet behind its Ethernet header.
    pub mtu: u16,
}

/// A device that packets arrive at and leave by. It stays in use until its queues are gone as well.
pub struct Port(Arc<Device>);

/// A queue that packets arrive by.
pub struct Receive {
    device: Arc<Device>,
    queue: u16,
}

/// A queue that packets leave by.
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
    /// Takes packets that are chains.
    gathers: bool,
    numa: i32,
    handle: *mut sys::rte_device,
    /// What arrives comes from here.
    _pool: Pool,
    _eal: Eal,
}

/// That nobody else in this process has the device.
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

// SAFETY: what is behind the pointer belongs to DPDK, which is asked for the device once more: when
// the last one lets go of it.
unsafe impl std::marker::Send for Device {}
// SAFETY: as above.
unsafe impl Sync for Device {}

/// What a device has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    pub received: u64,
    pub sent: u64,
    /// Arrived, and were lost because nobody took them in time, there was no mbuf for them, or they
    /// were broken.
    pub missed: u64,
    /// Handed over, and did not leave.
    pub failed: u64,
}

impl Port {
    /// Begins to use a device, in the network namespace of the calling thread. With it come its
    /// queues: perhaps fewer than were wanted, but one of each.
    pub fn open(eal: Eal, config: &PortConfig, pool: &Pool) -> Result<(Self, Vec<Receive>, Vec<Send>), DpdkError> {
        let what = |doing: &str| format!("device {}: {doing}", config.device);
        let fail = |doing: &'static str| move |code: i32| DpdkError::check(code, || what(doing));
        let text = CString::new(config.device.as_str()).map_err(|_| DpdkError::new(what("its name"), libc::EINVAL))?;
        let name = config.device.split(',').next().unwrap_or_default().to_owned();
        // DPDK would give the same device again.
        let claim = Claim::of(&name).ok_or_else(|| DpdkError::new(what("its name is taken"), libc::EEXIST))?;
        // SAFETY: a string that lives during the call.
        fail("no driver takes it")(unsafe { sys::rte_dev_probe(text.as_ptr()) })?;
        let short = CString::new(name.as_str()).map_err(|_| DpdkError::new(what("its name"), libc::EINVAL))?;
        let mut id = 0;
        // SAFETY: a string that lives during the call, and a place for the answer.
        fail("it is no network device")(unsafe { sys::rte_eth_dev_get_port_by_name(short.as_ptr(), &raw mut id) })?;
        let info = info(id).map_err(|code| DpdkError::new(what("it tells nothing of itself"), code))?;
        let mut device = Device {
            id,
            name,
            _claim: claim,
            mac: [0; 6],
            mtu: config.mtu,
            gathers: info.tx_offload_capa & sys::GDP_GATHERS != 0,
            // SAFETY: a port that is there.
            numa: unsafe { sys::rte_eth_dev_socket_id(id) },
            handle: info.device,
            _pool: pool.clone(),
            _eal: eal,
        };
        // From here on, dropping it lets go of the device.
        let receives = config.receive_queues.clamp(1, info.max_rx_queues.max(1));
        let sends = config.send_queues.clamp(1, info.max_tx_queues.max(1));
        let mtu = told(&info, config.mtu).map_err(|most| {
            let what = what(&format!("it takes no MTU of {}, but one from {} to {most}", config.mtu, info.min_mtu));
            DpdkError::new(what, libc::EINVAL).with_remedy("; choose another `mtu` for it")
        })?;
        fail("it takes no such queues")(configure(id, &info, (receives, sends), mtu))?;
        let (mut arriving, mut leaving) = (DESCRIPTORS, DESCRIPTORS);
        // SAFETY: a port that is there, and places for two numbers.
        fail("it takes no such queues")(unsafe {
            sys::rte_eth_dev_adjust_nb_rx_tx_desc(id, &raw mut arriving, &raw mut leaving)
        })?;
        let numa = device.numa as u32;
        for queue in 0..receives {
            // SAFETY: a port that is there and does not run; the pool lives as long as it does.
            let code = unsafe { sys::rte_eth_rx_queue_setup(id, queue, arriving, numa, std::ptr::null(), pool.raw()) };
            fail("a queue to receive by")(code)?;
        }
        for queue in 0..sends {
            // SAFETY: a port that is there and does not run.
            let code = unsafe { sys::rte_eth_tx_queue_setup(id, queue, leaving, numa, std::ptr::null()) };
            fail("a queue to send by")(code)?;
        }
        // SAFETY: a port whose queues are set up.
        fail("it does not start")(unsafe { sys::rte_eth_dev_start(id) })?;
        // SAFETY: a port that is there. What cannot do it receives what is sent to its own address,
        // which will do.
        unsafe { sys::rte_eth_promiscuous_enable(id) };
        device.mac = mac(id).map_err(|code| DpdkError::new(what("it has no address"), code))?;
        let device = Arc::new(device);
        let receives = (0..receives).map(|queue| Receive { device: device.clone(), queue }).collect();
        let sends = (0..sends).map(|queue| Send { device: device.clone(), queue }).collect();
        Ok((Self(device), receives, sends))
    }

    /// The device without its arguments.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    pub fn mac(&self) -> [u8; 6] {
        self.0.mac
    }

    /// Bytes of the largest packet behind its Ethernet header.
    pub fn mtu(&self) -> u16 {
        self.0.mtu
    }

    /// Whether the cable, or the other end, is there, as far as the driver knows.
    pub fn has_carrier(&self) -> bool {
        let mut link = sys::rte_eth_link::default();
        // SAFETY: a port that is there, and a place for the answer.
        let code = unsafe { sys::rte_eth_link_get_nowait(self.0.id, &raw mut link) };
        code < 0 || link.link_status() != 0
    }

    pub fn counters(&self) -> PortCounters {
        let mut stats = sys::rte_eth_stats::default();
        // SAFETY: a port that is there, and a place for the answer.
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
    /// Packets that have arrived, behind those that are in the burst.
    pub fn receive(&mut self, burst: &mut Burst) -> usize {
        // SAFETY: a queue of a port that runs, which nobody else uses, and room for so many.
        burst.fill(|room, count| unsafe { sys::gdp_rx_burst(self.device.id, self.queue, room.cast(), count) })
    }
}

impl Send {
    /// Sends all that is in the burst; how many there was no room for, which are gone.
    pub fn send(&mut self, burst: &mut Burst) -> usize {
        // SAFETY: a queue of a port that runs, which nobody else uses, and so many packets, which
        // are the device's then.
        burst.empty(|mbufs, count| unsafe { sys::gdp_tx_burst(self.device.id, self.queue, mbufs.cast(), count) })
    }

    /// Whether packets may be chains.
    pub fn gathers(&self) -> bool {
        self.device.gathers
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: nobody uses the port any more, and it is there; to stop one that does not run
        // does nothing.
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
    // SAFETY: a place for the answer.
    match unsafe { sys::rte_eth_dev_info_get(port, &raw mut info) } {
        0 => Ok(info),
        code => Err(code),
    }
}

fn mac(port: u16) -> Result<[u8; 6], i32> {
    let mut mac = [0u8; 6];
    // SAFETY: a place for the answer, which is six bytes.
    match unsafe { sys::rte_eth_macaddr_get(port, mac.as_mut_ptr().cast::<c_void>().cast()) } {
        0 => Ok(mac),
        code => Err(code),
    }
}

/// The MTU that a device is told, if it can have this one; otherwise the largest it can have.
fn told(info: &sys::rte_eth_dev_info, mtu: u16) -> Result<u16, u16> {
    // SAFETY: the name of a driver that is loaded.
    let driver = unsafe { CStr::from_ptr(info.driver_name) };
    // It says that it takes 1518 bytes, whatever fits into its frames, and does not look at its
    // MTU.
    if driver == c"net_af_packet" {
        return Ok(mtu.min(DEFAULT_MTU));
    }
    // As DPDK computes it: with the checksum, unless the device tells how much there is beside its
    // MTU.
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
    // What a chain needs, if the device can.
    conf.txmode.offloads = info.tx_offload_capa & sys::GDP_GATHERS;
    // SAFETY: a port that is there and does not run, and a configuration that lives during the
    // call.
    unsafe { sys::rte_eth_dev_configure(port, receives, sends, &raw const conf) }
}
