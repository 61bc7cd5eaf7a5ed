//! Memory of a RIB per published name: bytes with all certificates, and without the signed bytes.
//! The counter includes every allocation of the process; no other work runs during the measurement.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use gdp_core::identity::Identity;
use gdp_proto::control::{EntityRequest, Response};
use gdp_rib::rib::{Limits, Now, Rib, RibRun};
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};

use crate::Bench;
use crate::owner::{Owner, shares};

/// Aim: bytes per name without the signed bytes.
const ENOUGH: f64 = 600.0;

const WITH: &str = "with certificates";
const WITHOUT: &str = "without";

struct Counting;

static HELD: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator; counting touches only an atomic.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        HELD.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's guarantees are those that `System` requires.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as above; this allocator returns only memory from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns the bytes that the process has allocated.
pub fn held() -> usize {
    HELD.load(Ordering::Relaxed)
}

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let (owner, switch) = (Owner::new()?, Identity::generate("switch")?);
    let now = Now { unix: owner.now(), clock: Duration::from_secs(1) };
    let before = held();
    let mut rib = Rib::new(switch.name(), RibRun { id: 1, settling: Duration::ZERO }, Limits::default());
    ensure!(matches!(rib.report(now, &switch.proof(), &[], None), Response::Reported { .. }));
    let mut signed = 0;
    for share in shares(bench.names) {
        gdp_tests::wait::check_interrupt()?;
        let robot = Identity::generate("proxy")?;
        let mut ask =
            |request: &EntityRequest| match rib.request(now, switch.name(), Some(&robot.proof()), false, request) {
                Response::Refused(refusal) => bail!("refused: {refusal}"),
                _ => Ok(()),
            };
        ask(&owner.attach(&robot, switch.name(), false)?)?;
        for (serial, number) in (1..).zip(share) {
            let request = owner.advertise(number, &robot, switch.name(), serial, Vec::new())?;
            ask(&request)?;
            let EntityRequest::Advertise { ad_cert, advert, .. } = request else { bail!("no advertisement") };
            signed += ad_cert.size() + advert.as_bytes().len();
        }
        // Messages that the daemon would send are not part of the RIB.
        rib.effects(now);
    }
    let taken = held().checked_sub(before).context("it frees more than it takes")?;
    ensure!(rib.name_count() == bench.names, "{} names", rib.name_count());
    let per_name = |bytes: usize| vec![bytes as f64 / bench.names as f64];
    let case = format!("{} names", bench.names);
    let measures =
        vec![Measure::new(WITH, &case, per_name(taken)), Measure::new(WITHOUT, &case, per_name(taken - signed))];
    let figure = Figure::new("control-memory", "Memory of a RIB per published name", Unit::BytesEach, measures);
    Ok(vec![figure.aim(WITHOUT, &case, Aim::AtMost(ENOUGH))])
}
