//! Random numbers by counter: what a particle or a sensor draws depends on its number, the step and the seed alone.
//!
//! Philox 4×32-10 (Salmon, Moraes, Dror and Shaw 2011), so that neither threads nor the width of instructions enter.

use crate::scalar::{Lanes, Scalar, ln};

/// M and W of Philox 4×32, the paper's table 2 and section 3.3; ten rounds are its recommendation.
const MULTIPLIERS: [u64; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u64; 2] = [0x9E37_79B9, 0xBB67_AE85];
const ROUNDS: u32 = 10;
const WORD: u64 = 0xFFFF_FFFF;

/// What a number is drawn for; streams of different purposes never meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// The first cloud.
    Initialise,
    /// Process noise.
    Process,
    /// Heavy tails of a proposal.
    Tail,
    /// Resampling.
    Ancestors,
    /// The kernel after resampling.
    Regularise,
    /// A cloud from the Kalman filter's belief.
    Reseed,
    /// Noise of simulated readings.
    Sensors,
}

/// The random numbers of one step and purpose.
///
/// A number is a function of (seed, step, purpose, item, draw) and of nothing else: no state is handed from one draw to
/// the next, so that threads, blocks and lanes may take them in any order, and a sample may be drawn again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stream {
    /// The key; step and purpose are words of the counter.
    seed: u64,
    step: u32,
    purpose: u32,
}

impl Stream {
    pub(crate) fn new(seed: u64, step: u32, purpose: Purpose) -> Self {
        Self { seed, step, purpose: purpose as u32 }
    }

    /// The `draw`-th two uniform numbers in (0, 1) of each of `items`.
    #[inline(always)]
    pub(crate) fn uniforms<const L: usize>(&self, items: [u32; L], draw: u32) -> [Lanes<L>; 2] {
        let wide = |word: u32| [u64::from(word); L];
        let mut words = [items.map(u64::from), wide(draw), wide(self.step), wide(self.purpose)];
        philox(&mut words, self.seed);
        [open_unit(&words[0], &words[1]), open_unit(&words[2], &words[3])]
    }

    /// The `draw`-th two standard normal numbers of each of `items` (Box and Muller 1958).
    #[inline(always)]
    pub(crate) fn normals<const L: usize>(&self, items: [u32; L], draw: u32) -> [Lanes<L>; 2] {
        let [u, v] = self.uniforms(items, draw);
        let radius = (u.map(ln) * -2.0).sqrt();
        let (sin, cos) = (v * core::f64::consts::TAU).sin_cos();
        [radius * cos, radius * sin]
    }

    /// One uniform number in (0, 1).
    pub(crate) fn uniform(&self, item: u32) -> f64 {
        self.uniforms([item], 0)[0].0[0]
    }
}

/// Ten rounds on L counters at once.
///
/// Each word of 32 bits is the lower half of 64, as the instruction that multiplies wants it; what is in the upper half
/// does not matter before the end.
#[inline(always)]
fn philox<const L: usize>(words: &mut [[u64; L]; 4], seed: u64) {
    let mut key = [seed & WORD, seed >> 32];
    for _ in 0..ROUNDS {
        for l in 0..L {
            let products = [(words[0][l] & WORD) * MULTIPLIERS[0], (words[2][l] & WORD) * MULTIPLIERS[1]];
            words[0][l] = (products[1] >> 32) ^ words[1][l] ^ key[0];
            words[2][l] = (products[0] >> 32) ^ words[3][l] ^ key[1];
            (words[1][l], words[3][l]) = (products[1], products[0]);
        }
        key = [(key[0] + WEYL[0]) & WORD, (key[1] + WEYL[1]) & WORD];
    }
}

/// 52 bits of two words as the middle of one of 2⁵² equal parts of (0, 1).
#[inline(always)]
fn open_unit<const L: usize>(high: &[u64; L], low: &[u64; L]) -> Lanes<L> {
    let mut out = Lanes([0.0; L]);
    for l in 0..L {
        let bits = (high[l] << 32 | (low[l] & WORD)) >> 12;
        out.0[l] = f64::from_bits(bits | 0x3FF0_0000_0000_0000) - (1.0 - 0.5 * f64::EPSILON);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers that the authors publish with their library Random123 (kat_vectors, philox4x32 10).
    #[test]
    fn philox_gives_the_published_numbers() {
        let cases: [([u32; 4], u64, [u32; 4]); 3] = [
            ([0; 4], 0, [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([u32::MAX; 4], u64::MAX, [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                0x299f_31d0_a409_3822,
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        for (counter, seed, expected) in cases {
            let mut words = counter.map(|word| [u64::from(word)]);
            philox(&mut words, seed);
            assert_eq!(words.map(|[word]| word as u32), expected);
        }
    }

    #[test]
    fn lanes_draw_what_one_alone_draws() {
        let stream = Stream::new(7, 3, Purpose::Process);
        let together = stream.normals([4, 5, 6, 7], 1);
        for l in 0..4 {
            let alone = stream.normals([4 + l as u32], 1);
            assert_eq!([together[0].0[l], together[1].0[l]], [alone[0].0[0], alone[1].0[0]]);
        }
    }

    #[test]
    fn normals_have_the_moments_of_the_normal_density() {
        let stream = Stream::new(1, 0, Purpose::Initialise);
        let count = 50_000;
        let mut sums = [0.0; 5];
        for item in 0..count {
            let [a, b] = stream.normals([item], 0).map(|x| x.0[0]);
            for x in [a, b] {
                for (k, sum) in sums[..4].iter_mut().enumerate() {
                    *sum += x.powi(k as i32 + 1) / (2.0 * f64::from(count));
                }
            }
            sums[4] += a * b / f64::from(count);
        }
        let wide = 5.0 / f64::from(2 * count).sqrt(); // five standard errors of the mean
        for (sum, (expected, factor)) in sums.iter().zip([(0.0, 1.0), (1.0, 1.5), (0.0, 4.0), (3.0, 10.0), (0.0, 1.5)])
        {
            assert!((sum - expected).abs() < wide * factor, "{sums:?}");
        }
    }

    #[test]
    fn steps_purposes_seeds_and_items_have_numbers_of_their_own() {
        let number = |seed, step, purpose, item| Stream::new(seed, step, purpose).uniform(item);
        let all = [
            number(0, 0, Purpose::Initialise, 0),
            number(1, 0, Purpose::Initialise, 0),
            number(0, 1, Purpose::Initialise, 0),
            number(0, 0, Purpose::Process, 0),
            number(0, 0, Purpose::Initialise, 1),
        ];
        for i in 0..all.len() {
            for j in 0..i {
                assert_ne!(all[i], all[j]);
            }
        }
    }
}
