//! The targets over their seeds and corpora, and over what a plain mutator makes of these: no
//! engine, no instrumentation, so that this runs wherever tests run.

use std::fs;
use std::path::PathBuf;

use gdp_fuzz::{TARGETS, seeds};
use gdp_tests::frames::generate::Random;

/// Of all cases of a target.
const MUTANTS: usize = 5000;

#[test]
fn every_case_and_its_mutants_through_its_target() {
    for (name, target) in TARGETS {
        let cases = [seeds(name), corpus(name)].concat();
        assert!(!cases.is_empty(), "{name} has nothing to begin with");
        let mut random = Random(1);
        for (case, bytes) in &cases {
            eprintln!("{name}: {case}");
            target(bytes);
            for _ in 0..MUTANTS / cases.len() {
                let (_, other) = &cases[random.below(cases.len())];
                target(&mutated(bytes, other, &mut random));
            }
        }
    }
}

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    let files = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files: Vec<_> = files.map(|file| file.unwrap().path()).collect();
    files.sort();
    let name = |file: &PathBuf| file.file_name().unwrap().to_string_lossy().into_owned();
    files.iter().map(|file| (name(file), fs::read(file).unwrap())).collect()
}

fn mutated(bytes: &[u8], other: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len().max(1));
        match random.below(5) {
            0 => bytes.truncate(at),
            1 => bytes.insert(at.min(bytes.len()), random.word() as u8),
            2 => bytes.splice(at.min(bytes.len()).., other.iter().skip(at).copied()).for_each(drop),
            _ if bytes.is_empty() => {}
            3 => bytes[at] ^= 1 << random.below(8),
            _ => bytes[at] = random.word() as u8,
        }
    }
    bytes
}
