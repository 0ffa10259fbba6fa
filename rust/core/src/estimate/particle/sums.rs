//! Sums over the particles of a block, always in the same order, and copies of them.

use super::cloud::{BLOCK, Block, ParticleRow, WIDE, Wide};
use crate::scalar::{Lanes, Scalar};
use crate::simd::Kernel;

/// A weight is zero below this logarithm of its part in the largest. No sum would notice it, but numbers too small to be
/// normal are slow.
const NEGLIGIBLE: f64 = -100.0;

impl Block {
    /// Sums of the state's entries by weights.
    #[inline(always)]
    fn sum_state(&mut self) {
        let Self { weights, sums, state, count, .. } = self;
        let used = count.div_ceil(WIDE);
        for (sum, row) in sums.state.iter_mut().zip(state) {
            *sum = dot(&weights.0[..used], &row.0[..used]);
        }
    }
}

/// The weighted mean of a block times its weight, for all entries; log-weights become weights.
pub(super) struct Weigh<'a> {
    /// Whose log-weights are read and whose sums are written.
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
        // The first of the largest, so that the best particle does not depend on the width of instructions.
        sums.best = group * WIDE + logs[group].iter().position(|log| *log == sums.largest).unwrap_or(0);
        let largest = if sums.largest.is_finite() { sums.largest } else { 0.0 };
        let [mut weight, mut square] = [Wide::default(); 2];
        for (out, logs) in weights.0.iter_mut().zip(logs) {
            // Relative to the block's largest: sums of blocks are brought to one scale later, in `Summary::weigh`.
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
    /// All blocks as they are.
    pub(super) source: &'a [Block],
    /// Numbers of the particles to copy, rising.
    pub(super) ancestors: &'a [u32],
    /// As [`Block::state`].
    pub(super) next: &'a mut [ParticleRow],
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
pub(super) struct EqualWeights<'a> {
    /// Of copies, all as likely.
    pub(super) block: &'a mut Block,
    /// −ln N.
    pub(super) log_weight: f64,
}

impl Kernel for EqualWeights<'_> {
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
    /// After [`Weigh`].
    pub(super) block: &'a mut Block,
    /// The whole cloud's, about which deviations are taken.
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
        let mut weighted = [Wide::default(); BLOCK / WIDE];
        for a in 0..entries {
            for ((weighted, w), x) in weighted.iter_mut().zip(weights).zip(row(a)) {
                *weighted = Lanes(*w) * (Lanes(*x) + -mean[a]);
            }
            for (b, product) in (a..entries).zip(&mut products) {
                let mut sum = Wide::default();
                for (weighted, y) in weighted[..used].iter().zip(row(b)) {
                    sum += *weighted * (Lanes(*y) + -mean[b]);
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
