//! The harness's cable with faults: real frames experience the model's faults. Counts are exact;
//! times are bounded from below only.
//!
//! ```text
//!  robot r0 ── w0:wire:w1 ── l0 cloud
//! ```

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use gdp_faults::{Burst, Faults, MILLISECOND, Network, Reorder, SECOND};
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::frames::Frame;
use gdp_tests::frames::carrier::Carrier;
use gdp_tests::packet::PacketSocket;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_tests::wire::Wire;

const SEED: u64 = 4;

#[test]
fn frames_meet_on_the_wire_what_they_meet_in_simulated_time() -> Result<()> {
    const FRAMES: u64 = 20_000;
    let faults = Faults {
        delay: 5 * MILLISECOND,
        jitter: 2 * MILLISECOND,
        loss: 0.05,
        burst: Some(Burst { enter: 0.01, leave: 0.2, loss: 1.0 }),
        reorder: Some(Reorder { probability: 0.02, by: 20 * MILLISECOND }),
        duplicate: 0.05,
        corrupt: 0.05,
        ..Faults::default()
    };
    let both = [faults.clone(), Faults { loss: 0.5, ..faults }];
    let site = Site::new(both.clone())?;
    let mut simulated = Network::new(SEED);
    let [there, back] = both;
    let cable = simulated.join([0, 1], there, back);

    for (node, (from, to)) in [(&site.robot, &site.cloud), (&site.cloud, &site.robot)].into_iter().enumerate() {
        for number in 0..FRAMES {
            let frame = numbered(number);
            from.send(&frame)?;
            simulated.send(node, cable, frame.clone(), frame.len());
            site.keep_up(node, number)?;
        }
        let mut expected: BTreeMap<Vec<u8>, usize> = BTreeMap::new();
        while let Some(mut arrival) = simulated.arrival(simulated.now() + SECOND) {
            arrival.delivery.damage(14);
            *expected.entry(arrival.delivery.frame).or_default() += 1;
        }
        let arrived = receive(to, simulated.counts(node, cable).delivered)?;
        let overtaken = arrived.windows(2).filter(|pair| number_of(&pair[1]) < number_of(&pair[0])).count();
        ensure!(overtaken > 100, "{overtaken} frames were overtaken");
        let mut counted: BTreeMap<Vec<u8>, usize> = BTreeMap::new();
        arrived.into_iter().for_each(|frame| *counted.entry(frame).or_default() += 1);
        ensure!(counted == expected, "node {node}: other frames arrived than in the simulation");
        ensure!(site.wire.counts(node) == simulated.counts(node, cable));
    }
    // The link loses 5 % of the frames, and 1 in 21 in bursts of 5. Bursts are rare, so their bound
    // is wider.
    let counts = site.wire.counts(0);
    ensure!((0.04..0.06).contains(&(counts.lost as f64 / FRAMES as f64)), "{counts:?}");
    ensure!((0.03..0.065).contains(&(counts.lost_in_bursts as f64 / FRAMES as f64)), "{counts:?}");
    site.wire.check()
}

#[test]
fn a_slow_wire_takes_its_time_and_marks_and_drops_what_is_too_much() -> Result<()> {
    const FRAMES: u64 = 200;
    const QUEUE: u64 = 100_000;
    // One millisecond per frame of a thousand bytes.
    let rate = Faults { rate: Some(8_000_000), ..Faults::delay(30 * MILLISECOND) };
    let slow = Faults { queue: Some(QUEUE), mark_above: Some(QUEUE / 2), ..rate };
    let site = Site::new([slow, Faults::default()])?;
    let began = Instant::now();
    for number in 0..FRAMES {
        site.robot.send(&datagram(number))?;
    }
    wait_for("the wire", TIMEOUT, || Ok((site.wire.counts(0).sent == FRAMES).then_some(())))?;
    let counts = site.wire.counts(0);
    let arrived = receive(&site.cloud, counts.delivered)?;
    let took = began.elapsed();
    let least = Duration::from_millis(30 + counts.delivered);
    ensure!(took >= least, "{} frames took {took:?}, less than {least:?}", counts.delivered);
    ensure!(counts.delivered + counts.overflowed == FRAMES && counts.delivered >= QUEUE / 1000, "{counts:?}");
    let marked = arrived.iter().filter(|frame| frame[15] & 0b11 == 0b11).count() as u64;
    ensure!(marked == counts.marked && marked <= counts.delivered - QUEUE / 2000, "{marked}, {counts:?}");
    ensure!(arrived.is_sorted(), "out of order");
    site.wire.check()
}

#[test]
fn nothing_gets_over_a_cut_wire_and_all_over_a_mended_one() -> Result<()> {
    let site = Site::new([Faults::default(), Faults::default()])?;
    let cut = Faults { partitions: vec![(0, u64::MAX)], ..Faults::default() };
    site.wire.change([cut.clone(), cut]);
    for number in 0..100 {
        site.robot.send(&numbered(number))?;
        site.cloud.send(&numbered(number))?;
    }
    let both = |count: fn(&Wire, usize) -> u64, n| [0, 1].iter().all(|direction| count(&site.wire, *direction) == n);
    let partitioned = || Ok(both(|wire, direction| wire.counts(direction).partitioned, 100).then_some(()));
    wait_for("frames to meet the cut", TIMEOUT, partitioned)?;
    site.wire.change([Faults::default(), Faults::default()]);
    for number in 100..200 {
        site.robot.send(&numbered(number))?;
        site.cloud.send(&numbered(number))?;
    }
    for end in [&site.cloud, &site.robot] {
        ensure!(receive(end, 100)?.iter().map(|frame| number_of(frame)).eq(100..200));
    }
    site.wire.check()
}

#[test]
fn tcp_gets_through_a_bad_wire() -> Result<()> {
    const BYTES: usize = 1 << 20;
    let faults = Faults {
        delay: MILLISECOND,
        loss: 0.01,
        duplicate: 0.01,
        corrupt: 0.01,
        reorder: Some(Reorder { probability: 0.01, by: 2 * MILLISECOND }),
        ..Faults::default()
    };
    let site = Site::new([faults.clone(), faults])?;
    site.chain.become_ip_routers()?;
    let (_, address) = site.chain.ip_ends();
    let listener = {
        let _inside = site.chain.cloud().enter()?;
        TcpListener::bind((address.as_str(), 4000))?
    };
    let robot = site.chain.robot().door()?;
    let sent: Vec<u8> = (0..BYTES).map(|i| (i * i / 7) as u8).collect();
    let sending = sent.clone();
    let sender = std::thread::spawn(move || -> Result<()> {
        let _inside = robot.enter()?;
        Ok(TcpStream::connect_timeout(&format!("{address}:4000").parse()?, TIMEOUT)?.write_all(&sending)?)
    });
    let (mut stream, _) = listener.accept()?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    let mut received = Vec::new();
    stream.read_to_end(&mut received)?;
    ensure!(received == sent, "what arrived is not what was sent");
    ensure!(sender.join().is_ok_and(|sent| sent.is_ok()));
    let counts = site.wire.counts(0);
    ensure!([counts.lost, counts.duplicated, counts.corrupted, counts.reordered].iter().all(|n| *n > 0), "{counts:?}");
    site.wire.check()
}

/// Robot and cloud with a faulty cable between them.
struct Site {
    // Drops before the interfaces that it uses.
    wire: Wire,
    robot: PacketSocket,
    cloud: PacketSocket,
    chain: Chain,
}

impl Site {
    fn new(faults: [Faults; 2]) -> Result<Self> {
        let chain = Chain::build(ChainOptions { switches: 0, wire: Some(0), ..Default::default() })?;
        let wire = chain.disturb_wire(faults, SEED)?;
        let robot = PacketSocket::open(chain.robot(), "r0")?;
        let cloud = PacketSocket::open(chain.cloud(), "l0")?;
        [&robot, &cloud].into_iter().try_for_each(|socket| socket.set_receive_buffer(64 << 20))?;
        Ok(Self { wire, robot, cloud, chain })
    }

    /// Waits now and then until the wire has taken the sent frames. Otherwise a kernel queue would
    /// overflow.
    fn keep_up(&self, direction: usize, number: u64) -> Result<()> {
        if number % 64 != 63 {
            return Ok(());
        }
        wait_for("the wire", TIMEOUT, || Ok((self.wire.counts(direction).sent > number).then_some(())))
    }
}

/// Returns the received frames in the order of their arrival.
fn receive(socket: &PacketSocket, count: u64) -> Result<Vec<Vec<u8>>> {
    let frames: Result<Vec<_>> = (0..count).map(|_| socket.receive(TIMEOUT, |_| true)).collect();
    ensure!(socket.try_receive(&mut [0; 2048])?.is_none(), "more than {count} frames arrived");
    frames
}

/// Returns a frame with its number in the addresses, which corruption never affects.
fn numbered(number: u64) -> Vec<u8> {
    Frame { to_mac: mac(number), payload: vec![0x5a; 40], ..Frame::default() }.bytes()
}

fn number_of(frame: &[u8]) -> u64 {
    frame[2..6].iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

/// Returns a thousand bytes of IP from an ECN-capable sender.
fn datagram(number: u64) -> Vec<u8> {
    const ECT: u8 = 0b10;
    let [from, to] = [1, 2].map(|host| ([10, 9, 0, host], 5000).into());
    let carrier = Carrier::Udp { from, to, class: ECT };
    let around = Frame { carrier, payload: Vec::new(), ..Frame::default() }.bytes().len();
    Frame { to_mac: mac(number), carrier, payload: vec![0; 1000 - around], ..Frame::default() }.bytes()
}

fn mac(number: u64) -> [u8; 6] {
    let [a, b, c, d] = (number as u32).to_be_bytes();
    [0x02, 0, a, b, c, d]
}
