//! The targets of fuzzing, on their corpus and on mutants of it: the same ones in every run.
#![allow(unreachable_pub)] // of the crate that is taken in

#[path = "../../fuzz/src/lib.rs"]
mod fuzz;

use std::fs;
use std::path::Path;

/// Mutants of each target.
const MUTANTS: usize = 60;

/// Numbers by a counter (Steele, Lea, Flood 2014: SplitMix64).
struct Draw(u64);

impl Draw {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) % end.max(1) as u64) as usize
    }

    /// Changes, removes, doubles or appends some bytes.
    fn mutate(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        for _ in 0..=self.below(4) {
            let (from, length) = (self.below(bytes.len()), 1 + self.below(8));
            let to = (from + length).min(bytes.len());
            match self.below(5) {
                0 => bytes.truncate(from),
                1 => drop(bytes.drain(from..to)),
                2 => bytes.extend_from_within(from..to),
                3 => bytes.extend_from_slice(&other[self.below(other.len())..]),
                _ => bytes[from..to].iter_mut().for_each(|byte| *byte = self.below(256) as u8),
            }
            if bytes.is_empty() {
                bytes.push(self.below(256) as u8);
            }
        }
    }
}

/// What fuzzing found worth keeping, in the order of names.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(target);
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files.iter().map(|file| fs::read(file).unwrap()).collect()
}

#[test]
fn targets_hold_on_their_corpus_and_on_mutants_of_it() {
    for (name, target) in fuzz::TARGETS {
        let seeds = corpus(name);
        assert!(!seeds.is_empty(), "{name} has no corpus");
        seeds.iter().for_each(|seed| target(seed));
        let mut draw = Draw(7);
        for _ in 0..MUTANTS {
            let mut bytes = seeds[draw.below(seeds.len())].clone();
            let other = &seeds[draw.below(seeds.len())];
            draw.mutate(&mut bytes, other);
            target(&bytes);
        }
    }
}
