//! Lasting errors through a measurement update in single precision, eight side by side.
//!
//! What the judge carries along is held against bounds: seven digits are enough, at half the work of fifteen. The estimate has
//! none of it.

use super::correction::Correction;
use super::model::Model;
use crate::linear::LANES;
use crate::simd::{self, Kernel};

/// Errors side by side.
pub(super) const SIDE: usize = 8;

/// A row of them.
type Row = [f32; SIDE];

/// One of each channel, in its own place, and none.
const OWN: [Row; SIDE + 1] = {
    let mut own = [[0.0; SIDE]; SIDE + 1];
    let mut i = 0;
    while i < SIDE {
        own[i][i] = 1.0;
        i += 1;
    }
    own
};

/// A measurement update: what [`Correction`] leaves, by blocks of four channels or states, padded with zeros.
#[derive(Clone, Debug)]
pub(super) struct SingleUpdate {
    /// Hᵀ (blocks × dense).
    jacobian: Vec<[f32; LANES]>,
    dense: usize,
    /// U (blocks × channels), and one over its diagonal, 0 of channels that were not used (blocks).
    upper: Vec<[f32; LANES]>,
    inverse: Vec<[f32; LANES]>,
    /// W (blocks of states × channels).
    gains: Vec<[f32; LANES]>,
    /// The state that is each channel's bias (channels).
    biases: Vec<Option<usize>>,
}

impl SingleUpdate {
    pub(super) fn new(model: &impl Model) -> Self {
        let (m, d) = (model.channels().next_multiple_of(LANES), model.dense());
        let blocks = |rows: usize, of: usize| vec![[0.0; LANES]; rows.div_ceil(LANES) * of];
        Self {
            jacobian: blocks(m, d),
            dense: d,
            upper: blocks(m, m),
            inverse: blocks(m, 1),
            gains: blocks(model.states(), m),
            biases: vec![None; m],
        }
    }

    /// Takes over an update that was done.
    #[inline(always)]
    pub(super) fn take(&mut self, model: &impl Model, correction: &Correction) {
        let (m, d) = (self.biases.len(), self.dense);
        for (i, (row, bias)) in model.linearised().jacobian.chunks_exact(d).zip(model.biases()).enumerate() {
            for (to, h) in self.jacobian[i / LANES * d..][..d].iter_mut().zip(row) {
                to[i % LANES] = *h as f32;
            }
            self.biases[i] = *bias;
        }
        narrow((correction.factor(), correction.width()), &mut self.upper, m);
        narrow((correction.rows(), LANES * self.gains.len() / m), &mut self.gains, m);
        for (i, innovation) in correction.innovations.iter().enumerate() {
            self.inverse[i / LANES][i % LANES] = (1.0 / innovation.std) as f32;
        }
    }
}

/// Rows of `width` numbers, transposed by blocks of columns, of `m` rows each.
#[inline(always)]
fn narrow((rows, width): (&[f64], usize), to: &mut [[f32; LANES]], m: usize) {
    for (b, block) in to.chunks_exact_mut(m).enumerate() {
        for (to, row) in block.iter_mut().zip(rows.chunks_exact(width)) {
            *to = row.as_chunks::<LANES>().0[b].map(|x| x as f32);
        }
    }
}

/// How a window weighs a reading.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Weighed {
    /// One over the variance of its noise, in multiples of the filter's.
    pub(super) precision: f32,
    /// Its innovation less what known faults add, in standard deviations.
    pub(super) news: f32,
}

/// Unit errors of readings through an update, with what the readings say of their size; several windows side by side.
///
/// Σ ← (1 − K H) Σ − K N and s = U⁻ᵀ (H Σ + N), N being a one in the own reading of each error.
pub(super) struct SingleSignatures<'a> {
    pub(super) update: &'a SingleUpdate,
    /// Σ (states, padded, × windows × errors of a window).
    pub(super) columns: &'a mut [f32],
    /// Errors of a window, padded to [`SIDE`].
    pub(super) errors: usize,
    /// Of each window (windows × channels).
    pub(super) readings: &'a [Weighed],
    /// Scratch: s of one [`SIDE`] (channels, padded).
    pub(super) scratch: &'a mut [Row],
    /// Σ s r and Σ s², over the variances of the noise, to which this update's are added (windows × errors).
    pub(super) score: &'a mut [f64],
    pub(super) information: &'a mut [f64],
    /// s over the variances of the noise (channels × windows × errors); empty where not wanted.
    pub(super) weighted: &'a mut [f64],
}

impl SingleSignatures<'_> {
    pub(super) fn take(self) {
        simd::phase(self);
    }

    /// How many eights there are, and channels.
    #[inline(always)]
    fn sizes(&self) -> (usize, usize) {
        (self.score.len() / SIDE, self.readings.len() * self.errors / self.score.len())
    }

    /// s of those from the `t`-th eight on, the first of which is of channel `first`.
    #[inline(always)]
    fn sign(&mut self, t: usize, first: usize) {
        let SingleUpdate { jacobian, dense, upper, inverse, biases, .. } = self.update;
        let (m, columns) = (biases.len(), self.columns.as_chunks::<SIDE>().0);
        let (tiles, _) = self.sizes();
        for (b, (jacobian, upper)) in jacobian.chunks_exact(*dense).zip(upper.chunks_exact(m)).enumerate() {
            let (above, own) = self.scratch.split_at_mut(b * LANES);
            let mut sums = [[0.0; SIDE]; LANES];
            for (h, row) in jacobian.iter().zip(columns.chunks_exact(tiles)) {
                accumulate(&mut sums, h, &row[t]);
            }
            for (u, row) in upper.iter().zip(above) {
                accumulate(&mut sums, &u.map(|u| -u), row);
            }
            for l in 0..LANES {
                let i = b * LANES + l;
                let unit = &OWN[i.wrapping_sub(first).min(SIDE)];
                let bias = biases[i].map_or(&OWN[SIDE], |bias| &columns[bias * tiles + t]);
                let mut s: Row = core::array::from_fn(|e| sums[l][e] + (bias[e] + unit[e]));
                for (k, row) in sums.iter().enumerate().take(l) {
                    let u = upper[b * LANES + k][l];
                    s = core::array::from_fn(|e| s[e] - u * row[e]);
                }
                sums[l] = s.map(|s| s * inverse[b][l]);
            }
            own[..LANES].copy_from_slice(&sums);
        }
    }

    /// What the readings of window `w` say of these.
    #[inline(always)]
    fn weigh(&mut self, t: usize, w: usize) {
        let (mut score, mut information) = ([0.0; SIDE], [0.0; SIDE]);
        let (tiles, channels) = self.sizes();
        let readings = &self.readings[w * channels..][..channels];
        for (i, (s, reading)) in self.scratch.iter().zip(readings).enumerate() {
            let weighted = s.map(|s| s * reading.precision);
            for e in 0..SIDE {
                score[e] += reading.news * weighted[e];
                information[e] += weighted[e] * s[e];
            }
            if let Some(out) = self.weighted.as_chunks_mut::<SIDE>().0.get_mut(i * tiles + t) {
                *out = weighted.map(f64::from);
            }
        }
        for (sums, new) in [(&mut *self.score, score), (&mut *self.information, information)] {
            let sums = &mut sums.as_chunks_mut::<SIDE>().0[t];
            *sums = core::array::from_fn(|e| sums[e] + f64::from(new[e]));
        }
    }

    /// Σ ← Σ − Wᵀ s.
    #[inline(always)]
    fn correct(&mut self, t: usize) {
        let (tiles, channels) = self.sizes();
        let rows = self.columns.as_chunks_mut::<SIDE>().0.chunks_exact_mut(LANES * tiles);
        for (rows, gains) in rows.zip(self.update.gains.chunks_exact(self.update.biases.len())) {
            let mut sums = [[0.0; SIDE]; LANES];
            for (gain, row) in gains.iter().zip(&self.scratch[..channels]) {
                accumulate(&mut sums, gain, row);
            }
            for (row, sum) in rows.chunks_exact_mut(tiles).zip(sums) {
                row[t] = core::array::from_fn(|e| row[t][e] - sum[e]);
            }
        }
    }
}

impl Kernel for SingleSignatures<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        for t in 0..self.score.len() / SIDE {
            let (window, first) = (t * SIDE / self.errors, t * SIDE % self.errors);
            self.sign(t, first);
            self.weigh(t, window);
            self.correct(t);
        }
    }
}

/// `sums[l] += factors[l] · row`.
#[inline(always)]
fn accumulate(sums: &mut [Row; LANES], factors: &[f32; LANES], row: &Row) {
    for l in 0..LANES {
        for e in 0..SIDE {
            sums[l][e] += factors[l] * row[e];
        }
    }
}
