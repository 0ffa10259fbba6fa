//! Where the particles are kept: blocks of fixed size, a row of numbers for each entry of the state.

use super::accelerations::{Densities, covariance_entries};
use super::evaluation::Sensed;
use super::settings::Marginalised;
use crate::estimate::kalman::JerkModel;
use crate::scalar::{Lanes, Scalar};
use crate::simd::Kernel;
use rayon::prelude::*;

/// Particles a block. Sums are formed by block, then over blocks in order, whatever thread each was on.
pub(super) const BLOCK: usize = 512;
/// Particles that go through a kernel together.
pub(super) const WIDE: usize = 8;

pub(super) type Wide = Lanes<WIDE>;

/// A weight is zero below this logarithm of its part in the largest. No sum would notice it, but numbers too small to be
/// normal are slow.
const NEGLIGIBLE: f64 = -100.0;

/// A number of each particle of a block, by groups of [`WIDE`].
///
/// One group more than there are particles: rows a whole page apart would all want the same few lines of the cache.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct Row(pub(super) [[f64; WIDE]; BLOCK / WIDE + 1]);

impl Row {
    fn of(value: f64) -> Self {
        Self([[value; WIDE]; BLOCK / WIDE + 1])
    }

    /// Particle by particle.
    #[inline(always)]
    pub(super) fn each(&self) -> &[f64] {
        self.0.as_flattened()
    }

    #[inline(always)]
    pub(super) fn each_mut(&mut self) -> &mut [f64] {
        self.0.as_flattened_mut()
    }
}

/// Some particles, and the scratch to move them.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Number of the first particle.
    pub(super) first: usize,
    /// Particles in use.
    pub(super) count: usize,
    /// Entries of the state; after them, where accelerations are marginalised, of a covariance.
    pub(super) state: Vec<Row>,
    /// Logarithms of weights, −∞ for what is not in use.
    pub(super) log_weights: Row,
    /// Weights as multiples of the block's largest.
    pub(super) weights: Row,
    pub(super) sums: Sums,
    pub(super) scratch: Scratch,
    /// There where accelerations are marginalised.
    pub(super) densities: Option<Box<Densities>>,
}

/// Sums over a block, weights as multiples of its largest.
#[derive(Clone, Debug)]
pub(super) struct Sums {
    /// The largest logarithm of a weight, and whose it is.
    pub(super) largest: f64,
    pub(super) best: usize,
    pub(super) weight: f64,
    pub(super) square: f64,
    /// Of each entry of the state.
    pub(super) state: Vec<f64>,
    /// Of products of two entries' deviations, upper triangle by rows.
    pub(super) products: Vec<f64>,
}

/// Room for [`WIDE`] particles on their way.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    pub(super) sensed: Sensed<Wide>,
    /// q, q̇, q̈ and biases before the noise, and after it.
    pub(super) before: Vec<Wide>,
    pub(super) after: Vec<Wide>,
    /// Standard normal numbers, and the increments made of them in units of their standard deviation.
    pub(super) normal: Vec<Wide>,
    pub(super) noise: Vec<Wide>,
    /// Mode of the proposal.
    pub(super) mode: Vec<Wide>,
    /// Factor of its information matrix, by rows.
    pub(super) factor: Vec<Wide>,
}

impl Scratch {
    fn new(model: &JerkModel, drawn: usize) -> Self {
        let room = |size| vec![Wide::default(); size];
        let states = model.states();
        Self {
            sensed: Sensed::new(model),
            before: room(states),
            after: room(states),
            normal: room(states + 1),
            noise: room(drawn),
            mode: room(drawn),
            factor: room(drawn * drawn),
        }
    }
}

impl Block {
    fn new(model: &JerkModel, marginalised: Marginalised, first: usize, count: usize) -> Self {
        let (d, n) = (model.states(), model.joints());
        let accelerations = marginalised == Marginalised::Accelerations;
        let (more, drawn) = if accelerations { (covariance_entries(model), 2 * n) } else { (0, n) };
        Self {
            first,
            count,
            state: vec![Row::of(0.0); d + more],
            log_weights: Row::of(f64::NEG_INFINITY),
            weights: Row::of(0.0),
            sums: Sums {
                largest: f64::NEG_INFINITY,
                best: 0,
                weight: 0.0,
                square: 0.0,
                state: vec![0.0; d],
                products: vec![0.0; d * (d + 1) / 2],
            },
            scratch: Scratch::new(model, drawn),
            densities: accelerations.then(|| Box::new(Densities::new(model))),
        }
    }

    /// Sums of the state's entries by weights.
    #[inline(always)]
    fn sum_state(&mut self) {
        let Self { weights, sums, state, count, .. } = self;
        let used = count.div_ceil(WIDE);
        for (sum, row) in sums.state.iter_mut().zip(state) {
            *sum = dot(&weights.0[..used], &row.0[..used]);
        }
    }

    /// Groups of [`WIDE`] that hold a particle in use.
    #[inline(always)]
    pub(super) fn groups(&self) -> usize {
        self.count.div_ceil(WIDE)
    }

    /// Numbers of the particles of a group.
    #[inline(always)]
    pub(super) fn items(&self, group: usize) -> [u32; WIDE] {
        let first = (self.first + group * WIDE) as u32;
        core::array::from_fn(|l| first + l as u32)
    }
}

/// The weighted mean of a block times its weight, for all entries; log-weights become weights.
pub(super) struct Weigh<'a> {
    pub(super) block: &'a mut Block,
}

impl Kernel for Weigh<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Block { log_weights, weights, sums, count, .. } = &mut *self.block;
        let used = count.div_ceil(WIDE);
        let logs = &log_weights.0[..used];
        let mut most = [f64::NEG_INFINITY; WIDE];
        for logs in logs {
            for (most, log) in most.iter_mut().zip(logs) {
                *most = if log > most { *log } else { *most };
            }
        }
        sums.largest = most.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let group = logs.iter().position(|logs| logs.contains(&sums.largest)).unwrap_or(0);
        sums.best = group * WIDE + logs[group].iter().position(|log| *log == sums.largest).unwrap_or(0);
        let largest = if sums.largest.is_finite() { sums.largest } else { 0.0 };
        let [mut weight, mut square] = [Wide::default(); 2];
        for (out, logs) in weights.0.iter_mut().zip(logs) {
            let part = Lanes(*logs) + -largest;
            let mut w = part.map(|log| log.max(NEGLIGIBLE)).exp();
            for (w, log) in w.0.iter_mut().zip(part.0) {
                *w = if log < NEGLIGIBLE { 0.0 } else { *w };
            }
            *out = w.0;
            weight += w;
            square += w * w;
        }
        (sums.weight, sums.square) = (total(weight), total(square));
        self.block.sum_state();
    }
}

/// A block of copies of particles.
pub(super) struct Gather<'a> {
    pub(super) source: &'a [Block],
    pub(super) ancestors: &'a [u32],
    /// As [`Block::state`].
    pub(super) next: &'a mut [Row],
}

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { source, ancestors, next } = self;
        let mut from = 0;
        // Ancestors come in order, so that hardly ever more than two blocks take part.
        for run in ancestors.chunk_by(|a, b| *a as usize / BLOCK == *b as usize / BLOCK) {
            let rows = &source[run[0] as usize / BLOCK].state;
            for (next, row) in next.iter_mut().zip(rows) {
                let row = &row.each()[..BLOCK];
                for (slot, &a) in next.each_mut()[from..].iter_mut().zip(run) {
                    *slot = row[a as usize % BLOCK];
                }
            }
            from += run.len();
        }
    }
}

/// Gives all particles of a block one weight.
pub(super) struct Level<'a> {
    pub(super) block: &'a mut Block,
    pub(super) log_weight: f64,
}

impl Kernel for Level<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { block: Block { log_weights, weights, sums, count, .. }, log_weight } = self;
        log_weights.each_mut()[..*count].fill(log_weight);
        weights.each_mut()[..*count].fill(1.0);
        weights.each_mut()[*count..].fill(0.0);
        (sums.largest, sums.best, sums.weight, sums.square) = (log_weight, 0, *count as f64, *count as f64);
        self.block.sum_state();
    }
}

/// Σ w (x − mean)(x − mean)ᵀ of the first `entries` of the state, over a block.
pub(super) struct Deviations<'a> {
    pub(super) block: &'a mut Block,
    pub(super) mean: &'a [f64],
    pub(super) entries: usize,
}

impl Kernel for Deviations<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { block: Block { weights, sums, state, count, .. }, mean, entries } = self;
        let used = count.div_ceil(WIDE);
        let row = |d: usize| &state[d].0[..used];
        let weights = &weights.0[..used];
        let mut products = sums.products.iter_mut();
        for a in 0..entries {
            for (b, product) in (a..entries).zip(&mut products) {
                let mut sum = Wide::default();
                for ((w, x), y) in weights.iter().zip(row(a)).zip(row(b)) {
                    sum += Lanes(*w) * (Lanes(*x) + -mean[a]) * (Lanes(*y) + -mean[b]);
                }
                *product = total(sum);
            }
        }
    }
}

/// Four sums side by side, so that one addition need not wait for the other.
#[inline(always)]
pub(super) fn dot(a: &[[f64; WIDE]], b: &[[f64; WIDE]]) -> f64 {
    let mut sums = [Wide::default(); 4];
    let (fours, rest) = a.as_chunks::<4>();
    let (others, other_rest) = b.as_chunks::<4>();
    for (a, b) in fours.iter().zip(others) {
        for k in 0..4 {
            sums[k] += Lanes(a[k]) * Lanes(b[k]);
        }
    }
    for (a, b) in rest.iter().zip(other_rest) {
        sums[0] += Lanes(*a) * Lanes(*b);
    }
    total((sums[0] + sums[1]) + (sums[2] + sums[3]))
}

/// Sum of all lanes, always in the same order.
#[inline(always)]
fn total(x: Wide) -> f64 {
    let mut sums = x.0;
    let mut half = WIDE / 2;
    while half > 0 {
        for l in 0..half {
            sums[l] += sums[l + half];
        }
        half /= 2;
    }
    sums[0]
}

/// All particles.
#[derive(Clone, Debug)]
pub(super) struct Cloud {
    pub(super) blocks: Vec<Block>,
    /// Where chosen particles are copied to.
    pub(super) next: Vec<Vec<Row>>,
}

impl Cloud {
    pub(super) fn new(model: &JerkModel, marginalised: Marginalised, particles: usize) -> Self {
        let block = |first| Block::new(model, marginalised, first, BLOCK.min(particles - first));
        let blocks: Vec<Block> = (0..particles).step_by(BLOCK).map(block).collect();
        let next = blocks.iter().map(|block| vec![Row::of(0.0); block.state.len()]).collect();
        Self { blocks, next }
    }

    /// Calls `f` with every block, on all threads where `threads` says so.
    pub(super) fn each(&mut self, threads: bool, f: impl Fn(&mut Block) + Sync + Send) {
        if threads {
            self.blocks.par_iter_mut().for_each(f);
        } else {
            self.blocks.iter_mut().for_each(f);
        }
    }

    /// Entry `d` of particle `i`.
    #[inline(always)]
    pub(super) fn at(&self, i: usize, d: usize) -> f64 {
        self.blocks[i / BLOCK].state[d].each()[i % BLOCK]
    }
}
