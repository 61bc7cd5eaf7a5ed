//! Advertisements that a RIB accepts per second on one CPU, counted in signatures that it must
//! verify. The comparison is with the verification of the same signatures alone. There is no
//! network: the benchmark calls the RIB as its daemon does.

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use gdp_core::identity::Identity;
use gdp_proto::control::{EntityRequest, Response};
use gdp_rib::rib::{Limits, Now, Rib, RibRun};
use gdp_tests::measure::cpu;
use gdp_tests::measure::figure::{Aim, Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};

use crate::Bench;
use crate::owner::Owner;

/// Statements per measurement, each about another name.
const STATEMENTS: usize = 4096;

/// Signatures per advertisement: the owner's on the certificate, the entity's on its statement.
const SIGNATURES: f64 = 2.0;

/// Aim: share of the rate of verifications alone.
const ENOUGH: f64 = 0.7;

const RIB: &str = "RIB";
const BARE: &str = "ECDSA";
const CASE: &str = "advertise";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    cpu::on(cpu::SENDER, || measure(bench))
}

fn measure(bench: &Bench) -> Result<Vec<Figure>> {
    let (owner, switch, robot) = (Owner::new()?, Identity::generate("switch")?, Identity::generate("proxy")?);
    let attach = owner.attach(&robot, switch.name(), false)?;
    let all: Vec<EntityRequest> = (0..STATEMENTS)
        .map(|i| owner.advertise(i, &robot, switch.name(), i as u64 + 1, Vec::new()))
        .collect::<Result<_>>()?;
    let now = Now { unix: owner.now(), clock: Duration::from_secs(1) };
    let mut bare = || {
        let (message, key) = ([7u8; 300], owner.key().verify_key());
        let signature = owner.key().sign(&message)?;
        let begin = Instant::now();
        for _ in 0..2 * STATEMENTS {
            key.verify(&message, &signature)?;
        }
        Ok(rate(begin, 2 * STATEMENTS))
    };
    let mut rib = || {
        let run = RibRun { id: 1, settling: Duration::ZERO };
        let mut rib = Rib::new(switch.name(), run, Limits::default());
        ensure!(matches!(rib.report(now, &switch.proof(), &[], None), Response::Reported { .. }));
        let mut ask =
            |request: &EntityRequest| match rib.request(now, switch.name(), Some(&robot.proof()), false, request) {
                Response::Refused(refusal) => bail!("refused: {refusal}"),
                _ => Ok(()),
            };
        ask(&attach)?;
        let begin = Instant::now();
        for request in &all {
            ask(request)?;
        }
        let sample = rate(begin, STATEMENTS);
        Ok(Sample { value: sample.value * SIGNATURES, ..sample })
    };
    let contenders = vec![Contender::new(RIB, CASE, &mut rib), Contender::new(BARE, CASE, &mut bare)];
    let measures = alternate(bench.rounds, contenders)?;
    let title = "Signatures verified on one CPU: under advertisements at a RIB, two each, and alone";
    let figure = Figure::new("control-statements", title, Unit::PerSecond, measures);
    Ok(vec![figure.compare(RIB, BARE, |_| Some(Aim::AtLeast(ENOUGH)))])
}

fn rate(begin: Instant, count: usize) -> Sample {
    Sample { value: count as f64 / begin.elapsed().as_secs_f64(), ..Sample::default() }
}
