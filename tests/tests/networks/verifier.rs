//! What it takes to load the programs: the instructions that the kernel's verifier processes for
//! each. It follows paths, so a program's size does not show them, and a harmless change can double
//! them.

use std::collections::HashMap;

use anyhow::{Context as _, Result, bail, ensure};
use aya::EbpfLoader;
use aya::programs::Program;
use gdp_tests::Tools;
use gdp_wire::losses::NetDevices;

/// Has a table with a row for each program and a column for each kernel that was measured.
const DOCUMENT: &str = include_str!("../../../docs/architecture.md");

const HEADER: &str = "| program | verified on ";

/// Instructions that a program may have for each two in the table. Compilers differ.
const MARGIN: u32 = 3;

#[test]
fn the_verifier_processes_few_instructions_of_each_program() -> Result<()> {
    let release = std::fs::read_to_string("/proc/sys/kernel/osrelease")?;
    let mut documented = documented(&release)?;
    let mut loader = EbpfLoader::new();
    // Without these, the verifier would skip code that a daemon needs.
    let net_devices = NetDevices { namespace: 1, ifindex: 8, net: 16, inum: 24 };
    loader.override_global("NET_DEVICES", &net_devices, true).override_global("ASKS_AT_EGRESS", &1u32, true);
    let mut ebpf = loader.load(&std::fs::read(Tools::beside_this_test()?.ebpf_object()?)?)?;
    let mut grown = Vec::new();
    for (name, program) in ebpf.programs_mut() {
        let info = match program {
            Program::Xdp(program) => program.load().and_then(|()| program.info()),
            Program::RawTracePoint(program) => program.load().and_then(|()| program.info()),
            _ => bail!("{name} is of a type that this test does not load"),
        };
        let info = info.with_context(|| name.to_owned())?;
        // Kernels before 5.16 do not report it.
        let Some(verified) = info.verified_instruction_count() else { return Ok(()) };
        println!("{name}: {verified}");
        let expected = documented.remove(name).with_context(|| format!("the table has no row for {name}"))?;
        if verified > expected * MARGIN / 2 {
            grown.push(format!("{name}: {verified} instructions, {expected} in the table"));
        }
    }
    ensure!(grown.is_empty(), "more to verify than docs/architecture.md states: {}", grown.join("; "));
    ensure!(documented.is_empty(), "the table has rows for programs that do not exist: {documented:?}");
    Ok(())
}

/// Returns the instructions of each program in the table: those of the running kernel, or else of
/// the kernel with most.
fn documented(release: &str) -> Result<HashMap<String, u32>> {
    let mut lines = DOCUMENT.lines().skip_while(|line| !line.starts_with(HEADER));
    let kernels: Vec<String> = cells(lines.next().context("the document has no table of instructions")?);
    let is_running = |kernel: &String| {
        let version = kernel.trim_start_matches("verified on ");
        release.strip_prefix(version).is_some_and(|rest| !rest.starts_with(|next: char| next.is_ascii_digit()))
    };
    let running = kernels.iter().position(is_running);
    let rows = lines.skip(1).take_while(|line| line.starts_with('|')).map(cells);
    rows.map(|cells| {
        let counts = cells[1..].iter().map(|cell| cell.replace(' ', "").parse());
        let counts = counts.collect::<Result<Vec<u32>, _>>().with_context(|| format!("{cells:?}"))?;
        let count = running.map_or_else(|| counts.iter().max(), |column| counts.get(column - 1));
        Ok((cells[0].trim_matches('`').to_owned(), *count.with_context(|| format!("{cells:?}"))?))
    })
    .collect()
}

fn cells(line: &str) -> Vec<String> {
    line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
}
