//! The fixtures' switch in both data planes, and what becomes of a frame there.
#![allow(dead_code, reason = "each test that includes this uses a part of it")]

use anyhow::{Result, bail, ensure};
use gdp_ctl::plane::kernel::{Action, KernelPlane};
use gdp_ctl::plane::link_memory::LinkMemory;
use gdp_ctl::plane::userspace::{Outcome, UserTables, copies, handle};
use gdp_tests::Tools;
use gdp_tests::frames::fixtures::{Fate, Switch, Verdict};
use gdp_wire::{Counter, Header, LinkEntry};
use zerocopy::IntoBytes;

/// The fixtures' switch in the kernel, without groups.
pub fn kernel_plane(switch: &Switch) -> Result<KernelPlane> {
    let mut plane = KernelPlane::load(&Tools::beside_this_test()?.ebpf_object()?, 1024)?;
    fill(&mut plane, switch)?;
    Ok(plane)
}

/// Ports below 6 lead to `lo`: in a test run nothing is sent.
pub fn fill(plane: &mut KernelPlane, switch: &Switch) -> Result<()> {
    const LOOPBACK: u32 = 1;
    (0..6).try_for_each(|port| plane.set_port(port, LOOPBACK))?;
    plane.set_config(switch.config())?;
    switch.links().try_for_each(|link| plane.set_link(&link))?;
    for (name, entry, permitted) in switch.routes() {
        permitted.iter().try_for_each(|permit| plane.permit(permit))?;
        plane.set_route(&name, entry)?;
    }
    plane.set_next_hops(&switch.next_hops())?;
    Ok(())
}

pub fn user_tables(switch: &Switch) -> (UserTables, LinkMemory) {
    let link_memory = LinkMemory::new();
    (user_tables_with(switch, link_memory.clone()), link_memory)
}

pub fn user_tables_with(switch: &Switch, link_memory: LinkMemory) -> UserTables {
    let mut tables = UserTables::new(link_memory);
    for link in switch.links() {
        // Only to be told apart.
        let to = gdp::port::LinkAddr::Ethernet { ifindex: link.port, mac: [0; 6] };
        tables.set_link(link, to);
    }
    for (name, entry, permitted) in switch.routes() {
        tables.set_route(name, entry, &permitted);
    }
    switch.groups().for_each(|(group, readers)| tables.set_group(group, readers));
    tables.set_next_hops(&switch.next_hops());
    tables.set_own_bit(switch.config().own_bit);
    tables
}

/// What the kernel does with a frame: the action, and exactly one counter.
pub fn run(plane: &mut KernelPlane, frame: &[u8]) -> Result<Fate> {
    let before = plane.counters()?;
    let fate = run_uncounted(plane, frame)?;
    Ok(Fate { counter: counted(before, plane.counters()?)?, ..fate })
}

/// What the kernel does with a frame, but for how that is counted: `Slow`, `Forwarded` and `RedirectFailed` stand for whatever
/// passes, is sent and is dropped. Reading the counters takes far longer than the frame.
pub fn run_uncounted(plane: &mut KernelPlane, frame: &[u8]) -> Result<Fate> {
    let (action, out) = plane.test_run(frame)?;
    Ok(match action {
        Action::Redirect => Fate::sent(out, Counter::Forwarded),
        Action::Pass => {
            ensure!(out == frame, "a frame that passes was changed");
            Fate::new(Verdict::Pass, Counter::Slow)
        }
        Action::Drop => Fate::new(Verdict::Drop, Counter::RedirectFailed),
        Action::Other(action) => bail!("action {action}"),
    })
}

/// The one counter that has gone up, by one.
pub fn counted(before: [u64; Counter::COUNT], after: [u64; Counter::COUNT]) -> Result<Counter> {
    let differences = Counter::ALL.iter().zip(before.into_iter().zip(after));
    let risen: Vec<_> = differences.filter(|(_, (before, after))| before != after).collect();
    match risen[..] {
        [(counter, (before, after))] if after == before + 1 => Ok(*counter),
        _ => bail!("counted {risen:?}"),
    }
}

/// What the userspace plane does with a frame, dressed in the Ethernet header it came with or leaves with.
pub fn run_userspace(tables: &UserTables, switch: &Switch, frame: &[u8]) -> Fate {
    let mut gdp = frame[14..].to_vec();
    let carried = |link: u32, parts: &[&[u8]]| {
        let link = switch.links.iter().find(|entry| entry.id == link).expect("a link of the switch");
        [&ethernet(&link.entry(), &frame[12..14]), &parts.concat()[..]].concat()
    };
    match handle(&mut gdp, tables) {
        Outcome::Send { link, length, counter, .. } => Fate::sent(carried(link, &[&gdp[..length]]), counter),
        Outcome::Copies { ingress, group } => {
            let (mut sent, mut dropped) = (Vec::new(), Vec::new());
            copies(&gdp, (ingress, group), tables, |copy| sent.push(copy), |counter| dropped.push((None, counter)));
            let sent = sent
                .iter()
                .map(|copy| (Some(carried(copy.link, &[copy.header.as_bytes(), &gdp[Header::LEN..]])), copy.counter));
            Fate::copied(sent.chain(dropped).collect())
        }
        Outcome::Notice { .. } => Fate::new(Verdict::Pass, Counter::Notice),
        Outcome::Control => Fate::new(Verdict::Pass, Counter::Control),
        Outcome::Drop(counter) => Fate::new(Verdict::Drop, counter),
    }
}

fn ethernet(link: &LinkEntry, ethertype: &[u8]) -> Vec<u8> {
    let macs = [link.carrier.peer_mac, link.carrier.local_mac];
    macs.iter().flatten().flat_map(|word| word.to_ne_bytes()).chain(ethertype.iter().copied()).collect()
}
