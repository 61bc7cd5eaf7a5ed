//! Unit tests of `config`.

use gdp_tests::book::{file_keys, reference};

use super::*;
use crate::store::{Access, Login};

const S: &str = "75e1000000000000000000000000000000000000000000000000000000000000";

fn parse(text: &str) -> Result<Config, String> {
    Config::parse(text, Path::new("/etc/gdp")).map_err(|error| match error {
        ParseError::Invalid(reason) => reason,
        ParseError::Folder(error) => error.to_string(),
    })
}

#[test]
fn the_reference_page_has_the_keys_of_this_file() {
    let introduction = "These are the keys of `gdp-ctl serve --config FILE`. The file is strict YAML: unknown keys \
                        are errors. The daemon reads it once, at start. Relative paths are relative to its folder. \
                        All keys of the file are optional. [Run one switch](../guide/switch.md) has an example.";
    let schema = serde_json::Value::from(schemars::schema_for!(File));
    reference::check("docs/reference/switch-file.md", &file_keys::write("The switch's file", introduction, &schema));
}

#[test]
fn the_files_in_documents_are_good() {
    for (at, text) in gdp_tests::book::files("gdp.yaml").unwrap() {
        parse(&text).unwrap_or_else(|error| panic!("{at}: {error}"));
    }
}

#[test]
fn a_whole_configuration() {
    let text = format!(
        "identity: s1.pem\nsocket: /run/s1.sock\ninterfaces: [l0, r0]\nudp: null\ndata_plane: xdp\nrib: false\n\
         neighbours: [{{interface: l0, switch: {S}, cost: 3}}]\nuplink: {{interface: l0, switch: {S}}}\n"
    );
    let config = parse(&text).unwrap();
    assert_eq!(config.identity, Path::new("/etc/gdp/s1.pem"));
    assert_eq!(config.socket, Path::new("/run/s1.sock"));
    assert_eq!((config.udp, config.data_plane, config.rib), (None, DataPlane::Xdp, false));
    assert_eq!(config.neighbours.len(), 1);
    assert_eq!(config.neighbours[0].cost, Some(3));
}

#[test]
fn what_is_left_out_has_a_default() {
    for text in ["", "identity: k.pem\nsocket: s\n"] {
        let config = parse(text).unwrap();
        assert!(config.rib && config.interfaces.is_none() && config.neighbours.is_empty(), "{text:?}");
        assert_eq!(config.udp, Some(default_udp()));
        assert_eq!(config.bpffs.as_deref(), Some(Path::new("/sys/fs/bpf")));
    }
    let config = parse(&format!("udp: '[::1]:5'\nuplink: {{udp: '127.0.0.1:9', switch: {S}}}")).unwrap();
    assert_eq!((config.udp, config.tls), (Some("[::1]:5".parse().unwrap()), None));
    assert_eq!(parse("tls: '[::]:443'").unwrap().tls, Some("[::]:443".parse().unwrap()));
    assert!(!config.rib);
    assert_eq!(config.neighbours.len(), 1, "the uplink is a neighbour");
    let config = parse(&format!("uplink: {{interface: a, switch: {S}, cost: 7}}")).unwrap();
    assert_eq!(config.neighbours[0].cost, Some(7));
    assert!(!parse(&format!("rib: false\nneighbours: [{{interface: a, switch: {S}}}]")).unwrap().rib);
    assert_eq!(parse("bpffs: null").unwrap().bpffs, None);
    assert_eq!(parse("").unwrap().crypto, None);
    assert_eq!(parse("crypto: rustcrypto").unwrap().crypto, Some(Backend::RustCrypto));
}

#[test]
fn interfaces_are_those_that_somebody_named() {
    let named = |text: &str| parse(text).unwrap().named_interfaces();
    assert!(named("").is_empty(), "none unless it is named");
    assert_eq!(named("interfaces: [a, b, a]"), ["a", "b"]);
    let near = format!("neighbours: [{{interface: a, switch: {S}}}]");
    assert_eq!(named(&near), ["a"]);
    assert_eq!(named(&format!("{near}\ninterfaces: [b, a]")), ["b", "a"]);
    assert_eq!(named(&format!("uplink: {{interface: a, switch: {S}}}")), ["a"]);
    let ports = "dpdk: {ports: [{interface: g0, device: net_null0}]}";
    assert!(named(ports).is_empty());
    assert_eq!(named(&format!("data_plane: dpdk\n{ports}")), ["g0"]);
    let mut config = parse(&near).unwrap();
    config.name_interfaces(vec!["c".into(), "a".into()]);
    assert_eq!(config.named_interfaces(), ["a", "c"]);
}

#[test]
fn a_domain_its_parents_and_who_dials() {
    let config = parse("").unwrap();
    assert_eq!(config.domain, None);
    let text = "domain: {card: domain.card, membership: /m, peers: [away.peer], members_only: true}\n";
    let domain = parse(text).unwrap().domain.unwrap();
    assert_eq!(domain.files.card, Path::new("/etc/gdp/domain.card"));
    assert_eq!(domain.files.membership, Path::new("/m"));
    assert_eq!(domain.files.peers, [Path::new("/etc/gdp/away.peer")]);
    assert!(domain.members_only && domain.trace == Inside::Masked);
    let text = "domain: {card: c, membership: m, trace: open}";
    assert_eq!(parse(text).unwrap().domain.unwrap().trace, Inside::Open);
    let config = parse(&format!("uplink: {{udp: '127.0.0.1:9', switch: {S}, dial: true}}")).unwrap();
    assert!(
        config.neighbours[0].dial
            && !parse(&format!("uplink: {{interface: a, switch: {S}}}")).unwrap().neighbours[0].dial
    );
    let config =
        parse(&format!("public: ['192.0.2.1:9']\nneighbours: [{{interface: a, switch: {S}, parent: true}}]")).unwrap();
    assert!(config.neighbours[0].parent && !config.neighbours[0].dial);
    assert_eq!(config.public, ["192.0.2.1:9".parse().unwrap()]);
}

#[test]
fn replicas_of_a_rib() {
    assert_eq!(parse("").unwrap().etcd, None);
    let etcd = parse("etcd: {endpoints: ['http://10.0.0.1:2379', 'http://b:2379']}").unwrap().etcd.unwrap();
    let shown: Vec<_> = etcd.endpoints.iter().map(ToString::to_string).collect();
    assert_eq!(shown, ["http://10.0.0.1:2379", "http://b:2379"]);
    assert_eq!(etcd.prefix, "gdp/rib");
    for (section, needle) in [
        ("{}", "endpoints"),
        ("{endpoints: []}", "0 endpoints"),
        ("{endpoints: ['http://a:1', 'http://a:1/']}", "listed twice"),
        ("{endpoints: ['https://a:1']}", "need ca"),
        ("{endpoints: ['https://a:1', 'http://b:1'], ca: c}", "http://b:1 is without TLS"),
        ("{endpoints: ['https://a:1'], ca: c, cert: c}", "cert needs key"),
        ("{endpoints: ['https://a:1'], ca: c, key: k}", "key needs cert"),
        ("{endpoints: ['https://a:1'], ca: c, user: u}", "user needs password_file"),
        ("{endpoints: ['https://a:1'], ca: c, user: '', password_file: p}", "user is empty"),
        ("{endpoints: ['https://a:1'], ca: c, password_file: p}", "password_file needs user"),
        ("{endpoints: ['https://a:1'], ca: c, user: u, password: p}", "password"),
        ("{endpoints: ['http://a:1'], ca: c}", "https endpoints only"),
        ("{endpoints: ['http://a:1'], cert: c, key: k}", "https endpoints only"),
        ("{endpoints: ['http://a:1'], user: u, password_file: p}", "in clear"),
        ("{endpoints: [a]}", "is not an endpoint"),
        ("{endpoints: ['http://a:1'], prefix: /rib}", "slash"),
        ("{endpoints: ['http://a:1'], prefix: ''}", "visible"),
        ("{endpoints: ['http://a:1'], prefix: 'a b'}", "visible"),
        ("{endpoints: ['http://a:1'], user: x}", "user"),
    ] {
        let error = parse(&format!("etcd: {section}")).expect_err(section);
        assert!(error.contains(needle), "{section}: {error}");
    }
    let secured = "etcd: {endpoints: ['https://a:1'], ca: c, cert: d, key: k, user: u, password_file: /p}";
    let Access { tls, login } = parse(secured).unwrap().etcd.unwrap().access;
    let tls = tls.unwrap();
    assert!(tls.ca.ends_with("c") && tls.ca.is_absolute(), "{tls:?}");
    let client = tls.client.unwrap();
    assert!(client.cert.ends_with("d") && client.key.ends_with("k"), "{client:?}");
    assert_eq!(login, Some(Login { user: "u".into(), password_file: "/p".into() }));
    let elsewhere = format!("uplink: {{interface: a, switch: {S}}}\netcd: {{endpoints: ['http://a:1']}}");
    assert!(parse(&elsewhere).unwrap_err().contains("this daemon is none"));
}

#[test]
fn devices_for_dpdk() {
    let config = parse("").unwrap();
    assert_eq!((config.data_plane, config.dpdk), (DataPlane::Auto, DpdkConfig::default()));
    let text = "data_plane: dpdk\ndpdk: {huge_pages: true, memory_mib: 512, cores: [2, 3], idle_us: 0, ports: [\
                {interface: gdp0, device: '0000:02:00.0', mtu: 1600}, {interface: gdp1, device: 'net_af_xdp0,iface=eth1'}]}";
    let config = parse(text).unwrap();
    assert_eq!(config.data_plane, DataPlane::Dpdk);
    let DpdkConfig { ports, huge_pages, memory_mib, cores, idle } = config.dpdk;
    assert!(huge_pages && idle.is_zero());
    assert_eq!((memory_mib, &cores[..]), (512, &[2, 3][..]));
    let devices: Vec<_> = ports.iter().map(|port| (&port.interface[..], port.pci(), port.carrier())).collect();
    assert_eq!(devices, [("gdp0", Some("0000:02:00.0"), None), ("gdp1", None, Some("eth1"))]);
    assert_eq!(ports.iter().map(|port| (port.mtu, port.mtu())).collect::<Vec<_>>(), [(Some(1600), 1600), (None, 1500)]);
    let jumbo = "{ports: [{interface: a, mtu: 9000, device: 'net_af_packet0,iface=b,framesz=9216,blocksz=36864'}]}";
    assert_eq!(parse(&format!("dpdk: {jumbo}")).unwrap().dpdk.room(), 9216);

    for (section, needle) in [
        ("{port: []}", "port"),
        ("{ports: [{interface: gdp0}]}", "device"),
        ("{ports: [{interface: a/b, device: net_null0}]}", "no name for an interface"),
        ("{ports: [{interface: a, device: 'a b'}]}", "is no device"),
        ("{ports: [{interface: eth0, device: 'net_af_xdp0,iface=eth0'}]}", "another name"),
        ("{ports: [{interface: a, device: b}, {interface: a, device: c}]}", "listed twice"),
        ("{memory_mib: 1}", "memory_mib"),
        ("{idle_us: 1000000}", "idle_us"),
        ("{cores: [-1]}", "invalid u64"),
        ("{cores: [1, 1]}", "cores"),
        ("{cores: [5000]}", "cores"),
        ("{ports: [{interface: a, device: '02:00.0'}]}", "lspci -D"),
        ("{ports: [{interface: a, device: '0000:02:00.0'}]}", "huge_pages"),
        ("{ports: [{interface: a, device: 'net_x0,iface=b'}, {interface: c, device: 'net_x0,iface=d'}]}", "net_x0"),
        ("{ports: [{interface: a, device: net_null0, mtu: 1000}]}", "a: an mtu of 1000 is not between 1280 and 9190"),
        ("{ports: [{interface: a, device: net_null0, mtu: 9191}]}", "9190"),
        ("{ports: [{interface: a, device: net_null0, mtu: 70000}]}", "70000"),
        ("{ports: [{interface: a, device: 'net_af_packet0,iface=b', mtu: 4000}]}", "needs framesz=4096,blocksz=4096"),
        (
            "{ports: [{interface: a, device: 'net_af_packet0,iface=b,framesz=8192', mtu: 4000}]}",
            "blocksz=4096 is no multiple of framesz=8192",
        ),
        ("{ports: [{interface: a, device: 'net_af_packet0,iface=b,framesz=65536'}]}", "framesz=9216"),
        (
            "{ports: [{interface: a, device: 'net_af_packet0,iface=b,framesz=9216', mtu: 9190}]}",
            "an mtu of 9136 at most",
        ),
        ("{ports: [{interface: a, device: 'net_af_xdp0,iface=b', mtu: 4000}]}", "no port has an mtu above 2790"),
        (
            "{ports: [{interface: a, device: net_null0, mtu: 4000}, {interface: b, device: 'net_af_xdp0,iface=c'}]}",
            "a page",
        ),
        ("{ports: [{interface: a, device: 'net_x0,iface=b'}, {interface: c, device: 'net_x1,iface=b'}]}", "twice"),
    ] {
        let error = parse(&format!("dpdk: {section}")).expect_err(section);
        assert!(error.contains(needle), "{section}: {error}");
    }
    assert!(parse("data_plane: dpdk").unwrap_err().contains("needs devices"));
}

#[test]
fn a_secret_given_by_mistake_is_not_repeated() {
    for text in ["-----BEGIN PRIVATE KEY-----\nc2VjcmV0\n", "identity: [c2VjcmV0", "c2VjcmV0"] {
        let error = parse(text).expect_err(text);
        assert!(!error.contains("c2VjcmV0"), "{error}");
    }
}

#[test]
fn what_is_wrong_is_named() {
    for (text, needle) in [
        ("identiti: x", "there is no key `identiti`; did you mean `identity`? at line 1, column 1"),
        ("kind: switch\n-----BEGIN PRIVATE KEY-----\nAAAA\n", "it is a private key, not a daemon's configuration"),
        ("udp:\n\t- a", "a tab; use spaces"),
        ("udp: nowhere", "is not an address and port"),
        ("tls: example.com:443", "tls: \"example.com:443\" is not an address and port"),
        ("udp: null\ntls: 0.0.0.0:443", "need the UDP port"),
        (
            &format!("uplink: {{udp: '127.0.0.1:9', switch: {S}, tls: 'udp://a'}}"),
            "is not an address such as tls://HOST",
        ),
        (&format!("uplink: {{interface: l0, switch: {S}, tls: 'tls://a'}}"), "is used beside udp"),
        ("public: [a, b]", "invalid socket address"),
        (&format!("public: [{}]", ["'192.0.2.1:9'"; 9].join(", ")), "at most 8"),
        ("data_plane: fast", "fast"),
        ("rib: false", "needs a neighbour"),
        (&format!("rib: true\nuplink: {{interface: a, switch: {S}}}"), "remove one"),
        (&format!("uplink: {{switch: {S}}}"), "needs either interface"),
        ("uplink: {interface: a, switch: 75e}", "64 hex digits"),
        (&format!("neighbours: [{{interface: a, switch: {S}, cost: 0}}]"), "the least is 1"),
        (&format!("neighbours: [{{interface: a, switch: {S}}}, {{interface: b, switch: {S}}}]"), "listed twice"),
        (&format!("interfaces: [b]\nneighbours: [{{interface: a, switch: {S}}}]"), "does not list"),
        (
            &format!("neighbours: [{{interface: a, switch: {S}}}]\nuplink: {{interface: b, switch: {S}}}"),
            "another place",
        ),
        (
            &format!("neighbours: [{{interface: a, switch: {S}}}]\nuplink: {{interface: a, switch: {S}, cost: 3}}"),
            "another cost",
        ),
        (&format!("uplink: {{interface: a, switch: {S}, cost: 0}}"), "the least is 1"),
        (&format!("udp: null\nuplink: {{udp: '127.0.0.1:9', switch: {S}}}"), "turns UDP off"),
        ("fib_capacity: 0", "fib_capacity"),
        ("crypto: openssl", "rustcrypto"),
        ("domain: {card: c}", "membership"),
        ("domain: {card: c, membership: m, members: true}", "members"),
        ("domain: {card: c, membership: m, trace: all}", "all"),
        (&format!("domain: {{card: c, membership: m, peers: [{}x]}}", "x, ".repeat(16)), "at most 16"),
    ] {
        let error = parse(text).expect_err(text);
        assert!(error.contains(needle), "{text}: {error}");
    }
}
