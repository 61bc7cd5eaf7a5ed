//! Runs the forwarding cases of `tests/fixtures/frames.json` through the decision in plain Rust.
//!
//! [`cases`] defines them with the frame builder of the other tests. `GDP_BLESS=1 cargo test -p
//! gdp-wire` writes the JSON file, which other data planes and implementations read. Expectations
//! are written by hand, never taken from the code under test.

#[path = "../../../tests/src/frames/mod.rs"]
mod frames;
mod tables;

use std::net::SocketAddr;

use frames::Frame;
use frames::carrier::Carrier;
use frames::fixtures::{
    self, Bytes, Case, CopyOut, Expected, Fixtures, Link, NextHop, Role, Route, Switch, Udp, Verdict,
};
use gdp_wire::table::MAX_COPIED_FRAME;
use gdp_wire::{Counter, Header};
use tables::PlainTables;

#[test]
fn every_case_through_decide() {
    let fixtures = fixtures::read();
    for case in &fixtures.cases {
        let kernel = PlainTables::<true>::new(&fixtures.switch);
        assert_eq!(Expected::from(kernel.run(&case.frame.bytes())), case.kernel, "{} (kernel)", case.name);
        let userspace = PlainTables::<false>::new(&fixtures.switch);
        let expected = case.userspace.as_ref().unwrap_or(&case.kernel);
        assert_eq!(Expected::from(userspace.run(&case.frame.bytes())), *expected, "{} (userspace)", case.name);
    }
}

#[test]
fn frames_that_wait_are_marked_if_they_take_marks() {
    let run = |sent: &Sent| {
        let tables = PlainTables::<false>::new(&switch()).with_queues(&[EAST, INET]);
        Expected::from(tables.run(&sent.frame.bytes()))
    };
    for (flags, leaves) in [(0b10, 0b11), (0b01, 0b11), (0b11, 0b11), (0, 0), (5 << 2, 5 << 2)] {
        let to = |id: u32| from(JUMBO).bits(1 << link(id).reach[0]).with(|f| f.flags = flags);
        for id in [EAST, INET] {
            let left = to(id).with(|f| f.flags = leaves);
            assert_eq!(run(&to(id)), sends(&left, id, left.frame.egress_bits).into(), "{flags:#b} to {id:#x}");
        }
        assert_eq!(run(&to(WEST)), sends(&to(WEST), WEST, 1).into(), "{flags:#b} by a link without a queue");
        let both = to(WEST).bits(1 << 3 | 1);
        let copy =
            |frame: Forwarded| CopyOut { frame: Some(Bytes::new(&frame.0.bytes())), counter: "forwarded".into() };
        let east = sends(&both.clone().with(|f| f.flags = leaves), EAST, 1 << 3);
        assert_eq!(
            run(&both),
            copied(vec![copy(sends(&both, WEST, 1)), copy(east)]),
            "each copy as its link is: {flags:#b}"
        );
    }
    let refused = from(WEST).bits(1 << 62);
    assert_eq!(run(&refused), refused.error("drop_no_egress", 1, 0));
}

#[test]
fn a_daemon_is_given_no_probe_right_after_another() {
    let both = |sent: &Sent| {
        let (kernel, userspace) = (PlainTables::<true>::new(&switch()), PlainTables::<false>::new(&switch()));
        let frame = sent.frame.bytes();
        [kernel.punted().run(&frame), userspace.punted().run(&frame)].map(Expected::from)
    };
    for ends in [probe(WEST, OWN), probe(WEST, 1 << 3).with(|f| f.hop_limit = 1), probe(ABROAD, 0)] {
        assert_eq!(both(&ends), [drop("drop_punt_limit"), drop("drop_punt_limit")]);
    }
    let onward: Expected = sends(&probe(WEST, 1 << 3), EAST, 1 << 3).into();
    assert_eq!(both(&probe(WEST, 1 << 3)), [onward.clone(), onward], "one that goes on costs the daemon nothing");
    let answer = probe(WEST, 9).with(|f| (f.version_type, f.egress_set) = (0x24, 1));
    assert_eq!(both(&answer), [pass("slow"), pass("notice")], "and what is not a probe goes on being heard");
}

#[test]
fn every_counter_has_a_case() {
    let cases = fixtures::read().cases;
    // A redirect loss is known only after the redirect. A punt limit needs a preceding probe.
    let others = [Counter::RedirectLost, Counter::PuntLimit];
    for counter in Counter::ALL.iter().filter(|counter| !others.contains(counter)) {
        let counts = |expected: &Expected| expected.counter == counter.as_str();
        let any = cases.iter().any(|case| counts(&case.kernel) || case.userspace.as_ref().is_some_and(counts));
        assert!(any, "none for {counter:?}");
    }
}

#[test]
fn the_file_holds_the_cases_written_here() {
    let fixtures = Fixtures { about: about(), switch: switch(), cases: cases() };
    let text = serde_json::to_string_pretty(&fixtures).expect("plain data") + "\n";
    if std::env::var_os("GDP_BLESS").is_some() {
        std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/frames.json"), text).expect("write");
    } else {
        assert_eq!(fixtures::read(), fixtures, "run GDP_BLESS=1 cargo test -p gdp-wire --test fixtures");
    }
}

fn about() -> Vec<String> {
    [
        "What one switch does with each of these Ethernet frames. Each case starts from the tables below.",
        "`send`: by the link whose addresses the expected frame has. `copy`: several such. `pass`: to the host, \
         unchanged.",
        "Exactly one counter goes up, by one, and one for each copy. No link was sent an error before.",
        "`userspace` is there where the userspace plane differs from the kernel.",
    ]
    .map(String::from)
    .to_vec()
}

const ROBOT: u32 = 0xa1b2_0001;
const CLOUD: u32 = 0xa1b2_0402;
const WEST: u32 = 0x0000_0003;
const EAST: u32 = 0xffff_fc04;
const UDP: u32 = 0xa1b2_0405;
const JUMBO: u32 = 0xa1b2_0406;
const NARROW: u32 = 0xa1b2_0407;
const UNPLUGGED: u32 = 0xa1b2_07ff;
const OLD: u32 = 0xa1b2_0409;
const ABROAD: u32 = 0xa1b2_040a;
const OVERSEAS: u32 = 0xa1b2_040b;
const BLANK: u32 = 0xa1b2_0421;
const REKEYED: u32 = 0xa1b2_040c;

const TAGGED: u32 = 0xa1b2_040d;
const INET: u32 = 0xa1b2_040e;
const INET6: u32 = 0xa1b2_040f;
const NAT: u32 = 0xa1b2_0410;
const UNRESOLVED: u32 = 0xa1b2_0411;
const UNROUTED: u32 = 0xa1b2_0412;
const CHECKSUM: u32 = 0xa1b2_0413;
const CHILD: u32 = 0xa1b2_0414;

/// The switch's own addresses.
const V4: &str = "10.0.0.1:31415";
const V6: &str = "[2001:db8::1]:31415";

const NO_KEY: &str = "00000000000000000000000000000000";

const OWN_BIT: u32 = 2;
const OWN: u64 = 1 << OWN_BIT;

/// The switch of all cases:
///
/// ```text
///            robot   cloud   (endpoints; `udp` is one without a port)
///                 \ /
///  bits 0, 1 — WEST*EAST — bits 3, 4, 63        * own bit 2
///                 |
///               JUMBO — bit 5   NARROW — bit 6   UNPLUGGED — bit 7
/// ```
///
/// - `old`: a switch whose link has carried more than 2³² frames.
/// - `rekeyed`: a switch whose frames leave under the second key.
/// - `blank`: a switch that is being written or removed, and has no keys.
/// - `abroad`, `overseas` and `child`: switches of other domains. Frames from `child` may cross
///   this domain.
/// - `tagged`: a switch on VLAN 5.
/// - `inet` and `inet6`: switches over UDP, each behind a gateway.
/// - `behind nat`: an endpoint over UDP, behind a gateway.
/// - `unresolved`: the kernel does not know its MAC address.
/// - `unrouted`: the kernel has no route to it.
/// - `with checksum`: requires a UDP checksum.
fn switch() -> Switch {
    Switch {
        ethertype: 0x88b5,
        own_bit: OWN_BIT,
        links: vec![
            endpoint("robot", ROBOT, Some(0)),
            endpoint("cloud", CLOUD, Some(1)),
            neighbour("west", WEST, 2, &[0, 1], 1500),
            neighbour("east", EAST, 3, &[3, 4, 63], 1500),
            endpoint("udp", UDP, None),
            neighbour("jumbo", JUMBO, 4, &[5], 9000),
            neighbour("narrow", NARROW, 5, &[6], 600),
            neighbour("unplugged", UNPLUGGED, 63, &[7], 1500),
            Link { taken: OLD_TAKEN.to_vec(), ..neighbour("old", OLD, 2, &[], 1500) },
            Link { role: Role::Border, ..neighbour("abroad", ABROAD, 4, &[], 1500) },
            Link { role: Role::Border, ..neighbour("overseas", OVERSEAS, 5, &[], 1500) },
            Link { rx_keys: [NO_KEY, NO_KEY].map(String::from), ..neighbour("blank", BLANK, 2, &[], 1500) },
            Link { tx_phase: 1, ..neighbour("rekeyed", REKEYED, 1, &[12], 1500) },
            Link { vlan: 5, ..neighbour("tagged", TAGGED, 4, &[13], 1500) },
            remote("inet", INET, V4, "192.0.2.9:31415", &[14]),
            remote("inet6", INET6, V6, "[2001:db8:9::9]:40000", &[15]),
            Link { role: Role::Endpoint, ..remote("behind nat", NAT, V4, "198.51.100.7:1024", &[]) },
            Link { port: None, ..remote("unresolved", UNRESOLVED, V4, "10.0.0.77:31415", &[16]) },
            Link { port: None, ..remote("unrouted", UNROUTED, V4, "203.0.113.1:31415", &[17]) },
            with_checksum(remote("with checksum", CHECKSUM, V6, "[2001:db8:9::8]:31415", &[18])),
            Link { role: Role::Border, transit: true, ..neighbour("child", CHILD, 4, &[], 1500) },
        ],
        routes: vec![
            Route { writers: vec![ROBOT, UDP, CLOUD ^ 0x8000_0000], ..route("far", &[3], &[]) },
            Route { writers: vec![], ..route("read only", &[3], &[]) },
            Route { egress_set: 3, ..route("far in set 3", &[3], &[]) },
            route("last bit", &[63], &[]),
            route("two behind one neighbour", &[3, 4], &[]),
            route("two behind two neighbours", &[0, 3], &[]),
            route("one of two is unreachable", &[3, 9], &[]),
            route("wide and narrow", &[3, 6], &[]),
            route("here and far", &[OWN_BIT, 3], &[CLOUD]),
            route("here", &[OWN_BIT], &[CLOUD]),
            route("here twice", &[OWN_BIT], &[ROBOT, CLOUD]),
            route("here twice and far", &[OWN_BIT, 0, 3], &[CLOUD, UDP, ROBOT]),
            route("here, link gone", &[OWN_BIT], &[CLOUD ^ 0x8000_0000]),
            route("here, no link", &[OWN_BIT], &[]),
            route("back", &[OWN_BIT], &[ROBOT]),
            route("over udp", &[OWN_BIT], &[UDP]),
            route("nobody", &[], &[]),
            route("unreachable", &[9], &[]),
            route("jumbo", &[5], &[]),
            route("narrow", &[6], &[]),
            route("unplugged", &[7], &[]),
            route("under the second key", &[12], &[]),
            Route { writers: vec![NAT], ..route("from behind nat", &[3], &[]) },
            route("to behind nat", &[OWN_BIT], &[NAT]),
            Route { writers: vec![ROBOT, ABROAD, CHILD], ..route("abroad", &[OWN_BIT], &[OVERSEAS]) },
            Route {
                writers: vec![ROBOT, ABROAD, CHILD],
                ..route("home and abroad", &[OWN_BIT, 3], &[CLOUD, OVERSEAS])
            },
            Route { writers: vec![ROBOT, ABROAD, CHILD], ..route("child", &[OWN_BIT], &[CHILD]) },
            Route { sources: vec![ABROAD, CHILD], ..route("writer", &[], &[]) },
        ],
        next_hops: [
            (0, WEST),
            (1, WEST),
            (3, EAST),
            (4, EAST),
            (5, JUMBO),
            (6, NARROW),
            (7, UNPLUGGED),
            (12, REKEYED),
            (13, TAGGED),
            (14, INET),
            (15, INET6),
            (16, UNRESOLVED),
            (17, UNROUTED),
            (18, CHECKSUM),
            (63, EAST),
        ]
        .map(|(bit, link)| NextHop { bit, link })
        .to_vec(),
    }
}

fn cases() -> Vec<Case> {
    [
        forwarding(),
        delivery(),
        replication(),
        refusals(),
        permission(),
        borders(),
        links(),
        keys_in_turn(),
        replays(),
        sizes(),
        tags(),
        other_sources(),
        echoes_and_errors(),
        probes(),
        other_frames(),
        crossings(),
        congestion(),
        slow_carriers(),
        other_datagrams(),
    ]
    .concat()
}

fn forwarding() -> Vec<Case> {
    let far = from(ROBOT).to("far");
    let in_set_3 = from(ROBOT).to("far in set 3");
    let lying = from(ROBOT).to("far").with(|f| (f.egress_bits, f.egress_set) = (OWN | 1, 9));
    let last = from(ROBOT).to("last bit");
    let two = from(ROBOT).to("two behind one neighbour");
    let east = from(WEST).bits(1 << 3);
    let west = from(EAST).bits(0b11);
    let set_7 = from(WEST).bits(1 << 4).with(|f| f.egress_set = 7);
    let carried = from(WEST).bits(1 << 3).with(|f| (f.flags, f.reserved) = (0x7f, 0x5a));
    let limit_2 = from(WEST).bits(1 << 3).with(|f| f.hop_limit = 2);
    let limit_255 = from(WEST).bits(1 << 3).with(|f| f.hop_limit = 255);
    let count = from(WEST).bits(1 << 3).with(|f| f.link_counter = 0xffff_ffff);
    let wrapped = from(ROBOT).to("last bit").with(|f| f.link_counter = 0x8000_0000);
    let empty = from(WEST).bits(1 << 3).with(|f| f.payload.clear());
    vec![
        far.case("an endpoint's frame is stamped with the egress bits of its name", sends(&far, EAST, 1 << 3)),
        in_set_3.case("and with the egress set", sends(&in_set_3, EAST, 1 << 3).with(|f| f.egress_set = 3)),
        lying.case("what an endpoint claims of egress is overwritten", sends(&far, EAST, 1 << 3)),
        last.case("the highest bit", sends(&last, EAST, 1 << 63)),
        two.case("two switches behind one neighbour take one copy", sends(&two, EAST, 0b11000)),
        east.case("in transit only the bits count, the name is not known", sends(&east, EAST, 1 << 3)),
        west.case("in the other direction, with two bits", sends(&west, WEST, 0b11)),
        set_7.case("the egress set is kept in transit", sends(&set_7, EAST, 1 << 4)),
        carried.case("flags, class, ECN and the reserved byte are carried", sends(&carried, EAST, 1 << 3)),
        limit_2.case("hop limit 2 leaves with 1", sends(&limit_2, EAST, 1 << 3)),
        limit_255.case("hop limit 255 leaves with 254", sends(&limit_255, EAST, 1 << 3)),
        count.case("any link counter comes in", sends(&count, EAST, 1 << 3)),
        wrapped.case("also one as far from what was seen as the low half can tell", sends(&wrapped, EAST, 1 << 63)),
        empty.case("no payload", sends(&empty, EAST, 1 << 3)),
    ]
}

fn delivery() -> Vec<Case> {
    let here = from(EAST).bits(OWN).to("here");
    let local = from(ROBOT).to("here");
    let set_4 = from(WEST).bits(OWN).to("here").with(|f| f.egress_set = 4);
    let to_udp = from(EAST).bits(OWN).to("over udp");
    let from_udp = from(UDP).to("far");
    vec![
        here.case("the own bit is cleared, the name looked up, the endpoint gets it", delivers(&here, CLOUD)),
        local.case("from endpoint to endpoint of one switch", delivers(&local, CLOUD)),
        set_4.case("the egress set is kept at delivery", delivers(&set_4, CLOUD)),
        Case {
            userspace: Some(delivers(&to_udp, UDP)),
            ..to_udp.case("a link without a port is left to the userspace plane", pass("slow"))
        },
        from_udp.case("from a link without a port", sends(&from_udp, EAST, 1 << 3)),
    ]
}

fn replication() -> Vec<Case> {
    let copies_of = |sent: &Sent, to: &[(u32, u64)]| {
        let copy = |(by, bits): &(u32, u64)| {
            let counter = if link(*by).role == Role::Switch { "forwarded" } else { "delivered" };
            CopyOut { frame: Some(Bytes::new(&sends(sent, *by, *bits).0.bytes())), counter: counter.into() }
        };
        to.iter().map(copy).collect::<Vec<_>>()
    };
    let case = |sent: Sent, name: &str, to: &[(u32, u64)]| sent.case(name, copied(copies_of(&sent, to)));
    let narrow = from(ROBOT).to("wide and narrow").with(|f| f.payload = vec![0x5a; 600]);
    let mixed = from(ROBOT).to("here twice and far");
    let large = |length: usize| from(JUMBO).bits(0b11011).with(|f| f.payload = vec![0; length - Header::LEN]);
    let (copied_last, not_copied) = (large(MAX_COPIED_FRAME), large(MAX_COPIED_FRAME + 1));
    let too_big = CopyOut { frame: None, counter: "drop_too_big".into() };
    vec![
        case(from(ROBOT).to("two behind two neighbours"), "each neighbour gets its bits", &[(WEST, 1), (EAST, 1 << 3)]),
        case(from(JUMBO).bits(0b11011), "in transit as well", &[(WEST, 0b11), (EAST, 0b11000)]),
        case(from(WEST).bits(0b1001), "never back to where it came from", &[(EAST, 1 << 3)]),
        case(from(ROBOT).to("one of two is unreachable"), "the others get theirs", &[(EAST, 1 << 3)]),
        case(from(ROBOT).to("here and far"), "one copy here and one onward", &[(CLOUD, 0), (EAST, 1 << 3)]),
        case(from(WEST).bits(OWN | 1 << 3).to("here"), "the same in transit", &[(CLOUD, 0), (EAST, 1 << 3)]),
        case(from(WEST).bits(OWN | 1 << 3).to("unheard of"), "what is not known here goes onward", &[(EAST, 1 << 3)]),
        case(from(EAST).bits(OWN).to("here twice"), "to two endpoints", &[(ROBOT, 0), (CLOUD, 0)]),
        case(from(ROBOT).to("here twice"), "not to the one that sent it", &[(CLOUD, 0)]),
        Case {
            userspace: Some(copied(copies_of(&mixed, &[(CLOUD, 0), (UDP, 0), (WEST, 1), (EAST, 1 << 3)]))),
            ..mixed.case("to endpoints with and without a port, and two ways onward", pass("slow"))
        },
        copied_last.case("the largest that the kernel copies", copied(vec![too_big.clone(), too_big.clone()])),
        Case {
            userspace: Some(copied(vec![too_big.clone(), too_big.clone()])),
            ..not_copied.case("one byte more than the kernel copies", pass("slow"))
        },
        narrow.case("one copy does not fit", copied([copies_of(&narrow, &[(EAST, 1 << 3)]), vec![too_big]].concat())),
    ]
}

fn refusals() -> Vec<Case> {
    let unplugged = from(ROBOT).to("unplugged");
    vec![
        from(ROBOT).to("unheard of").refused("a name that is not in the FIB", "drop_no_route"),
        from(EAST).bits(OWN).to("far").refused("arrived, but nobody here takes the name", "drop_no_route"),
        from(EAST).bits(OWN).to("unheard of").refused("arrived, and the name is not known", "drop_no_route"),
        from(ROBOT).to("here, no link").refused("a route without a local link", "drop_no_route"),
        from(ROBOT).to("here, link gone").refused("a route to a link that is gone", "drop_no_route"),
        from(ROBOT).to("nobody").refused("a name that nobody takes", "drop_no_egress"),
        from(WEST).bits(0).to("here").refused("no egress bits from a switch", "drop_no_egress"),
        from(ROBOT).to("unreachable").refused("no neighbour toward the egress switch", "drop_no_egress"),
        from(WEST).bits(1 << 62).refused("a bit that nobody has", "drop_no_egress"),
        from(WEST).bits(1 << 62 | 1 << 61).case("several bits that nobody has", copied(vec![])),
        from(ROBOT).to("back").case("back to the endpoint it came from", drop("drop_hairpin")),
        from(EAST).bits(1 << 3).case("back to the switch it came from", drop("drop_hairpin")),
        from(WEST).bits(1 << 3).with(|f| f.hop_limit = 1).refused("hop limit 1", "drop_hop_limit"),
        from(WEST).bits(1 << 3).with(|f| f.hop_limit = 0).refused("hop limit 0", "drop_hop_limit"),
        from(EAST)
            .bits(OWN)
            .to("here")
            .with(|f| f.hop_limit = 1)
            .refused("hop limit 1 at the egress", "drop_hop_limit"),
        Case {
            userspace: Some(sends(&unplugged, UNPLUGGED, 1 << 7).into()),
            ..unplugged.case("a port without an interface", drop("drop_redirect_failed"))
        },
    ]
}

/// An endpoint sends under its own name, to the names it publishes.
fn permission() -> Vec<Case> {
    let own = |id| name(&link(id).label);
    let second = from(UDP).to("far");
    let transit = from(WEST).bits(1 << 3).with(|f| f.source = own(ROBOT));
    let to_reader = from(EAST).bits(OWN).to("here").with(|f| f.source = own(ROBOT));
    let mut cases = vec![
        second.case("the second of two that publish a name", sends(&second, EAST, 1 << 3)),
        from(CLOUD).to("far").refused("a name that two others publish", "drop_not_permitted"),
        from(CLOUD).to("last bit").refused("a name that another publishes", "drop_not_permitted"),
        from(CLOUD).to("here").refused("a name that it reads", "drop_not_permitted"),
        from(ROBOT).to("read only").refused("a name that nobody here publishes", "drop_not_permitted"),
        from(ROBOT).to("far").with(|f| f.source = own(CLOUD)).case("as another endpoint", drop("drop_source")),
        from(ROBOT).to("far").with(|f| f.source = own(WEST)).case("as a switch", drop("drop_source")),
        from(ROBOT).to("far").with(|f| f.source = [0; 32]).case("as nobody", drop("drop_source")),
        from(CLOUD)
            .to("unheard of")
            .with(|f| f.source = own(ROBOT))
            .case("the source is looked at before the name", drop("drop_source")),
        transit.case("a switch vouches for what endpoints beyond it sent", sends(&transit, EAST, 1 << 3)),
        to_reader.case("also where it is delivered", delivers(&to_reader, CLOUD)),
    ];
    for byte in [0, 7, 8, 31] {
        let altered = from(ROBOT).to("far").with(|f| f.source[byte] ^= 0x10);
        cases.push(altered.case(&format!("byte {byte} of the source differs"), drop("drop_source")));
    }
    cases
}

/// Frames from other domains: their names are looked up, and they do not go on to a third domain.
fn borders() -> Vec<Case> {
    let foreign = |sent: &Sent, by, bits| sends(sent, by, bits).with(|f| f.flags |= 0x40);
    let abroad = |to| from(ABROAD).to(to);
    let far = from(ABROAD).to("home and abroad");
    let to_here = abroad("abroad").with(|f| f.source = name("far"));
    let leaves = from(ROBOT).to("abroad");
    let came = from(WEST).bits(OWN).to("abroad").with(|f| f.flags = 0x40);
    let claimed = from(ROBOT).to("far").with(|f| f.flags = 0x40);
    let carried = from(WEST).bits(1 << 3).with(|f| f.flags = 0x40);
    let copy = |frame: Forwarded, counter: &str| CopyOut {
        frame: Some(Bytes::new(&frame.0.bytes())),
        counter: counter.into(),
    };
    let at_home = [(CLOUD, 0, "delivered"), (EAST, 1 << 3, "forwarded")]
        .map(|(by, bits, counter)| copy(foreign(&far, by, bits), counter));
    let child = |to| from(CHILD).to(to);
    let everywhere = [(CLOUD, 0, "delivered"), (OVERSEAS, 0, "delivered"), (EAST, 1 << 3, "forwarded")]
        .map(|(by, bits, counter)| copy(sends(&child("home and abroad"), by, bits), counter));
    let marked = child("abroad").with(|f| f.flags = 0x40);
    vec![
        leaves.case("to another domain", delivers(&leaves, OVERSEAS)),
        far.case("what comes from another domain is marked, and goes to no third", copied(at_home.to_vec())),
        abroad("abroad").case("also if that is all there is", drop("drop_split_horizon")),
        came.case("nor if it came in at another switch", drop("drop_split_horizon")),
        carried.case("in transit the mark stays", sends(&carried, EAST, 1 << 3)),
        claimed.case("an endpoint cannot set the mark", sends(&claimed, EAST, 1 << 3).with(|f| f.flags = 0)),
        child("abroad").case("what may cross this domain goes on to a third", delivers(&child("abroad"), OVERSEAS)),
        marked.case("whatever its own domain marked", delivers(&child("abroad"), OVERSEAS)),
        child("home and abroad").case("and everywhere else, without a mark", copied(everywhere.to_vec())),
        child("child").case("but not back", drop("drop_hairpin")),
        abroad("child").case("the other way only what may cross, too", drop("drop_split_horizon")),
        to_here.case("a source that the domain may not send as", drop("drop_source")),
        abroad("far").refused("a name that the domain may not send to", "drop_not_permitted"),
    ]
}

/// The counts recorded on the link [`OLD`], around its 2³²nd frame.
const OLD_TAKEN: [u64; 7] =
    [(1 << 32) - 16, (1 << 32) - 2, (1 << 32) - 1, 1 << 32, (1 << 32) + 1, (1 << 32) + 3, (1 << 32) + 20];

/// Frames on the link [`OLD`].
fn replays() -> Vec<Case> {
    let counted = |count: u64| from(OLD).bits(1 << 3).with(|f| f.link_counter = count);
    let fresh = |name: &str, count| {
        let sent = counted(count);
        sent.case(name, sends(&sent, EAST, 1 << 3))
    };
    let replayed = |name: &str, count| counted(count).case(name, drop("drop_replayed"));
    let unfolded = |sent: Sent, high: u64| sent.with(|f| f.link_counter ^= high << 32);
    vec![
        replayed("the last one again", (1 << 32) + 3),
        replayed("one before", (1 << 32) + 1),
        replayed("from before the counter wrapped", (1 << 32) - 1),
        replayed("the first of that block", (1 << 32) - 16),
        fresh("late, and not seen", (1 << 32) + 2),
        fresh("late, from before the counter wrapped", (1 << 32) - 3),
        fresh("the next one", (1 << 32) + 4),
        fresh("the last of a block", (1 << 32) + 15),
        replayed("the same place in the ring, one round earlier", (1 << 32) - 4096 + 5),
        replayed("one round earlier at the other end of the block", (1 << 32) - 4096 + 16),
        fresh("and one round later", (1 << 32) + 4096 + 5),
        unfolded(counted((1 << 32) + 4), 1).case("recorded 2³² frames ago", drop("drop_bad_tag")),
        unfolded(counted((1 << 32) + 4), 3).case("of 2³² frames to come", drop("drop_bad_tag")),
        counted((1 << 32) + 3)
            .with(|f| f.tag = Some(0))
            .case("a counter that was taken does not tell without a tag", drop("drop_bad_tag")),
        counted((1 << 32) + 3)
            .with(|f| f.hop_limit = 1)
            .case("that it is known comes before what else is wrong", drop("drop_replayed")),
    ]
}

/// Two keys are valid in each direction, distinguished by a flag.
fn keys_in_turn() -> Vec<Case> {
    let second = from(WEST).bits(1 << 3).with(|f| (f.flags, f.key) = (0x80, fixtures::key(&link(WEST).rx_keys[1])));
    let confused = second.clone().with(|f| f.flags = 0);
    let blank = from(BLANK).bits(1 << 3);
    let to_second = from(ROBOT).to("under the second key");
    let both = from(WEST).bits(1 << 12).with(|f| (f.flags, f.key) = (0x83, fixtures::key(&link(WEST).rx_keys[1])));
    vec![
        blank.case("the key that everybody knows is none", drop("drop_bad_tag")),
        second.case("under the second key", sends(&second, EAST, 1 << 3).with(|f| f.flags = 0)),
        confused.case("the second key, but the flag of the first", drop("drop_bad_tag")),
        second
            .clone()
            .with(|f| f.key = keys(WEST).0)
            .case("the flag of the second key, but the first", drop("drop_bad_tag")),
        to_second.case("onto a link whose second key is in use", sends(&to_second, REKEYED, 1 << 12)),
        both.case("from second key to second key", sends(&both, REKEYED, 1 << 12)),
    ]
}

fn links() -> Vec<Case> {
    let on = |id| from(WEST).bits(1 << 3).with(move |f| f.link_id = id);
    vec![
        on(0).case("link id 0 is no link", drop("drop_no_link")),
        on(8).case("an entry that is free", drop("drop_no_link")),
        on(WEST | 0x400).case("an id that differs from the link's above the index", drop("drop_no_link")),
        on(0xffff_ffff).case("the highest id", drop("drop_no_link")),
        on(EAST).case("another link's id, this link's key", drop("drop_bad_tag")),
    ]
}

fn sizes() -> Vec<Case> {
    let sized = |to: &str, bytes: usize| from(ROBOT).to(to).with(|f| f.payload = vec![0x5a; bytes - 96]);
    let full = sized("far", 1500);
    let narrow = sized("narrow", 600);
    let large = sized("jumbo", 3400);
    let jumbo = from(ROBOT).to("jumbo").with(|f| f.payload = vec![0; 8900]);
    let padded = from(WEST).bits(1 << 3).with(|f| f.padding = 17);
    let short = |claimed| from(WEST).bits(1 << 3).with(|f| f.payload_len = Some(claimed));
    let mut cases = vec![
        full.case("as large as the link takes", sends(&full, EAST, 1 << 3)),
        sized("far", 1501).too_big("one byte too large", 1500),
        narrow.case("as large as a narrow link takes", sends(&narrow, NARROW, 1 << 6)),
        sized("narrow", 601).too_big("one byte too large for a narrow link", 600),
        large.case("more than an Ethernet MTU", sends(&large, JUMBO, 1 << 5)),
        jumbo.case("in several buffers", sends(&jumbo, JUMBO, 1 << 5)),
        padded.case("bytes behind the payload are left behind", sends(&padded, EAST, 1 << 3)),
        full.clone().with(|f| f.padding = 1).case("and do not count", sends(&full, EAST, 1 << 3)),
        short(7).case("one payload byte is missing", drop("drop_truncated")),
        short(0xffff).case("nearly all is missing", drop("drop_truncated")),
    ];
    let whole = from(WEST).bits(1 << 3).with(|f| f.payload.clear()).frame.bytes();
    for length in [14, 15, 16, 20, 22, 30, 38, 46, 78, 109] {
        cases.push(raw(&format!("only {} bytes of a frame", length - 14), &whole[..length], drop("drop_truncated")));
    }
    cases
}

/// One bit of each field is flipped in transit; the tag of the original stays.
fn tags() -> Vec<Case> {
    let original = from(ROBOT).to("far").with(|f| f.payload = vec![0x5a; 600]);
    // The bits are chosen so that the length stays within the frame, and the low half of the id
    // selects a free entry.
    let flips: [(&str, usize, u8, &str); 15] = [
        ("type", 0, 0x08, "drop_unknown"),
        ("flags", 1, 0x01, "drop_bad_tag"),
        ("hop limit", 2, 0x01, "drop_bad_tag"),
        ("egress set", 3, 0x01, "drop_bad_tag"),
        ("payload length (high)", 4, 0x02, "drop_bad_tag"),
        ("payload length (low)", 5, 0x08, "drop_bad_tag"),
        ("header length", 6, 0x08, "drop_unknown"),
        ("reserved byte", 7, 0x01, "drop_bad_tag"),
        ("link id (high)", 8, 0x01, "drop_no_link"),
        ("link id (low)", 11, 0x80, "drop_no_link"),
        ("link counter", 12, 0x01, "drop_bad_tag"),
        ("tag", 16, 0x01, "drop_bad_tag"),
        ("egress bits", 24, 0x01, "drop_bad_tag"),
        ("destination", 32, 0x80, "drop_bad_tag"),
        ("destination (last)", 63, 0x01, "drop_bad_tag"),
    ];
    let mut cases = Vec::new();
    for (field, offset, bit, counter) in flips {
        let mut bytes = original.frame.bytes();
        bytes[14 + offset] ^= bit;
        cases.push(raw(&format!("one bit of the {field} is flipped"), &bytes, drop(counter)));
    }

    let payload = "a flipped bit of the payload is for the reader to find: the tag covers the header";
    let altered = original.clone().with(|f| f.payload[0] ^= 1);
    cases.push(altered.case(payload, sends(&altered, EAST, 1 << 3)));

    let (_, other_direction) = keys(ROBOT);
    let (other_link, _) = keys(CLOUD);
    cases.push(original.clone().with(|f| f.tag = Some(0)).case("no tag", drop("drop_bad_tag")));
    cases.push(
        original.clone().with(|f| f.key = other_direction).case("tag of the other direction", drop("drop_bad_tag")),
    );
    cases.push(original.with(|f| f.key = other_link).case("tag of another link", drop("drop_bad_tag")));
    cases
}

/// The source is changed in transit; the tag of the original stays. Who would act on the source
/// drops the frame without an error, or does not look at it.
fn other_sources() -> Vec<Case> {
    let altered = |sent: &Sent, at: usize| {
        let tag = u64::from_be_bytes(fixtures::array(&fixtures::hex(&sent.frame.header()[16..24])));
        let honest = sent.clone().with(|f| f.source[at - 64] ^= 1);
        (honest.clone().with(|f| f.tag = Some(tag)), honest)
    };
    let (out, transit) = (from(ROBOT).to("far"), from(WEST).bits(1 << 3).to("far"));
    let (to_reader, abroad) = (from(EAST).bits(OWN).to("here"), from(ABROAD).to("home and abroad"));
    let mut cases = Vec::new();
    for at in [64, 95] {
        for (sent, place) in [(&out, "an endpoint"), (&abroad, "another domain")] {
            let name = format!("byte {at} is another: no writer of {place}");
            cases.push(altered(sent, at).0.case(&name, drop("drop_source")));
        }
        let (through, as_if) = altered(&transit, at);
        let name = format!("byte {at} is another: in transit nobody reads the source");
        cases.push(through.case(&name, sends(&as_if, EAST, 1 << 3)));
        let (delivered, as_if) = altered(&to_reader, at);
        let name = format!("byte {at} is another: the reader has no key of that writer");
        cases.push(delivered.case(&name, delivers(&as_if, CLOUD)));
    }
    cases
}

/// Frames between neighbours.
fn echoes_and_errors() -> Vec<Case> {
    let echo = |from: Sent| {
        from.bits(0x1122_3344_5566_7788).with(|f| (f.version_type, f.hop_limit, f.payload) = (0x24, 1, vec![]))
    };
    let answer = |sent: &Sent, by: u32| Expected {
        counter: "echoed".into(),
        ..sends(sent, by, sent.frame.egress_bits).with(|f| (f.hop_limit, f.egress_set) = (1, 1)).into()
    };
    let notice = |sent: Sent, name: &str| Case { userspace: Some(pass("notice")), ..sent.case(name, pass("slow")) };
    let asked = echo(from(WEST));
    let by_endpoint = echo(from(ROBOT));
    let loaded = echo(from(WEST)).with(|f| f.payload = vec![7; 100]);
    let over_udp = echo(from(UDP));
    let error =
        from(EAST).bits(9).with(|f| (f.version_type, f.hop_limit, f.egress_set, f.payload) = (0x22, 1, 1, vec![]));
    vec![
        asked.case("an echo comes back", answer(&asked, WEST)),
        by_endpoint.case("also to an endpoint", answer(&by_endpoint, ROBOT)),
        loaded.case("without its payload", Expected { ..answer(&echo(from(WEST)), WEST) }),
        Case {
            userspace: Some(answer(&over_udp, UDP)),
            ..over_udp.case("by the plane that can send it", pass("slow"))
        },
        asked.clone().with(|f| f.tag = Some(1)).case("an echo that the neighbour did not send", drop("drop_bad_tag")),
        notice(echo(from(WEST)).with(|f| f.egress_set = 1), "the answer to an echo is for the daemon"),
        notice(error.clone(), "and so is an error"),
        from(ROBOT)
            .bits(9)
            .with(|f| (f.version_type, f.hop_limit, f.egress_set, f.payload) = (0x22, 1, 1, vec![]))
            .case("an endpoint has nothing to refuse", drop("drop_unknown")),
        error.with(|f| f.tag = Some(1)).case("but not one that the neighbour did not send", drop("drop_bad_tag")),
    ]
}

/// Probes take the route of data for one egress switch, and end where their hop limit does. A
/// dropped probe draws no error.
fn probes() -> Vec<Case> {
    let hops = |sent: Sent, hop_limit| sent.with(|f| f.hop_limit = hop_limit);
    let ends = |sent: Sent, name: &str| Case { userspace: Some(pass("notice")), ..sent.case(name, pass("slow")) };
    let (onward, over_udp) = (probe(WEST, 1 << 3), probe(INET, 1 << 3));
    let slow = probe(WEST, 1 << 7);
    let last = hops(probe(WEST, 1 << 3), 2);
    let marked = probe(INET, 1 << 3).in_datagram(3);
    let large = |payload| probe(WEST, 1 << 6).with(|f| f.payload = vec![0; payload]);
    vec![
        onward.case("a probe goes on toward its egress switch", sends(&onward, EAST, 1 << 3)),
        over_udp.case("also from UDP to Ethernet", sends(&over_udp, EAST, 1 << 3)),
        last.case("its hop limit falls as that of data", sends(&last, EAST, 1 << 3)),
        ends(hops(probe(WEST, 1 << 3), 1), "a probe whose hop limit ends here is the daemon's"),
        ends(hops(probe(WEST, 1 << 3), 0), "likewise with hop limit 0"),
        ends(probe(WEST, OWN), "and so is one for this egress switch"),
        ends(probe(WEST, OWN).to("here"), "also if the name has readers here"),
        ends(probe(ABROAD, 1 << 3), "and one from another domain, wherever it would go"),
        ends(probe(ABROAD, 0), "which need not know any bits"),
        probe(ROBOT, 1 << 3).case("an endpoint sends no probes", drop("drop_unknown")),
        probe(ROBOT, OWN).case("not even to its switch", drop("drop_unknown")),
        probe(WEST, 0).case("a probe for no egress switch", drop("drop_no_egress")),
        probe(WEST, 1 << 3 | 1).case("a probe for two", drop("drop_no_egress")),
        probe(WEST, OWN | 1 << 3).case("a probe for this one and another", drop("drop_no_egress")),
        hops(probe(WEST, 3), 1).case("a probe for two whose hop limit ends", drop("drop_no_egress")),
        probe(WEST, 1 << 62).case("a probe for a bit that nobody has", drop("drop_no_egress")),
        probe(EAST, 1 << 3).case("a probe that would go back", drop("drop_hairpin")),
        probe(WEST, OWN).with(|f| f.tag = Some(1)).case("a probe that nobody sent", drop("drop_bad_tag")),
        large(505).case("a probe that is too big for its link", drop("drop_too_big")),
        marked.case("a probe takes no marks", drop("drop_congested")),
        Case {
            userspace: Some(sends(&slow, UNPLUGGED, 1 << 7).into()),
            ..slow.case("a probe to a port without an interface", drop("drop_redirect_failed"))
        },
    ]
}

fn other_frames() -> Vec<Case> {
    let transit = from(WEST).bits(1 << 3);
    let first_byte = |byte| transit.clone().with(|f| f.version_type = byte);
    let header_words = |words| transit.clone().with(|f| f.header_words = words);
    let ethertype = |ethertype| transit.clone().with(|f| f.ethertype = ethertype);
    let mut short_control = transit.frame.bytes()[..14].to_vec();
    short_control.push(0x11);
    let mut tagged = transit.frame.bytes();
    tagged.splice(12..12, [0x81, 0x00, 0x00, 0x07]);
    vec![
        first_byte(0x11).case("a control frame is the daemon's", pass("control")),
        raw("also a short one", &short_control, pass("control")),
        first_byte(0x00).case("version 0", drop("drop_unknown")),
        first_byte(0x10).case("version 1", drop("drop_unknown")),
        first_byte(0x30).case("version 3", drop("drop_unknown")),
        first_byte(0x12).case("an error of version 1", drop("drop_unknown")),
        first_byte(0x13).case("a probe of version 1", drop("drop_unknown")),
        first_byte(0x14).case("an echo of version 1", drop("drop_unknown")),
        first_byte(0x21).case("a control frame of version 2", drop("drop_unknown")),
        first_byte(0x25).case("the first type that is not known", drop("drop_unknown")),
        first_byte(0x2f).case("the last type", drop("drop_unknown")),
        first_byte(0x40).case("what would be QUIC on UDP", drop("drop_unknown")),
        first_byte(0xff).case("the last first byte", drop("drop_unknown")),
        header_words(11).case("a shorter header", drop("drop_unknown")),
        header_words(13).case("a longer header", drop("drop_unknown")),
        header_words(0).case("no header", drop("drop_unknown")),
        ethertype(0x0800).case("IPv4 passes", pass("foreign")),
        ethertype(0x0806).case("ARP passes", pass("foreign")),
        ethertype(0x86dd).case("IPv6 passes", pass("foreign")),
        ethertype(0x88b6).case("the neighbouring ethertype passes", pass("foreign")),
        raw("on a VLAN that is not ours it passes", &tagged, pass("foreign")),
    ]
}

/// From every carrier to every other, and back by the same one.
fn crossings() -> Vec<Case> {
    let bit = |id: u32| 1u64 << link(id).reach[0];
    let ways = [WEST, JUMBO, TAGGED, INET, INET6, EAST];
    let mut cases = Vec::new();
    for by in ways {
        for to in ways.into_iter().filter(|to| *to != by) {
            let (from_label, to_label) = (link(by).label, link(to).label);
            // Traffic class 5, from a writer that supports marks.
            let sent = from(by).bits(bit(to)).with(|f| (f.flags, f.payload) = (5 << 2 | 0b10, vec![0x5a; 333]));
            cases.push(sent.case(&format!("from {from_label} to {to_label}"), sends(&sent, to, bit(to))));
        }
        let label = link(by).label;
        let full = from(by).bits(bit(INET6)).with(|f| f.payload = vec![0x5a; 1472 - 96]);
        if by != INET6 {
            cases.push(full.case(&format!("as large as UDP takes, from {label}"), sends(&full, INET6, bit(INET6))));
            let larger = full.clone().with(|f| f.payload.push(1));
            cases.push(larger.too_big(&format!("one byte more, from {label}"), 1472));
        }
        let padded = from(by).bits(bit(ways[usize::from(by == INET) + 3])).with(|f| f.padding = 9);
        let to = if by == INET { INET6 } else { INET };
        cases.push(
            padded.case(&format!("what is behind a frame stays behind, from {label}"), sends(&padded, to, bit(to))),
        );
        cases.push(from(by).bits(1 << 62).refused(&format!("an error goes back to {label}"), "drop_no_egress"));
        let echo = from(by).bits(7).with(|f| (f.version_type, f.hop_limit) = (0x24, 1));
        let answer = sends(&echo, by, 7).with(|f| (f.hop_limit, f.egress_set, f.payload) = (1, 1, vec![]));
        cases.push(
            echo.case(&format!("an echo goes back to {label}"), Expected { counter: "echoed".into(), ..answer.into() }),
        );
    }
    let writes = from(NAT).to("from behind nat");
    let reads = from(INET6).bits(OWN).to("to behind nat");
    let elsewhere = SocketAddr::from(([203, 0, 113, 200], 999));
    let moved = writes.clone().with(|f| {
        f.carrier = Carrier::Udp { from: elsewhere, to: V4.parse().expect("an address"), class: 0 };
    });
    let over_ethernet = writes.clone().with(|f| f.carrier = Carrier::Ethernet);
    let refusal = |sent: Sent, name: &str, reason: &str| sent.case(name, sent.error(reason, 4, 0));
    cases.extend([
        writes.case("an endpoint behind a NAT writes", sends(&writes, EAST, 1 << 3)),
        reads.case("and reads", delivers(&reads, NAT)),
        moved.case("its address is no part of the link", sends(&writes, EAST, 1 << 3)),
        over_ethernet.case("nor is what carries its frames", sends(&writes, EAST, 1 << 3)),
        writes.clone().with(|f| f.source = [9; 32]).case("as another, over UDP", drop("drop_source")),
        refusal(from(NAT).to("far"), "to what it does not publish, over UDP", "drop_not_permitted"),
        writes.clone().with(|f| f.key = [1, 2]).case("forged, over UDP", drop("drop_bad_tag")),
        writes.with(|f| f.link_id = INET).case("moved to another link, over UDP", drop("drop_bad_tag")),
    ]);
    cases
}

/// Congestion marks of routers on the outer packet (RFC 3168). They go into the frame's header, and
/// from there into the next outer packet.
fn congestion() -> Vec<Case> {
    let bit = |id: u32| 1u64 << link(id).reach[0];
    let mut cases = Vec::new();
    for by in [INET, INET6] {
        let label = link(by).label;
        for (name, outer, flags, leaves) in [
            ("a mark is taken over into the header", 0b11, 5 << 2 | 0b10, 5 << 2 | 0b11),
            ("also if its writer has the other code point", 0b11, 0b01, 0b11),
            ("and whatever DSCP a router has made of the class", 0xff, 0b10, 0b11),
            ("marked twice", 0b11, 0b11, 0b11),
            ("a mark that is in the header stays", 0b10, 0b11, 0b11),
            ("also if a tunnel forgets the code point", 0, 0b11, 0b11),
            ("the other code point is no mark", 0b01, 0b10, 0b10),
            ("no mark", 0b10, 0b10, 0b10),
            ("it is no code point of the writer's if only what carries the frame has it", 0b10, 0, 0),
        ] {
            let sent = from(by).bits(bit(EAST)).with(|f| f.flags = flags).in_datagram(outer);
            let left = sent.clone().with(|f| f.flags = leaves);
            cases.push(sent.case(&format!("{name}, from {label}"), sends(&left, EAST, bit(EAST))));
        }
        let marked = |to: u64| from(by).bits(to).with(|f| f.flags = 0b10).in_datagram(0b11);
        let deaf = |to: u64| marked(to).with(|f| f.flags = 0x1c);
        let to = if by == INET { INET6 } else { INET };
        let (onward, both, slow) = (marked(bit(to)), marked(bit(EAST) | 1), marked(bit(UNRESOLVED)));
        let with_mark = |sent: &Sent, by, bits| sends(&sent.clone().with(|f| f.flags = 0b11), by, bits);
        let copy = |by, bits| CopyOut {
            frame: Some(Bytes::new(&with_mark(&both, by, bits).0.bytes())),
            counter: "forwarded".into(),
        };
        let echo = deaf(7).with(|f| (f.version_type, f.hop_limit, f.payload) = (0x24, 1, vec![]));
        let answer = sends(&echo, by, 7).with(|f| (f.hop_limit, f.egress_set) = (1, 1));
        let nowhere = marked(1 << 62);
        cases.extend([
            onward.case(&format!("from datagram to datagram, from {label}"), with_mark(&onward, to, bit(to))),
            both.case(&format!("into each copy, from {label}"), copied(vec![copy(WEST, 1), copy(EAST, bit(EAST))])),
            deaf(bit(EAST)).case(
                &format!("only a loss tells a writer that does not take marks, from {label}"),
                drop("drop_congested"),
            ),
            deaf(bit(EAST) | 1).case(&format!("and one for all copies, from {label}"), drop("drop_congested")),
            Case {
                userspace: Some(with_mark(&slow, UNRESOLVED, bit(UNRESOLVED)).into()),
                ..slow.case(&format!("by the plane that can send it, from {label}"), pass("slow"))
            },
            Case {
                userspace: Some(drop("drop_congested")),
                ..deaf(bit(UNRESOLVED)).case(&format!("and dropped by that plane, from {label}"), pass("slow"))
            },
            marked(bit(EAST))
                .with(|f| f.tag = Some(1))
                .case(&format!("marked and forged, from {label}"), drop("drop_bad_tag")),
            echo.case(
                &format!("an echo is answered, marked or not, from {label}"),
                Expected { counter: "echoed".into(), ..answer.into() },
            ),
            nowhere.case(
                &format!("an error takes no marks and has none, from {label}"),
                nowhere.clone().with(|f| f.flags = 0).error("drop_no_egress", 1, 0),
            ),
        ]);
    }
    // Priority 7 with the drop eligible bit.
    let tagged = from(TAGGED).bits(bit(EAST)).with(|f| (f.carrier, f.flags) = (Carrier::Vlan(0xf005), 0b10));
    cases.push(tagged.case("what a VLAN says of priority is no mark", sends(&tagged, EAST, bit(EAST))));
    let in_header = from(WEST).bits(bit(INET6)).with(|f| f.flags = 0b11);
    cases.push(in_header.case("from Ethernet a mark goes on in both headers", sends(&in_header, INET6, bit(INET6))));
    cases
}

/// Links that the kernel receives frames from but cannot send on.
fn slow_carriers() -> Vec<Case> {
    let mut cases = Vec::new();
    for id in [UNRESOLVED, UNROUTED, CHECKSUM] {
        let (label, bit) = (link(id).label, 1 << link(id).reach[0]);
        let to = from(INET).bits(bit);
        let slow = to.case(&format!("to {label} the userspace plane sends"), pass("slow"));
        cases.push(Case { userspace: Some(sends(&to, id, bit).into()), ..slow });
        let came = from(id).bits(1 << 3);
        cases.push(came.case(&format!("from {label}"), sends(&came, EAST, 1 << 3)));
    }
    cases
}

/// Packets that only resemble a frame over UDP or on a VLAN.
fn other_datagrams() -> Vec<Case> {
    let (v4, v6) = (from(INET).bits(1 << 3), from(INET6).bits(1 << 3));
    let (v4_bytes, v6_bytes) = (v4.frame.bytes(), v6.frame.bytes());
    let foreign = |name: &str, bytes: &[u8], at: usize, value: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes[at..at + value.len()].copy_from_slice(value);
        raw(name, &bytes, pass("foreign"))
    };
    let (length4, length6) = ((v4_bytes.len() - 14) as u16, (v6_bytes.len() - 54) as u16);
    let mut cases = vec![
        foreign("IPv4 with options", &v4_bytes, 14, &[0x46]),
        foreign("IPv4 of another version", &v4_bytes, 14, &[0x55]),
        foreign("the first of several fragments", &v4_bytes, 20, &[0x20, 0]),
        foreign("a later fragment", &v4_bytes, 20, &[0, 1]),
        foreign("TCP", &v4_bytes, 23, &[6]),
        foreign("to another host", &v4_bytes, 33, &[2]),
        foreign("to another port", &v4_bytes, 37, &[0xb8]),
        foreign("more IPv4 than there is", &v4_bytes, 16, &(length4 + 1).to_be_bytes()),
        foreign("more UDP than IPv4", &v4_bytes, 38, &(length4 - 19).to_be_bytes()),
        foreign("less UDP than its header", &v4_bytes, 38, &[0, 7]),
        foreign("IPv6 of another version", &v6_bytes, 14, &[0x50]),
        foreign("a fragment of IPv6", &v6_bytes, 20, &[44]),
        foreign("to another host, over IPv6", &v6_bytes, 53, &[2]),
        foreign("to another port, over IPv6", &v6_bytes, 57, &[0xb8]),
        foreign("more IPv6 than there is", &v6_bytes, 18, &(length6 + 1).to_be_bytes()),
        foreign("more UDP than IPv6", &v6_bytes, 58, &(length6 + 1).to_be_bytes()),
        foreign("less UDP than its header, over IPv6", &v6_bytes, 58, &[0, 7]),
        v4.clone().with(|f| f.carrier = Carrier::Vlan(6)).case("on a VLAN that is not ours", pass("foreign")),
    ];
    let priority = v4.clone().with(|f| f.carrier = Carrier::Vlan(0xe005));
    cases.push(priority.case("on a VLAN, with a priority", sends(&v4, EAST, 1 << 3)));
    for (name, bytes, at) in [("IPv4", &v4_bytes, 42), ("IPv6", &v6_bytes, 62)] {
        let with = |first: u8| [&bytes[..at], &[first], &bytes[at + 1..]].concat();
        cases.push(raw(&format!("QUIC over {name}"), &with(0x40), pass("control")));
        cases.push(raw(&format!("a long header of QUIC over {name}"), &with(0xc3), pass("control")));
        cases.push(raw(&format!("another version over {name}"), &with(0x30), drop("drop_unknown")));
    }
    // Ethernet pads short packets after the datagram.
    let padded = |bytes: &[u8]| [bytes, &[0xee; 20]].concat();
    let expected: Expected = sends(&v4, EAST, 1 << 3).into();
    cases.push(raw("padding behind a datagram", &padded(&v4_bytes), expected));
    let expected: Expected = sends(&v6, EAST, 1 << 3).into();
    cases.push(raw("padding behind a datagram over IPv6", &padded(&v6_bytes), expected));
    // The datagram ends before the frame does, although the packet continues.
    let short = v4.with(|f| f.payload_len = Some(7)).frame.bytes();
    cases.push(raw("padding is not taken for payload", &padded(&short), drop("drop_truncated")));
    let carrier = link(INET).arrives_in();
    let part = |length: usize| carrier.carry([2; 6], [4; 6], 0x88b5, &v4_bytes[42..42 + length]);
    for length in [0, 1, 8, 95] {
        let name = format!("only {length} bytes of a frame in a datagram");
        cases.push(raw(&name, &padded(&part(length)), drop("drop_truncated")));
    }
    let mut misleading = part(34);
    misleading[42 + 6] = 13;
    let name = "what is missing comes before a wrong header length";
    cases.push(raw(name, &padded(&padded(&padded(&padded(&misleading)))), drop("drop_truncated")));
    cases
}

/// A frame as the neighbour on a link sends it.
#[derive(Clone)]
struct Sent {
    frame: Frame,
}

fn from(id: u32) -> Sent {
    let (key, _) = keys(id);
    let (destination, label) = (name("unheard of"), link(id).label);
    let source = if link(id).role == Role::Endpoint { name(&label) } else { name("writer") };
    let carrier = link(id).arrives_in();
    Sent { frame: Frame { carrier, link_id: id, link_counter: 7, key, destination, source, ..Frame::default() } }
}

/// Returns a probe as a switch forwards it.
fn probe(id: u32, bits: u64) -> Sent {
    from(id).bits(bits).with(|f| (f.version_type, f.payload) = (0x23, vec![0x77; 8]))
}

impl Sent {
    fn to(mut self, label: &str) -> Self {
        self.frame.destination = name(label);
        self
    }

    fn bits(mut self, bits: u64) -> Self {
        self.frame.egress_bits = bits;
        self
    }

    fn with(mut self, change: impl FnOnce(&mut Frame)) -> Self {
        change(&mut self.frame);
        self
    }

    /// Sets the DSCP and ECN byte of the outer IP header, regardless of the frame's header.
    fn in_datagram(mut self, traffic: u8) -> Self {
        if let Carrier::Udp { class, .. } = &mut self.frame.carrier {
            *class = traffic;
        }
        self
    }

    fn case(&self, name: &str, expected: impl Into<Expected>) -> Case {
        raw(name, &self.frame.bytes(), expected.into())
    }

    /// Returns a case where the frame is dropped and the neighbour gets an error.
    fn refused(&self, name: &str, counter: &str) -> Case {
        let code = match counter {
            "drop_no_route" | "drop_no_egress" => 1,
            "drop_hop_limit" => 3,
            _ => 4,
        };
        self.case(name, self.error(counter, code, 0))
    }

    fn too_big(&self, name: &str, mtu: u64) -> Case {
        self.case(name, self.error("drop_too_big", 2, mtu))
    }

    fn error(&self, counter: &str, code: u8, mtu: u64) -> Expected {
        let told = mtu << 32 | u64::from(self.frame.link_counter as u32);
        let error = sends(self, self.frame.link_id, told).with(|f| {
            (f.version_type, f.hop_limit, f.egress_set) = (0x22, 1, code);
            (f.payload, f.payload_len) = (vec![], None);
        });
        Expected { counter: counter.into(), ..error.into() }
    }
}

fn raw(name: &str, frame: &[u8], kernel: Expected) -> Case {
    Case { name: name.into(), frame: Bytes::new(frame), kernel, userspace: None }
}

/// A sent frame after forwarding.
struct Forwarded(Frame);

fn sends(sent: &Sent, by: u32, bits: u64) -> Forwarded {
    let link = link(by);
    let phase = link.tx_phase as u8;
    Forwarded(Frame {
        to_mac: fixtures::array(&link.peer_mac.replace(':', "")),
        from_mac: fixtures::array(&link.local_mac.replace(':', "")),
        carrier: link.leaves_in(sent.frame.flags),
        flags: sent.frame.flags & 0x7f | phase << 7,
        hop_limit: sent.frame.hop_limit.wrapping_sub(1),
        egress_bits: bits,
        link_id: link.peer_id,
        link_counter: link.tx_counter + 1,
        key: fixtures::key(&link.tx_keys[usize::from(phase)]),
        padding: 0,
        ..sent.frame.clone()
    })
}

impl Forwarded {
    fn with(mut self, change: impl FnOnce(&mut Frame)) -> Self {
        change(&mut self.0);
        self
    }
}

impl From<Forwarded> for Expected {
    fn from(out: Forwarded) -> Self {
        let frame = Some(Bytes::new(&out.0.bytes()));
        Self { verdict: Verdict::Send, counter: "forwarded".into(), frame, copies: vec![] }
    }
}

fn delivers(sent: &Sent, to: u32) -> Expected {
    Expected { counter: "delivered".into(), ..sends(sent, to, 0).into() }
}

fn drop(counter: &str) -> Expected {
    Expected { verdict: Verdict::Drop, counter: counter.into(), frame: None, copies: vec![] }
}

fn pass(counter: &str) -> Expected {
    Expected { verdict: Verdict::Pass, ..drop(counter) }
}

fn copied(mut copies: Vec<CopyOut>) -> Expected {
    copies.sort();
    Expected { verdict: Verdict::Copy, copies, ..drop("replicated") }
}

/// Returns the first receive and transmit keys of a link.
fn keys(id: u32) -> ([u64; 2], [u64; 2]) {
    let link = link(id);
    (fixtures::key(&link.rx_keys[0]), fixtures::key(&link.tx_keys[0]))
}

fn link(id: u32) -> Link {
    switch().links.into_iter().find(|link| link.id == id).expect("a link of the switch")
}

fn endpoint(label: &str, id: u32, port: Option<u32>) -> Link {
    Link { role: Role::Endpoint, port, ..neighbour(label, id, 0, &[], 1500) }
}

fn neighbour(label: &str, id: u32, port: u32, reach: &[u32], mtu: u32) -> Link {
    let index = id as u8;
    let key =
        |direction: u8| (0..16).map(|i| format!("{:02x}", ((i + 1) * 11) ^ index ^ direction)).collect::<String>();
    Link {
        label: label.into(),
        id,
        peer_id: 0xbeef_0000 | u32::from(index),
        role: Role::Switch,
        transit: false,
        port: Some(port),
        rx_keys: [key(0), key(0x40)],
        tx_keys: [key(0x80), key(0xc0)],
        tx_phase: 0,
        reach: reach.to_vec(),
        mtu,
        peer_mac: format!("02:00:00:00:{index:02x}:01"),
        local_mac: format!("02:00:00:00:{index:02x}:02"),
        peer: fixtures::hex(&name(label)),
        // The counter of `EAST` wraps around.
        tx_counter: if id == EAST { u32::MAX.into() } else { 0x0102_0300 + u64::from(index) },
        taken: vec![],
        vlan: 0,
        udp: None,
    }
}

/// Returns a neighbour over UDP, behind the gateway of its address family.
fn remote(label: &str, id: u32, local: &str, peer: &str, reach: &[u32]) -> Link {
    let peer: SocketAddr = peer.parse().expect("an address");
    let gateway = if peer.is_ipv4() { 4 } else { 6 };
    Link {
        peer_mac: format!("02:00:00:00:ee:{gateway:02x}"),
        local_mac: "02:00:00:00:ee:01".into(),
        udp: Some(Udp { local: local.parse().expect("an address"), peer, routed: true }),
        ..neighbour(label, id, 0, reach, 1472)
    }
}

fn with_checksum(mut link: Link) -> Link {
    link.port = None;
    link.udp.iter_mut().for_each(|udp| udp.routed = false);
    link
}

fn route(label: &str, egress: &[u32], readers: &[u32]) -> Route {
    Route {
        label: label.into(),
        name: fixtures::hex(&name(label)),
        egress: egress.to_vec(),
        egress_set: 0,
        readers: readers.to_vec(),
        writers: vec![ROBOT],
        sources: vec![],
    }
}

/// Returns 32 bytes that differ for each label.
fn name(label: &str) -> [u8; 32] {
    let mut name = [0; 32];
    for (part, chunk) in name.chunks_exact_mut(8).enumerate() {
        let mut words = [part as u64; 4];
        label
            .bytes()
            .enumerate()
            .for_each(|(i, b)| words[i % 4] = words[i % 4].wrapping_mul(257).wrapping_add(b.into()));
        chunk.copy_from_slice(&gdp_wire::siphash::siphash24([1, 2], &words).to_be_bytes());
    }
    name
}
