//! Two replicas of a RIB, etcd, and a switch that follows the leader.
//!
//! The timers of terms are those of `gdp_rib::leadership::lease`, and the switch's choice that of
//! `gdp_rib::leadership::fence`. etcd is modelled: it grants one leader at a time a lease, and
//! confirms who leads. Requests and answers take any time. The clock of a replica may once
//! lose less than the margin.

use std::time::Duration;

use gdp_rib::leadership::fence::Fence;
use gdp_rib::leadership::lease::{Lease, MARGIN, TTL, end_of_lease};
use stateright::{Checker, HasDiscoveries, Model, Property};

use crate::faults;

const REPLICAS: usize = 2;

/// How much a clock may lose.
const DRIFT: Duration = MARGIN.saturating_sub(Duration::from_millis(1));

#[test]
fn no_two_replicas_lead_at_once() {
    check(Domain { step: Duration::from_secs(1), steps: 8 + faults(0), has_switch: false });
}

#[test]
fn no_switch_follows_a_former_leader() {
    // A term is over after one step.
    check(Domain { step: TTL, steps: 2 + faults(0), has_switch: true });
}

fn check(domain: Domain) {
    let checker = domain.checker().finish_when(HasDiscoveries::AnyFailures).spawn_bfs().join();
    println!("{} states, at most {} steps", checker.unique_state_count(), checker.max_depth());
    checker.assert_properties();
}

struct Domain {
    /// How far time goes at once, and how often.
    step: Duration,
    steps: u32,
    has_switch: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct World {
    now: Duration,
    replicas: [Replica; REPLICAS],
    etcd: Etcd,
    fence: Fence,
    /// The highest run that the switch followed.
    highest: Option<u64>,
    /// A push under way, by its run.
    push: Option<u64>,
    report: Option<Report>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Replica {
    /// By how much its clock is behind.
    behind: Duration,
    request: Option<Request>,
    term: Option<Term>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Term {
    run: u64,
    lease: Lease<Duration>,
    /// The replica has seen its end.
    has_ended: bool,
}

/// A request to etcd: to lead, or to renew the lease.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Request {
    /// By the clock of the replica.
    asked: Duration,
    renews: Option<u64>,
    /// The run that may lead, or `None` if etcd refuses.
    answer: Option<Option<u64>>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Etcd {
    leader: Option<(usize, u64)>,
    expires: Duration,
    revision: u64,
}

/// A report of the switch. etcd confirms the leader that accepts it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Report {
    follows: Option<u64>,
    accepted: Option<u64>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Step {
    Pass,
    /// Time passes, and the clock of this replica is slow.
    PassSlowly(usize),
    /// A replica asks to lead, or to renew its lease.
    Ask(usize),
    Process(usize),
    Answer(usize),
    Push(usize),
    ArrivePush,
    Report,
    AcceptReport,
    ArriveReport,
}

impl Model for Domain {
    type State = World;
    type Action = Step;

    fn init_states(&self) -> Vec<World> {
        let (replicas, etcd, fence) = Default::default();
        vec![World { now: Duration::ZERO, replicas, etcd, fence, highest: None, push: None, report: None }]
    }

    fn actions(&self, world: &World, steps: &mut Vec<Step>) {
        if world.now < self.step * self.steps {
            steps.push(Step::Pass);
            // One of the replicas suffices.
            if world.replicas[0].behind.is_zero() && !self.has_switch {
                steps.push(Step::PassSlowly(0));
            }
        }
        for (i, replica) in world.replicas.iter().enumerate() {
            match &replica.request {
                None => steps.push(Step::Ask(i)),
                Some(Request { answer: None, .. }) => steps.push(Step::Process(i)),
                Some(Request { answer: Some(_), .. }) => steps.push(Step::Answer(i)),
            }
            if self.has_switch && world.leads(i).is_some() && world.push.is_none() {
                steps.push(Step::Push(i));
            }
        }
        steps.extend(world.push.map(|_| Step::ArrivePush));
        if !self.has_switch {
            return;
        }
        match &world.report {
            None => steps.push(Step::Report),
            Some(Report { accepted: None, .. }) if world.confirmed().is_some() => steps.push(Step::AcceptReport),
            Some(Report { accepted: None, .. }) => {}
            Some(Report { accepted: Some(_), .. }) => steps.push(Step::ArriveReport),
        }
    }

    fn next_state(&self, last: &World, step: Step) -> Option<World> {
        let mut world = last.clone();
        world.step(self.step, &step);
        (0..REPLICAS).for_each(|i| world.look_at_clock(i));
        (world != *last).then_some(world)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        let mut all = vec![
            Property::always("at most one replica leads", |_, world: &World| {
                (0..REPLICAS).filter(|i| world.leads(*i).is_some()).count() <= 1
            }),
            Property::always("who leads is the leader at etcd", |_, world: &World| {
                (0..REPLICAS).all(|i| world.leads(i).is_none_or(|run| world.confirmed() == Some((i, run))))
            }),
            Property::always("a term that was over stays so", |_, world: &World| {
                let mut terms =
                    world.replicas.iter().zip(0..).filter_map(|(replica, i)| Some((replica.term.as_ref()?, i)));
                terms.all(|(term, i)| !term.has_ended || world.leads(i).is_none())
            }),
            Property::always("the switch follows no earlier leader than before", |_, world: &World| {
                world.fence.follows() >= world.highest
            }),
            Property::sometimes("another replica leads after the first", |_, world: &World| {
                (0..REPLICAS).any(|i| world.leads(i) == Some(2))
            }),
        ];
        if self.has_switch {
            all.push(Property::sometimes("a push of a former leader is refused", |_, world: &World| {
                world.fence.refused() > 0
            }));
        }
        all
    }
}

impl World {
    fn step(&mut self, time: Duration, step: &Step) {
        match *step {
            Step::Pass => self.now += time,
            Step::PassSlowly(i) => {
                self.now += time;
                self.replicas[i].behind = DRIFT;
            }
            Step::Ask(i) => {
                let renews = self.replicas[i].term.as_ref().map(|term| term.run);
                self.replicas[i].request = Some(Request { asked: self.clock(i), renews, answer: None });
            }
            Step::Process(i) => self.process(i),
            Step::Answer(i) => self.answer(i),
            Step::Push(i) => self.push = self.leads(i),
            Step::ArrivePush => {
                let run = self.push.take().expect("a push is under way");
                let _ = self.fence.admit(run, self.now);
            }
            Step::Report => self.report = Some(Report { follows: self.fence.follows(), accepted: None }),
            Step::AcceptReport => {
                let confirmed = self.confirmed().map(|(_, run)| run);
                self.report.as_mut().expect("a report is under way").accepted = confirmed;
            }
            Step::ArriveReport => {
                let Report { follows, accepted } = self.report.take().expect("a report is under way");
                self.fence.reported(accepted.expect("it is accepted"), follows);
            }
        }
        self.highest = self.highest.max(self.fence.follows());
    }

    fn process(&mut self, i: usize) {
        let confirmed = self.confirmed();
        let request = self.replicas[i].request.as_mut().expect("a request is under way");
        let run = match (request.renews, confirmed) {
            (None, None) => {
                self.etcd.revision += 1;
                self.etcd.leader = Some((i, self.etcd.revision));
                Some(self.etcd.revision)
            }
            (Some(run), Some(leader)) if leader == (i, run) => Some(run),
            _ => None,
        };
        request.answer = Some(run);
        if run.is_some() {
            self.etcd.expires = self.now + TTL;
        }
    }

    fn answer(&mut self, i: usize) {
        let now = self.clock(i);
        let replica = &mut self.replicas[i];
        let Some(Request { asked, renews, answer: Some(run) }) = replica.request.take() else { return };
        match (run, renews, &mut replica.term) {
            (Some(run), None, _) => {
                replica.term = Some(Term { run, lease: Lease::new(end_of_lease(asked)), has_ended: false });
            }
            (Some(_), Some(_), Some(term)) => {
                if !term.lease.extend(now, end_of_lease(asked)) {
                    replica.term = None;
                }
            }
            _ => replica.term = None,
        }
    }

    fn look_at_clock(&mut self, i: usize) {
        let now = self.clock(i);
        if let Some(term) = &mut self.replicas[i].term {
            term.has_ended |= term.lease.is_over(now);
        }
    }

    fn clock(&self, i: usize) -> Duration {
        self.now.saturating_sub(self.replicas[i].behind)
    }

    /// Returns the run of a replica that acts as leader.
    fn leads(&self, i: usize) -> Option<u64> {
        let term = self.replicas[i].term.as_ref()?;
        (!term.lease.is_over(self.clock(i))).then_some(term.run)
    }

    /// Returns the leader by etcd, and its run.
    fn confirmed(&self) -> Option<(usize, u64)> {
        self.etcd.leader.filter(|_| self.now < self.etcd.expires)
    }
}
