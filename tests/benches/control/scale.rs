//! Three tiers of domains in simulated time, with the RIBs that daemons run. One domain is at the
//! top, some are in the middle, many at the edge; each has ten switches. Every name is published at
//! the edge; one name in ten is read in another edge domain. Then entities withdraw and publish
//! names. The benchmark counts the RIBs' messages and bytes, the memory of each RIB, and the time
//! until a reader's RIB knows a writer.
//!
//! All signatures are real, and each RIB verifies them. Links have their configured delay; RIBs
//! take no simulated time.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use gdp_core::cert::domain::roles;
use gdp_core::cert::{Host, MemberCert, Membership, Revocation, SwitchStatement, issue};
use gdp_core::identity::Identity;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control;
use gdp_proto::control::{EntityRequest, RecordKey, Response, TierRequest, TierResponse};
use gdp_rib::rib::{Limits, Now, Rib, RibRun};
use gdp_rib::tiers;
use gdp_rib::tiers::{Effect, Hosted, Item, Reply, Revoked, Sent, TierChange, Tiers};
use gdp_rib::topology::Paths;
use gdp_tests::measure::figure::{Figure, Measure, Unit};
use gdp_wire::Name;

use crate::Bench;
use crate::memory::held;
use crate::owner::Owner;

/// Domains of each tier; a thousand in total.
const MIDDLE: usize = 31;
const EDGE: usize = 968;

/// Switches per domain: ten thousand in total.
const SWITCHES: usize = 10;

/// One name in this many is read in another domain.
const CROSSING: usize = 10;

/// Names that are withdrawn and published again each minute, as a share of all names.
const CHURN: f64 = 0.01;
const MINUTES: u64 = 2;

/// One-way delay between a domain and its parent.
const DELAY: Duration = Duration::from_millis(10);

const TIERS: [&str; 3] = ["top", "middle", "edge"];

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let mut world = World::new(bench.names)?;
    world.fill()?;
    world.run(Duration::from_secs(120))?;
    let filled = world.settled()?;
    let memory: Vec<f64> = TIERS.iter().map(|tier| world.memory(tier)).collect();
    let mut traffic = world.churn()?;
    traffic.settled.sort_unstable();
    let case = format!("{} names, {} domains, {} switches", bench.names, 1 + MIDDLE + EDGE, 10 * (1 + MIDDLE + EDGE));
    let each = |values: &[f64]| {
        let all = TIERS.iter().zip(values).map(|(tier, value)| Measure::new(tier, &case, vec![*value]));
        all.collect::<Vec<_>>()
    };
    let at = |percent: usize| traffic.settled[(traffic.settled.len() - 1) * percent / 100].as_secs_f64() * 1000.0;
    ensure!(filled > 0 && !traffic.settled.is_empty(), "nothing crossed");
    let title =
        |what: &str| format!("{what}, 1 % of all names coming and going each minute, one of ten across domains");
    let convergence = ["median", "99th percentile"].into_iter().zip([50, 99]);
    let convergence = convergence.map(|(series, percent)| Measure::new(series, &case, vec![at(percent)]));
    Ok(vec![
        Figure::new("scale-messages", title("Messages that one RIB sends"), Unit::EachSecond, each(&traffic.messages)),
        Figure::new("scale-bytes", title("Bytes per second that one RIB sends"), Unit::BytesEach, each(&traffic.bytes)),
        Figure::new(
            "scale-convergence",
            title("From a statement until the other domain's RIB knows"),
            Unit::Milliseconds,
            convergence.collect(),
        ),
        Figure::new("scale-memory", "Memory of one RIB and its tiers", Unit::Bytes, each(&memory)),
    ])
}

struct Domain {
    identity: Identity,
    parent: Option<usize>,
    tier: usize,
    tiers: Tiers,
    rib: Rib,
    hosts: Vec<(Identity, Arc<Hosted>)>,
    robot: Identity,
    serial: u64,
    /// The next time when the domain's tiers have work, as in [`World::ticks`].
    tick: Option<Duration>,
    /// Bytes of the domain's RIB and tiers.
    memory: usize,
    messages: u64,
    bytes: u64,
}

/// A revocation list without entries.
struct Nothing;

impl Revoked for Nothing {
    fn newest(&self, _name: &Name) -> Option<&Revocation> {
        None
    }

    fn signed(&self, _name: &Name) -> Option<&SignedRevocation> {
        None
    }
}

enum Travelling {
    Request { from: usize, to: usize, sent: Sent, bytes: Vec<u8> },
    Response { to: usize, from: usize, sent: Sent, bytes: Vec<u8> },
}

struct World {
    owner: Owner,
    names: usize,
    now: Now,
    domains: Vec<Domain>,
    index: BTreeMap<Name, usize>,
    travelling: BTreeMap<(Duration, u64), Travelling>,
    /// The next tick of each domain that has one. A tick per message would cost more: each tick
    /// examines all neighbours.
    ticks: BTreeSet<(Duration, usize)>,
    number: u64,
    random: u64,
    /// Names that a reader's RIB must learn, and the time of their publication.
    awaited: BTreeMap<Name, Duration>,
    settled: Vec<Duration>,
}

/// Mean traffic of each RIB, by tier.
struct Traffic {
    messages: Vec<f64>,
    bytes: Vec<f64>,
    settled: Vec<Duration>,
}

impl World {
    fn new(names: usize) -> Result<Self> {
        let owner = Owner::new()?;
        let now = Now { unix: owner.now(), clock: Duration::from_secs(1) };
        let mut domains = vec![Domain::new(now, 0, None)?];
        for _ in 0..MIDDLE {
            domains.push(Domain::new(now, 1, Some(0))?);
        }
        for i in 0..EDGE {
            domains.push(Domain::new(now, 2, Some(1 + i % MIDDLE))?);
        }
        let index: BTreeMap<Name, usize> = domains.iter().enumerate().map(|(i, d)| (d.identity.name(), i)).collect();
        let all: Vec<Name> = domains.iter().map(|domain| domain.identity.name()).collect();
        let mut adjacent: Vec<BTreeSet<Name>> = vec![BTreeSet::new(); domains.len()];
        for (i, parent) in domains.iter().enumerate().filter_map(|(i, domain)| Some((i, domain.parent?))) {
            adjacent[i].insert(all[parent]);
            adjacent[parent].insert(all[i]);
        }
        for (domain, adjacent) in domains.iter_mut().zip(adjacent) {
            domain.tiers.set_parents(now, domain.parent.map(|parent| all[parent]).into_iter().collect());
            domain.tiers.set_adjacent(now, adjacent);
        }
        let (travelling, ticks, awaited, settled) = Default::default();
        let mut world =
            Self { owner, names, now, domains, index, travelling, ticks, number: 0, random: 7, awaited, settled };
        (0..world.domains.len()).try_for_each(|i| world.collect(i))?;
        Ok(world)
    }

    fn edge(&self, number: usize) -> usize {
        1 + MIDDLE + number % EDGE
    }

    /// Returns the domain that reads a crossing name; it is always the same.
    fn reader_of(&self, number: usize) -> usize {
        let writer = number % EDGE;
        1 + MIDDLE + (writer + 1 + (number / EDGE) * 37 % (EDGE - 1)) % EDGE
    }

    fn fill(&mut self) -> Result<()> {
        for number in 0..self.names {
            gdp_tests::wait::check_interrupt()?;
            if number.is_multiple_of(CROSSING) {
                self.read(number)?;
            }
            self.publish(number)?;
        }
        (0..self.domains.len()).try_for_each(|i| self.collect(i))
    }

    fn publish(&mut self, number: usize) -> Result<()> {
        let (at, reader) = (self.edge(number), self.reader_of(number));
        let crosses = number.is_multiple_of(CROSSING);
        let scope = if crosses { vec![self.domains[reader].identity.name()] } else { Vec::new() };
        if crosses {
            self.awaited.insert(self.owner.name(number), self.now.clock);
        }
        let domain = &mut self.domains[at];
        domain.serial += 1;
        let switch = domain.hosts[number % SWITCHES].0.name();
        let request = self.owner.advertise(number, &domain.robot, switch, domain.serial, scope)?;
        domain.state(self.now, number % SWITCHES, &request)
    }

    fn read(&mut self, number: usize) -> Result<()> {
        let at = self.reader_of(number);
        let domain = &mut self.domains[at];
        domain.serial += 1;
        let switch = domain.hosts[number % SWITCHES].0.name();
        let request = self.owner.subscribe(number, &domain.robot, switch, domain.serial)?;
        domain.state(self.now, number % SWITCHES, &request)
    }

    /// Returns how many awaited names have arrived.
    fn settled(&mut self) -> Result<usize> {
        ensure!(self.awaited.is_empty(), "{} names did not get to their readers' RIBs", self.awaited.len());
        Ok(std::mem::take(&mut self.settled).len())
    }

    /// Withdraws names and publishes them again, at random and at even intervals.
    fn churn(&mut self) -> Result<Traffic> {
        for domain in &mut self.domains {
            (domain.messages, domain.bytes) = (0, 0);
        }
        let time = Duration::from_secs(60 * MINUTES);
        let count = ((self.names as f64) * CHURN * MINUTES as f64) as u32;
        for _ in 0..count.max(1) {
            gdp_tests::wait::check_interrupt()?;
            let number = self.below(self.names);
            let at = self.edge(number);
            let name = self.owner.name(number);
            let domain = &mut self.domains[at];
            domain.serial += 1;
            let withdraw =
                self.owner.withdraw(number, &domain.robot, domain.hosts[number % SWITCHES].0.name(), domain.serial)?;
            domain.state(self.now, number % SWITCHES, &withdraw)?;
            self.collect(at)?;
            self.awaited.remove(&name);
            self.run(time / count.max(1) / 2)?;
            self.publish(number)?;
            self.collect(at)?;
            self.run(time / count.max(1) / 2)?;
        }
        self.run(Duration::from_secs(5))?;
        let seconds = (60 * MINUTES + 5) as f64;
        let mean = |of: fn(&Domain) -> u64| {
            let tier = |tier: usize| self.domains.iter().filter(move |domain| domain.tier == tier);
            (0..TIERS.len()).map(|i| tier(i).map(of).sum::<u64>() as f64 / tier(i).count() as f64 / seconds).collect()
        };
        let (messages, bytes) = (mean(|domain| domain.messages), mean(|domain| domain.bytes));
        ensure!(self.awaited.is_empty(), "{} names did not get to their readers' RIBs", self.awaited.len());
        Ok(Traffic { messages, bytes, settled: std::mem::take(&mut self.settled) })
    }

    /// Returns the mean bytes of a tier's RIB.
    fn memory(&self, tier: &str) -> f64 {
        let of: Vec<usize> =
            self.domains.iter().filter(|domain| TIERS[domain.tier] == tier).map(|domain| domain.memory).collect();
        of.iter().sum::<usize>() as f64 / of.len() as f64
    }

    /// Advances simulated time.
    fn run(&mut self, time: Duration) -> Result<()> {
        let end = self.now.clock + time;
        loop {
            gdp_tests::wait::check_interrupt()?;
            let message = self.travelling.keys().next().map(|(at, _)| *at);
            let tick = self.ticks.first().map(|(at, _)| *at);
            let Some(next) = message.into_iter().chain(tick).min().filter(|next| *next <= end) else { break };
            self.pass(next.max(self.now.clock));
            while let Some(entry) = self.travelling.first_entry().filter(|entry| entry.key().0 <= self.now.clock) {
                let message = entry.remove();
                self.deliver(message)?;
            }
            while let Some((_, index)) = self.ticks.first().copied().filter(|(at, _)| *at <= self.now.clock) {
                self.set_tick(index, None);
                let (before, now) = (held(), self.now);
                self.domains[index].tiers.tick(now);
                self.domains[index].account(before);
                self.collect(index)?;
            }
        }
        self.pass(end);
        Ok(())
    }

    fn pass(&mut self, to: Duration) {
        self.now.unix += to.as_secs() - self.now.clock.as_secs();
        self.now.clock = to;
    }

    /// Sends a domain's messages, and records the names that its RIB has learned.
    fn collect(&mut self, index: usize) -> Result<()> {
        let (before, now, domain) = (held(), self.now, &mut self.domains[index]);
        domain.follow(now)?;
        let effects = domain.tiers.effects(now);
        let changes = domain.tiers.take_changes(now);
        domain.account(before);
        for change in changes {
            if let TierChange::Set(Item::Part { record: held, only_passes: false }) = change
                && held.key.role.is_writer()
                && let Some(since) = self.awaited.remove(&held.key.name)
            {
                self.settled.push(now.clock - since);
            }
        }
        for effect in effects {
            let Effect::Ask { to, sent, request } = effect else { bail!("nobody has asked") };
            let bytes = control::encode(&request).context("it fits a message")?;
            let to = *self.index.get(&to).context("a domain that is not there")?;
            self.domains[index].messages += 1;
            self.domains[index].bytes += bytes.len() as u64;
            self.number += 1;
            let message = Travelling::Request { from: index, to, sent, bytes: bytes[4..].to_vec() };
            self.travelling.insert((now.clock + DELAY, self.number), message);
        }
        let tick = self.domains[index].tiers.next_tick();
        self.set_tick(index, tick.map(|tick| tick.max(now.clock + Duration::from_millis(1))));
        Ok(())
    }

    fn set_tick(&mut self, index: usize, tick: Option<Duration>) {
        if let Some(before) = std::mem::replace(&mut self.domains[index].tick, tick) {
            self.ticks.remove(&(before, index));
        }
        self.ticks.extend(tick.map(|tick| (tick, index)));
    }

    fn deliver(&mut self, message: Travelling) -> Result<()> {
        let (before, now) = (held(), self.now);
        let index = match message {
            Travelling::Request { from, to, sent, bytes } => {
                let request: TierRequest = control::decode(&bytes)?;
                drop(bytes);
                let asker = self.domains[from].identity.name();
                let Reply::Now(response) = self.domains[to].tiers.request(now, asker, request, &Nothing) else {
                    bail!("nobody has asked");
                };
                self.domains[to].account(before);
                if let TierResponse::Refused(refusal) = &response {
                    bail!("refused: {refusal}");
                }
                let bytes = control::encode(&response).context("it fits a message")?;
                self.domains[to].bytes += bytes.len() as u64;
                self.number += 1;
                let message = Travelling::Response { to: from, from: to, sent, bytes: bytes[4..].to_vec() };
                self.travelling.insert((now.clock + DELAY, self.number), message);
                to
            }
            Travelling::Response { to, from, sent, bytes } => {
                let response: TierResponse = control::decode(&bytes)?;
                drop(bytes);
                let other = self.domains[from].identity.name();
                self.domains[to].tiers.answered(now, other, sent, Some(response), &Nothing);
                self.domains[to].account(before);
                to
            }
        };
        self.collect(index)
    }

    fn below(&mut self, bound: usize) -> usize {
        self.random = self.random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.random >> 33) as usize % bound
    }
}

impl Domain {
    fn new(now: Now, tier: usize, parent: Option<usize>) -> Result<Self> {
        let before = held();
        let (identity, robot) = (Identity::generate("domain")?, Identity::generate("proxy")?);
        let host = |i: usize| {
            let (switch, role) = (Identity::generate("switch")?, roles::SWITCH.to_owned());
            let (domain, entity, serial) = (identity.name(), switch.name(), i as u64 + 1);
            let claims = MemberCert { domain, entity, role, serial, not_before: 0, not_after: u64::MAX };
            let membership = Membership::issue(&identity, &claims)?;
            let claims =
                SwitchStatement { switch: entity, domain, addresses: Vec::new(), serial: 1, not_after: u64::MAX };
            let (proof, statement) = (switch.proof(), issue(switch.key(), &claims)?);
            let host = Host { proof, statement, membership };
            anyhow::Ok((switch, Arc::new(Hosted { host, domain, not_after: u64::MAX })))
        };
        let hosts: Vec<_> = (0..SWITCHES).map(host).collect::<Result<_>>()?;
        let limits = Limits { names_per_entity: usize::MAX, ..Limits::default() };
        let mut rib = Rib::new(hosts[0].0.name(), RibRun { id: 1, settling: Duration::ZERO }, limits);
        let costs = hosts.iter().map(|(switch, _)| (switch.name(), 1)).collect();
        rib.set_paths(now, Paths { costs, ..Paths::default() });
        for (switch, _) in &hosts {
            ensure!(matches!(rib.report(now, &switch.proof(), &[], None), Response::Reported { .. }));
        }
        let tiers = Tiers::new(identity.name(), 1, tiers::TierLimits::default());
        let mut domain = Self {
            identity,
            parent,
            tier,
            tiers,
            rib,
            hosts,
            robot,
            serial: 0,
            tick: None,
            memory: 0,
            messages: 0,
            bytes: 0,
        };
        // Discards the first result, which lists all keys.
        domain.rib.take_changed_keys();
        domain.account(before);
        Ok(domain)
    }

    /// Attributes the process's growth since `before` to this domain.
    fn account(&mut self, before: usize) {
        self.memory = (self.memory + held()).saturating_sub(before);
    }

    /// Passes an entity's statement to the RIB, as a tool does: without an attachment.
    fn state(&mut self, now: Now, host: usize, request: &EntityRequest) -> Result<()> {
        let before = held();
        let switch = self.hosts[host].0.name();
        match self.rib.request(now, switch, Some(&self.robot.proof()), true, request) {
            Response::Refused(refusal) => bail!("refused: {refusal}"),
            response => drop(response),
        }
        // Messages that the daemon would send are not part of the RIB.
        self.rib.effects(now);
        self.account(before);
        Ok(())
    }

    /// Passes the RIB's changes to the tiers, as the daemon does.
    fn follow(&mut self, now: Now) -> Result<()> {
        let changed: Vec<RecordKey> = self.rib.take_changed_keys().into_iter().collect();
        for place in changed {
            match self.rib.export(now, &place) {
                Some(export) => {
                    let host = self.hosts.iter().find(|(switch, _)| switch.name() == place.switch);
                    let (_, host) = host.context("a switch that is not there")?;
                    self.tiers.set_own(now, export.record, host.clone())?;
                }
                None => self.tiers.remove_own(place),
            }
        }
        Ok(())
    }
}
