//! Unit tests of `doctor`.

use super::*;
use gdp_dataplane::device::{AttachedProgram, Device, Offloads};
use gdp_dataplane::kernel::Mode;
use gdp_dataplane::xdp_features::Features;

/// Native XDP, redirects and several buffers.
const ALL_FEATURES: Features = Features(1 | 1 << 1 | 1 << 2 | 1 << 5);

#[test]
fn a_healthy_host_has_nothing_to_complain_about() {
    let findings = examine(&healthy());
    let bad: Vec<_> =
        findings.iter().filter(|finding| finding.level != Level::Ok || finding.remedy.is_some()).collect();
    assert!(bad.is_empty(), "{bad:#?}");
}

#[test]
fn whatever_is_wrong_is_found_named_and_comes_with_a_remedy() {
    type Spoil = fn(&mut Facts);
    let cases: &[(Spoil, &str, Level, &str, &str)] = &[
        (|f| f.clock.unix = 1000, "clock", Level::Failed, "since 1970", "timedatectl"),
        (|f| f.clock.synchronised = false, "clock", Level::Warning, "nothing keeps it right", "chrony"),
        (
            |f| f.kernel = KernelVersion(5, 4),
            "kernel",
            Level::Failed,
            "5.4, and XDP needs 5.15",
            "data_plane: userspace",
        ),
        (
            |f| interface(f).disturbed = Some("the driver x may reset the link".into()),
            "mode",
            Level::Warning,
            "x may reset the link",
            "--interface eth0",
        ),
        (|f| f.kernel = KernelVersion(5, 15), "kernel", Level::Warning, "MTU", "5.18"),
        (|f| f.kernel = KernelVersion(6, 1), "kernel", Level::Warning, "redirected", "6.3"),
        (
            |f| f.missing_capabilities = vec!["CAP_BPF", "CAP_PERFMON"],
            "capabilities",
            Level::Failed,
            "CAP_BPF, CAP_PERFMON",
            "root",
        ),
        (
            |f| f.losses = Err("no BTF".into()),
            "btf",
            Level::Warning,
            "cannot be counted: no BTF",
            "CONFIG_DEBUG_INFO_BTF",
        ),
        (
            |f| f.bpffs = Some(Bpffs::Occupied { path: "/x".into() }),
            "bpffs",
            Level::Warning,
            "/x holds something else",
            "null",
        ),
        (
            |f| f.bpffs = Some(Bpffs::ReadOnly { path: "/x".into(), reason: "EACCES".into() }),
            "bpffs",
            Level::Warning,
            "EACCES",
            "its owner",
        ),
        (
            |f| f.bpffs = Some(Bpffs::Missing { path: "/x".into(), may_mount: false, private: false }),
            "bpffs",
            Level::Warning,
            "may not mount it",
            "`mount -t bpf bpf /x`",
        ),
        (
            |f| f.bpffs = Some(Bpffs::Missing { path: "/x".into(), may_mount: true, private: true }),
            "bpffs",
            Level::Warning,
            "ends with it",
            "ip netns exec",
        ),
        (|f| loaded(f).jitted = Some(false), "jit", Level::Warning, "interprets", "bpf_jit_enable"),
        (
            |f| udp_of(f).state = PortState::Taken(None),
            "udp port",
            Level::Failed,
            "another program has 0.0.0.0:31415",
            "another port",
        ),
        (
            |f| udp_of(f).state = PortState::Taken(Some("nc".into())),
            "udp port",
            Level::Failed,
            "nc has 0.0.0.0:31415",
            "end it",
        ),
        (|f| udp_of(f).state = PortState::Refused("not here".into()), "udp port", Level::Failed, "not here", "`udp`"),
        (|f| udp_of(f).zero_checksum_v6 = Err("no IPv6".into()), "udp over ipv6", Level::Warning, "no IPv6", "IPv4"),
        (|f| f.left_over = vec![left(ABI, true)], "pins", Level::Warning, "/pins still forwards", "xdp detach"),
        (|f| f.left_over = vec![left(ABI, false)], "pins", Level::Warning, "another network namespace", "xdp detach"),
        (|f| f.left_over = vec![left(ABI + 1, true)], "pins", Level::Failed, "another version", "xdp detach"),
        (|f| f.interfaces = Ok(vec![Err("eth7".into())]), "interface", Level::Failed, "none of this name", "`ip link`"),
        (|f| interface(f).device.up = false, "state", Level::Failed, "down", "`ip link set dev eth0 up`"),
        (|f| interface(f).device.running = false, "state", Level::Warning, "carrier", "plug it in"),
        (|f| interface(f).device.ethernet = false, "state", Level::Failed, "not an Ethernet", "UDP"),
        (|f| interface(f).device.mtu = 1000, "mtu", Level::Failed, "1000, and QUIC needs 1248", "mtu 1248"),
        (
            |f| {
                (interface(f).device.program, interface(f).owner) = (Some(foreign()), Owner::Foreign);
            },
            "program",
            Level::Failed,
            "another XDP program is attached: program 42 `drop_all`, in native mode",
            "xdpdrv off",
        ),
        (|f| interface(f).features = Some(Features(0)), "mode", Level::Warning, "no native XDP", "driver"),
        (
            |f| (interface(f).device.mtu, interface(f).features) = (9000, Some(Features(7))),
            "buffers",
            Level::Warning,
            "9000 takes several buffers",
            "mtu 3506",
        ),
        (
            |f| interface(f).features = Some(Features(3)),
            "redirects",
            Level::Warning,
            "its peer neither has GRO",
            "gro on",
        ),
        (|f| interface(f).offloads.lro = Some(true), "offloads", Level::Warning, "LRO", "ethtool -K eth0 lro off"),
        (
            |f| interface(f).offloads.tx_checksum = Some(true),
            "offloads",
            Level::Warning,
            "unfinished checksums",
            "tx off",
        ),
        (
            |f| (interface(f).offloads.rx_vlan, interface(f).has_vlans) = (Some(true), true),
            "offloads",
            Level::Warning,
            "takes the tag off",
            "rxvlan off",
        ),
    ];
    for (spoil, check, level, fact, remedy) in cases {
        let mut facts = healthy();
        spoil(&mut facts);
        let findings = examine(&facts);
        let found = findings.iter().find(|f| f.check == *check && f.level == *level && f.fact.contains(fact));
        let found = found.unwrap_or_else(|| panic!("{check}: {fact}: {findings:#?}"));
        assert!(found.remedy.as_deref().unwrap_or_default().contains(remedy), "{found:?}");
        let others: Vec<_> = findings.iter().filter(|f| f.level == Level::Failed && f.check != *check).collect();
        assert!(others.is_empty(), "{check} made more fail: {others:?}");
    }
}

#[test]
fn an_object_that_does_not_load_is_told_in_its_own_words() {
    let facts = Facts { object: Err("not enough memory for the FIB: set `fib_capacity` lower".into()), ..healthy() };
    let findings = examine(&facts);
    let found = findings.iter().find(|finding| finding.check == "ebpf object").unwrap();
    assert_eq!((found.level, found.remedy.as_deref()), (Level::Failed, None));
    assert!(found.fact.contains("fib_capacity"));
}

#[test]
fn where_no_xdp_is_wanted_it_is_not_looked_for() {
    let mut facts = Facts { object: Err("x".into()), kernel: KernelVersion(4, 9), ..healthy() };
    facts.wanted = Wanted::Userspace("it was asked for");
    (interface(&mut facts).device.program, interface(&mut facts).owner) = (Some(foreign()), Owner::Foreign);
    let findings = examine(&facts);
    assert!(findings.iter().all(|finding| finding.level == Level::Ok), "{findings:#?}");
}

/// In generic mode, frames leave like any other packet, so no interface needs `ndo_xdp_xmit`.
#[test]
fn redirects_matter_only_beside_native_xdp() {
    let mut facts = healthy();
    interface(&mut facts).features = Some(Features(0));
    assert!(examine(&facts).iter().all(|finding| finding.check != "redirects"));
    let mut both = healthy();
    let second = interface(&mut facts).clone();
    both.interfaces.as_mut().unwrap().push(Ok(second));
    let warned = examine(&both).into_iter().filter(|f| f.check == "redirects" && f.level == Level::Warning).count();
    assert_eq!(warned, 1);
}

#[test]
fn dpdk_is_told_of_its_devices() {
    let mut facts = healthy();
    let device = interface(&mut facts).device.clone();
    let port = |state| DpdkPort { interface: "gdp0".into(), name: "net_x0".into(), state };
    let with = |found| port(DpdkDevice::Interface { name: "eth0".into(), found });
    let good = Dpdk { built: true, root: true, huge_pages: Some(2), ports: vec![with(Some(device.clone()))] };
    let mut judged = |dpdk: Dpdk| {
        (facts.wanted, facts.dpdk) = (Wanted::Dpdk, Some(dpdk));
        examine(&facts)
    };
    let findings = judged(good.clone());
    assert!(findings.iter().all(|finding| finding.level == Level::Ok), "{findings:#?}");
    assert!(!findings.iter().any(|finding| finding.check == "ebpf object"), "{findings:#?}");
    let (down, dark) = (Device { up: false, ..device.clone() }, Device { running: false, ..device });
    let of = |state| Dpdk { ports: vec![port(state)], ..good.clone() };
    for (dpdk, check, level, fact, remedy) in [
        (Dpdk { built: false, ..good.clone() }, "data plane", Level::Failed, "without the feature", "cargo build"),
        (Dpdk { root: false, ..good.clone() }, "data plane", Level::Failed, "not root", "root"),
        (Dpdk { huge_pages: Some(0), ..good.clone() }, "huge pages", Level::Failed, "none", "nr_hugepages"),
        (Dpdk { ports: vec![with(None)], ..good.clone() }, "device", Level::Failed, "no interface eth0", "iface="),
        (Dpdk { ports: vec![with(Some(down))], ..good.clone() }, "device", Level::Failed, "eth0 is down", "eth0 up"),
        (Dpdk { ports: vec![with(Some(dark))], ..good.clone() }, "device", Level::Warning, "carrier", "plug it in"),
        (of(DpdkDevice::Card(None)), "device", Level::Failed, "no such card", "lspci -D"),
        (of(DpdkDevice::Card(Some(None))), "device", Level::Warning, "bound to nothing", "--bind=vfio-pci net_x0"),
        (of(DpdkDevice::Card(Some(Some("igc".into())))), "device", Level::Warning, "bound to igc", "vfio-pci"),
        (of(DpdkDevice::Card(Some(Some("vfio-pci".into())))), "device", Level::Ok, "bound to vfio-pci", ""),
        (of(DpdkDevice::Other), "device", Level::Ok, "when the daemon starts", ""),
    ] {
        let findings = judged(dpdk);
        let found = findings.iter().find(|finding| finding.check == check && finding.fact.contains(fact));
        let found = found.unwrap_or_else(|| panic!("{fact}: {findings:#?}"));
        assert_eq!(found.level, level, "{found:?}");
        assert!(found.remedy.as_deref().unwrap_or_default().contains(remedy), "{found:?}");
    }
}

fn healthy() -> Facts {
    let device = Device {
        name: "eth0".into(),
        index: 2,
        ethernet: true,
        up: true,
        running: true,
        mtu: 1500,
        kind: "veth".into(),
        lower: Some(3),
        program: None,
    };
    let offloads = Offloads { lro: Some(false), tx_checksum: Some(false), rx_vlan: Some(true) };
    Facts {
        clock: Clock { unix: SANE.start + 1, synchronised: true },
        wanted: Wanted::Xdp,
        dpdk: None,
        kernel: KernelVersion(6, 18),
        missing_capabilities: Vec::new(),
        losses: Ok(()),
        bpffs: Some(Bpffs::Mounted { path: "/sys/fs/bpf".into() }),
        object: Ok(Loaded { object: "the XDP programs in this executable".into(), names: 65536, jitted: Some(true) }),
        left_over: vec![LeftOver { daemon: true, ..left(ABI, true) }],
        udp: Some(UdpFacts {
            address: "0.0.0.0:31415".parse().unwrap(),
            state: PortState::Free,
            zero_checksum_v6: Ok(()),
        }),
        interfaces: Ok(vec![Ok(Interface {
            device,
            offloads,
            features: Some(ALL_FEATURES),
            disturbed: None,
            owner: Owner::Switch,
            has_vlans: false,
        })]),
    }
}

fn left(abi: u32, here: bool) -> LeftOver {
    LeftOver { folder: "/pins".into(), abi, daemon: false, here }
}

fn foreign() -> AttachedProgram {
    AttachedProgram {
        interface: "eth0".into(),
        id: 42,
        name: "drop_all".into(),
        mode: Mode::Native,
        by_link: Some(false),
    }
}

fn interface(facts: &mut Facts) -> &mut Interface {
    facts.interfaces.as_mut().unwrap()[0].as_mut().unwrap()
}

fn loaded(facts: &mut Facts) -> &mut Loaded {
    facts.object.as_mut().unwrap()
}

fn udp_of(facts: &mut Facts) -> &mut UdpFacts {
    facts.udp.as_mut().unwrap()
}
