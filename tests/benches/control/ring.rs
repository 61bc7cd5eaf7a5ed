//! A ring of five XDP switches with their daemons. First row: the link that carries traffic is cut;
//! measures the time until traffic recovers, with one name and with many. Second row: a switch's
//! daemon is killed; measures the time from its start until the RIB has sent it all names.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_ctl::client::Client;
use gdp_proto::admin::Request;
use gdp_proto::admin::status::StatusReply;
use gdp_proto::control::{EntityRequest, Response};
use gdp_tests::Tools;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::ring::{CLOUD_AT, ROBOT_AT, Ring};
use gdp_tests::wait::{TIMEOUT, check_interrupt, wait_for};
use gdp_wire::Name;

use crate::Bench;
use crate::owner::Owner;
use crate::traffic::Traffic;

/// Names of the switch whose daemon is killed.
const RECONCILED: usize = 100_000;

/// Concurrent commands to a daemon, which accepts 32; and names that one command states for the
/// same entity.
const TOOLS: usize = 30;
const NAMES_OF_ONE: usize = 1024;

/// Names in one push of a RIB.
const NAMES_PER_PUSH: usize = 400;

const RECOVERY: f64 = 200.0;
const RECONCILIATION: f64 = 2000.0;

const TRAFFIC: &str = "traffic";
const DAEMON: &str = "daemon";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let mut ring = Ring::start(Tools::beside_this_test()?)?;
    let owner = Owner::new()?;
    let (few, some, many) = (0, RECONCILED.min(bench.names), bench.names);
    let mut recovery = vec![Measure::new(TRAFFIC, cases(few), cut(&mut ring, bench.rounds)?)];
    state(&ring, &owner, few..some)?;
    let back = Measure::new(DAEMON, cases(some), reconcile(&mut ring, bench.rounds, some)?);
    state(&ring, &owner, some..many)?;
    recovery.push(Measure::new(TRAFFIC, cases(many), cut(&mut ring, bench.rounds)?));
    let title = "Until traffic flows again after the link it went by was cut, in a ring of five";
    let recovery = Figure::new("control-recovery", title, Unit::Milliseconds, recovery);
    let recovery = [few, many].iter().fold(recovery, |f, n| f.aim(TRAFFIC, &cases(*n), Aim::AtMost(RECOVERY)));
    let recovery = recovery.compare_with(TRAFFIC, (TRAFFIC, &cases(few)), |_| None);
    let title = "Until a switch holds its FIB from the RIB again after its daemon was killed, from its start";
    let back = Figure::new("control-reconcile", title, Unit::Milliseconds, vec![back]);
    Ok(vec![recovery, back.aim(DAEMON, &cases(some), Aim::AtMost(RECONCILIATION))])
}

fn cases(names: usize) -> String {
    format!("{names} names")
}

/// Returns the milliseconds without a message at each cut; the writer sends one message each
/// millisecond.
fn cut(ring: &mut Ring, rounds: usize) -> Result<Vec<f64>> {
    let traffic = Traffic::start((&ring.robot, ring.folder_of("robot")), (&ring.cloud, ring.folder_of("cloud")))?;
    let mut gaps = Vec::new();
    for _ in 0..rounds {
        check_interrupt()?;
        ring.wait("traffic by s2", |ring| {
            let before = ring.forwarded(1)?;
            std::thread::sleep(Duration::from_millis(100));
            Ok(ring.forwarded(1)? > before + 50)
        })?;
        traffic.wait_for_more(500, TIMEOUT)?;
        let lost = traffic.nothing_came_twice()?;
        ring.set_cable(0, false)?;
        traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
        gaps.push((traffic.nothing_came_twice()? - lost) as f64);
        ring.set_cable(0, true)?;
    }
    Ok(gaps)
}

/// Publishes each of these names at the robot's switch and reads it at the cloud's. A statement
/// waits until the switches have its routes. Therefore many statements are in flight at once, as if
/// from as many robots.
fn state(ring: &Ring, owner: &Owner, names: Range<usize>) -> Result<()> {
    let of_all = |i: usize| -> Result<Name> { Ok(ring.switches[i].name.parse()?) };
    let (robots, clouds) = (of_all(ROBOT_AT)?, of_all(CLOUD_AT)?);
    let (writers, readers) = (ring.switches[ROBOT_AT].socket(), ring.switches[CLOUD_AT].socket());
    let write = |n, entity: &_, serial| owner.advertise(n, entity, robots, serial, Vec::new());
    let read = |n, entity: &_, serial| owner.subscribe(n, entity, clouds, serial);
    std::thread::scope(|scope| {
        let of_robots = scope.spawn(|| side(&names, writers, write));
        side(&names, readers, read)?;
        joined(of_robots)
    })
}

/// States these names with concurrent tools. Each batch of names has its own entity: statements of
/// an entity must arrive in the order of their serials. Serials start above those that the RIB has
/// forgotten.
fn side(
    names: &Range<usize>,
    socket: &Path,
    request: impl Fn(usize, &Identity, u64) -> Result<EntityRequest> + Sync,
) -> Result<()> {
    let next = AtomicUsize::new(names.start);
    let tool = || {
        let mut client = Client::connect(socket)?;
        loop {
            check_interrupt()?;
            let first = next.fetch_add(NAMES_OF_ONE, Ordering::Relaxed);
            let numbers = first..names.end.min(first + NAMES_OF_ONE);
            if numbers.is_empty() {
                return Ok(());
            }
            let entity = Identity::generate("proxy")?;
            let serial = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_nanos() as u64;
            for (serial, number) in (serial..).zip(numbers) {
                let request = Box::new(request(number, &entity, serial)?);
                let said = client.ask::<Response>(&Request::Entity { entity: Some(entity.proof()), request })?;
                ensure!(matches!(said, Response::Peers(_)), "{said:?}");
            }
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..TOOLS).map(|_| scope.spawn(tool)).collect();
        threads.into_iter().try_for_each(joined)
    })
}

fn joined(thread: ScopedJoinHandle<Result<()>>) -> Result<()> {
    thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Returns the milliseconds from each restart of the cloud's daemon until the RIB has sent it all
/// names.
fn reconcile(ring: &mut Ring, rounds: usize, names: usize) -> Result<Vec<f64>> {
    let mut times = Vec::new();
    let pushes = names.div_ceil(NAMES_PER_PUSH) as u64;
    for _ in 0..rounds {
        let before = ring.generation(CLOUD_AT)?;
        ring.switches[CLOUD_AT].process.kill()?;
        let begin = Instant::now();
        ring.start_again(CLOUD_AT)?;
        let socket = ring.switches[CLOUD_AT].socket().to_owned();
        let holds = || {
            let Ok(mut client) = Client::connect(&socket) else { return Ok(None) };
            let status: Box<StatusReply> = client.ask(&Request::Status)?;
            Ok((status.fib.generation >= before + pushes).then_some(()))
        };
        wait_for("all names", 3 * TIMEOUT, holds).with_context(|| ring.report())?;
        times.push(begin.elapsed().as_secs_f64() * 1000.0);
    }
    Ok(times)
}
