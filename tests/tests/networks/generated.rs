//! A million generated frames through `decide` over plain tables, the XDP switch under
//! `BPF_PROG_TEST_RUN`, the DPDK loops and the userspace plane. Verdict, bytes and counters must be
//! equal, frame by frame.
//!
//! All planes retain their link state from frame to frame. Replays, late frames and counters beyond
//! 2³² are therefore among the cases.

#[path = "../../../crates/gdp-wire/tests/tables/mod.rs"]
mod tables;

use crate::frames;
use anyhow::{Context, Result, ensure};
use gdp_dataplane::kernel::{Buffers, KernelPlane};
use gdp_dataplane::link_memory::LinkMemory;
use gdp_dataplane::tables::UserTables;
use gdp_dpdk::Burst;
use gdp_dpdk::forwarding::Counts;
use gdp_wire::Counter;

use crate::planes::dpdk::{DpdkSwitch, NOWHERE};
use crate::planes::{Site, counted, is_for_no_data_socket, run_uncounted, run_userspace, user_tables};
use frames::fixtures::{self, Fate, Switch, Verdict};
use frames::generate::Generator;
use tables::PlainTables;

const SEED: u64 = 20_261_120;

const FRAMES: usize = 1_000_000;

/// Reading the kernel's counters costs as much as twenty frames, so they are read after this many
/// frames.
const CHUNK: usize = 2000;

const BURSTS_OF_COPIES: usize = 500;

/// Least count of each counter that a plane can reach.
const OF_EACH: u64 = 100;

#[test]
fn the_kernel_does_what_decide_says_with_a_million_frames() -> Result<()> {
    let switch = plain_switch();
    let mut site = Kernel::new(&switch)?;
    let mut generator = Generator::new(SEED, &switch);
    let mut seen = [0; Counter::COUNT];
    for chunk in 0..FRAMES / CHUNK {
        let before = site.plane.counters()?;
        let mut expected = before;
        for i in 0..CHUNK {
            let frame = generator.frame();
            let fate = site.compare(&frame).with_context(|| describe(chunk * CHUNK + i, &frame))?;
            expected[fate.counter as usize] += 1;
            seen[fate.counter as usize] += 1;
        }
        if site.plane.counters()? != expected {
            return Err(find_miscounted(&switch, chunk * CHUNK)?);
        }
    }
    // The kernel leaves notices to the userspace plane. It counts redirect losses only after the
    // redirect. Rates need time.
    reached(seen, &[Counter::Notice, Counter::RedirectLost, Counter::PuntLimit])
}

#[test]
fn the_userspace_plane_does_what_decide_says_with_a_million_frames() -> Result<()> {
    let switch = plain_switch();
    let site = Userspace::new(&switch);
    let mut generator = Generator::new(SEED, &switch);
    let mut seen = [0; Counter::COUNT];
    for i in 0..FRAMES {
        let frame = generator.frame();
        let fate = site.compare(&frame).with_context(|| describe(i, &frame))?;
        seen[fate.counter as usize] += 1;
        fate.copies.iter().for_each(|(_, counter)| seen[*counter as usize] += 1);
    }
    reached(seen, &[Counter::Slow, Counter::RedirectFailed, Counter::RedirectLost, Counter::PuntLimit])
}

/// Uses bursts of all sizes: batch processing must equal processing of each frame.
#[test]
fn dpdk_does_what_decide_says_with_a_million_frames() -> Result<()> {
    let switch = plain_switch();
    let mut site = Dpdk::new(&switch)?;
    let mut generator = Generator::new(SEED, &switch);
    let (mut seen, mut frames) = ([0; Counter::COUNT], 0);
    while frames < FRAMES {
        let (burst, counts) = site.compare(|| generator.frame(), 1 + frames * 7 % Burst::SIZE);
        let counts = counts.with_context(|| format!("frames from {frames} on, {burst} together, of seed {SEED}"))?;
        seen.iter_mut().zip(counts).for_each(|(seen, count)| *seen += count);
        frames += burst;
    }
    // Notices belong to the userspace plane, as do links without a device. Rates need time.
    reached(seen, &[Counter::Notice, Counter::RedirectFailed, Counter::RedirectLost, Counter::PuntLimit])
}

/// A burst makes more copies than can wait together: some leave before the rest is decided.
#[test]
fn dpdk_makes_the_copies_that_decide_says_of_bursts_with_many() -> Result<()> {
    let switch = plain_switch();
    let mut site = Dpdk::new(&switch)?;
    let mut generator = Generator::new(SEED, &switch);
    let scout = PlainTables::<true>::new(&switch).with_all_copies_but_by(NOWHERE);
    let mut copied = || loop {
        let frame = generator.frame();
        if scout.run(&frame).copies.len() > 1 {
            return frame;
        }
    };
    let mut most = 0;
    for burst in 0..BURSTS_OF_COPIES {
        let (frames, counts) = site.compare(&mut copied, Burst::SIZE);
        let counts = counts.with_context(|| format!("burst {burst} of {frames} frames of seed {SEED}"))?;
        most = most.max(counts[Counter::Forwarded as usize] + counts[Counter::Delivered as usize]);
    }
    ensure!(most > 2 * Burst::SIZE as u64, "{most} copies at most left together");
    Ok(())
}

struct Dpdk {
    plane: DpdkSwitch,
    tables: PlainTables<true>,
    links: Vec<u32>,
    /// Whether copies share their common part; alternates.
    gathers: bool,
}

impl Dpdk {
    fn new(switch: &Switch) -> Result<Self> {
        let plane = DpdkSwitch::new(switch)?;
        begin(plane.link_memory.clone(), switch);
        let tables = PlainTables::new(switch).with_all_copies_but_by(NOWHERE);
        Ok(Self { plane, tables, links: ids(switch), gathers: false })
    }

    /// Compares one burst with decide's results for its frames one by one. Returns the number of
    /// frames and their counts. A burst has at most `most` frames and ends with a frame that is
    /// answered with an error. A neighbour gets one such error at a time.
    fn compare(&mut self, mut next: impl FnMut() -> Vec<u8>, most: usize) -> (usize, Result<Counts>) {
        let (mut frames, mut sent, mut passed, mut counts) = (vec![], vec![], vec![], [0; Counter::COUNT]);
        let (mut is_over, mut fates) = (false, vec![]);
        while frames.len() < most && !is_over {
            let frame = next();
            let fate = self.tables.run(&frame);
            is_over = fate.verdict == Verdict::Send && fate.counter.is_drop();
            counts[fate.counter as usize] += 1;
            fates.push((fate.verdict, fate.counter, fate.copies.len()));
            match fate.verdict {
                Verdict::Pass => passed.push(frame.clone()),
                _ => sent.extend(fate.frame),
            }
            for (copy, counter) in fate.copies {
                counts[counter as usize] += 1;
                sent.extend(copy);
            }
            frames.push(frame);
        }
        (frames.len(), self.expect(&frames, (sent, passed), counts).with_context(|| format!("expected {fates:?}")))
    }

    fn expect(
        &mut self,
        frames: &[Vec<u8>],
        (mut sent, mut passed): (Vec<Vec<u8>>, Vec<Vec<u8>>),
        counts: Counts,
    ) -> Result<Counts> {
        forgive(&self.plane.link_memory, &self.links);
        let (mut seen, counted) = self.plane.run(frames, self.gathers)?;
        self.gathers = !self.gathers;
        [&mut sent, &mut passed, &mut seen.sent, &mut seen.passed].into_iter().for_each(|all| all.sort());
        ensure!(seen.sent == sent, "other frames left: {}", differences(&seen.sent, &sent));
        ensure!(seen.passed == passed, "other frames passed: {}", differences(&seen.passed, &passed));
        let differ =
            Counter::ALL.iter().zip(counted.iter().zip(&counts)).filter(|(_, (got, expected))| got != expected);
        let differ: Vec<_> = differ.collect();
        ensure!(differ.is_empty(), "counters, got and expected: {differ:?}");
        Ok(counts)
    }
}

/// Describes the first frames that only one of the two lists has.
fn differences(got: &[Vec<u8>], expected: &[Vec<u8>]) -> String {
    let only = |all: &[Vec<u8>], others: &[Vec<u8>]| {
        let one = all.iter().find(|frame| !others.contains(frame));
        one.map(|frame| fixtures::hex(&frame[..frame.len().min(160)]))
    };
    format!("{} and not {}; {:?} instead of {:?}", got.len(), expected.len(), only(got, expected), only(expected, got))
}

struct Kernel {
    // Fields drop in this order.
    plane: KernelPlane,
    _site: Site,
    tables: PlainTables<true>,
    memory: LinkMemory,
    links: Vec<u32>,
    /// Buffer layout of the next frame; alternates.
    buffers: Buffers,
}

impl Kernel {
    fn new(switch: &Switch) -> Result<Self> {
        let site = Site::build()?;
        let plane = site.kernel_plane(switch)?;
        let (tables, memory) = (PlainTables::new(switch).without_copies(), plane.link_memory().clone());
        let memory = begin(memory, switch);
        Ok(Self { plane, _site: site, tables, memory, links: ids(switch), buffers: Buffers::One })
    }

    /// Returns decide's result if the kernel's is the same. Kernel counters are compared elsewhere.
    fn compare(&mut self, frame: &[u8]) -> Result<Fate> {
        forgive(&self.memory, &self.links);
        let (expected, mut got) = (self.tables.run(frame), run_uncounted(&mut self.plane, self.buffers, frame)?);
        self.buffers = match self.buffers {
            Buffers::One => Buffers::Several,
            Buffers::Several => Buffers::One,
        };
        if (expected.verdict, got.verdict) == (Verdict::Copy, Verdict::Send) {
            // A frame that the kernel would copy does not count as a frame yet.
            got = Fate::copied(vec![]);
        }
        same(&expected, &Fate { counter: expected.counter, ..got })?;
        Ok(expected)
    }
}

struct Userspace<'s> {
    switch: &'s Switch,
    plane: UserTables,
    tables: PlainTables<false>,
    memory: LinkMemory,
    links: Vec<u32>,
}

impl<'s> Userspace<'s> {
    fn new(switch: &'s Switch) -> Self {
        let (plane, memory) = user_tables(switch);
        Self { switch, plane, tables: PlainTables::new(switch), memory: begin(memory, switch), links: ids(switch) }
    }

    fn compare(&self, frame: &[u8]) -> Result<Fate> {
        let expected = self.tables.run(frame);
        if !is_for_no_data_socket(self.switch, frame) {
            forgive(&self.memory, &self.links);
            same(&expected, &run_userspace(&self.plane, self.switch, frame))?;
        }
        Ok(expected)
    }
}

fn same(expected: &Fate, got: &Fate) -> Result<()> {
    ensure!(expected == got, "     got {}\nexpected {}", shown(got), shown(expected));
    Ok(())
}

/// Fails unless every counter that the plane can reach was reached.
fn reached(seen: [u64; Counter::COUNT], others: &[Counter]) -> Result<()> {
    let reachable = Counter::ALL.iter().zip(seen).filter(|(counter, _)| !others.contains(counter));
    let rare: Vec<_> = reachable.filter(|(_, seen)| *seen < OF_EACH).collect();
    ensure!(rare.is_empty(), "the generated frames hardly reached {rare:?}");
    Ok(())
}

/// Runs everything again, and finds the first of the frames from `start` on with a wrong counter.
fn find_miscounted(switch: &Switch, start: usize) -> Result<anyhow::Error> {
    let mut site = Kernel::new(switch)?;
    let mut generator = Generator::new(SEED, switch);
    for _ in 0..start {
        site.compare(&generator.frame())?;
    }
    for i in start..start + CHUNK {
        let (frame, before) = (generator.frame(), site.plane.counters()?);
        let expected = site.compare(&frame)?.counter;
        let got = counted(before, site.plane.counters()?);
        if !matches!(got, Ok(got) if got == expected) {
            return Ok(anyhow::anyhow!("counted {got:?}, expected {expected:?}").context(describe(i, &frame)));
        }
    }
    Ok(anyhow::anyhow!("frames from {start} on were miscounted, but not when they were run again"))
}

fn describe(index: usize, frame: &[u8]) -> String {
    format!("frame {index} of seed {SEED}: {}", fixtures::hex(frame))
}

fn shown(fate: &Fate) -> String {
    let bytes = |frame: &Option<Vec<u8>>| frame.as_deref().map(|frame| fixtures::hex(&frame[..frame.len().min(128)]));
    let copies: Vec<_> = fate.copies.iter().map(|(copy, counter)| (bytes(copy), counter)).collect();
    format!("{:?} {:?} {:?} {copies:?}", fate.verdict, fate.counter, bytes(&fate.frame))
}

/// Returns the fixtures' switch without any arrivals on its links.
fn plain_switch() -> Switch {
    let mut switch = fixtures::read().switch;
    switch.links.iter_mut().for_each(|link| link.taken.clear());
    switch
}

fn begin(memory: LinkMemory, switch: &Switch) -> LinkMemory {
    for link in &switch.links {
        memory.begin(link.id);
        memory.set_count(link.id, link.tx_counter);
    }
    memory
}

/// Resets the limits of errors to neighbours and of probes to the daemon: plain tables have no
/// time.
fn forgive(memory: &LinkMemory, links: &[u32]) {
    links.iter().for_each(|link| memory.forgive(*link));
}

fn ids(switch: &Switch) -> Vec<u32> {
    switch.links.iter().map(|link| link.id).collect()
}
