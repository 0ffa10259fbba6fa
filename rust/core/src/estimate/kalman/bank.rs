//! What a fault that begins now would do to all later innovations of a filter.

use super::consider::Consider;
use super::correction::Correction;
use super::model::Model;
use super::sensitivity::Sensitivity;
use super::single::{SIDE, SingleSignatures, SingleUpdate, Weighed};
use crate::linear;

/// Standard deviations beyond which it is all the same how far off a reading is.
const ENOUGH: f64 = 1e12;

/// Generalised likelihood ratios of a step in each channel (A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control
/// 21, 1976), for onsets that move on from window to window.
///
/// The state takes a fault up, so that it soon shows in other channels than its own: its signature is carried along with
/// the filter, s = H Σ⁻ + e_c with Σ as in the consider filter. Without a fault (Σ s r)²/Σ s² is χ² with one degree. Where
/// innovations stayed correlated before, by a model that is not quite right, their sums vary by more, and that counts.
///
/// Windows that are on at the same time are columns side by side, so that what the filter does is done to all at once. They are in
/// single precision: what the sums are compared with is not known to more digits than that.
#[derive(Clone, Debug)]
pub(super) struct Bank {
    windows: Vec<Window>,
    /// Σ of a unit fault of each channel that began with each window (states × windows × channels, padded).
    columns: Vec<f32>,
    /// How each window weighs each reading (windows × channels).
    readings: Vec<Weighed>,
    /// Scratch of s.
    scratch: Vec<[f32; SIDE]>,
    /// s of each reading over the variance of its noise, in multiples of the filter's, where there are parameters (channels ×
    /// windows × channels, padded).
    weighted: Vec<f64>,
    /// Σ s r and Σ s² of each channel (windows × channels, padded).
    score: Vec<f64>,
    /// The latter: one over the variance with which the window tells the size of the channel's fault.
    information: Vec<f64>,
    /// How many channels there are, and numbers between windows.
    channels: usize,
    stride: usize,
    /// Σ s sₚ of each channel with each parameter: what an error of a parameter would look like.
    parameters: usize,
    /// Those sums, windows × channels × parameters (padded).
    shared: Vec<f64>,
    /// Scratch: Cov[p] times a row of them.
    gain: Vec<f64>,
}

/// Samples in which a fault may have begun with the first.
#[derive(Clone, Debug)]
struct Window {
    /// How many there are in a window, and in the present one so far.
    length: u32,
    age: u32,
    /// Σ r² less its mean over the window, r being residuals that parameters and known faults leave.
    excess: f64,
    /// Variance of the noise of each channel that lasted before the window, in multiples of the filter's; at least 1.
    noise: Vec<f64>,
}

impl Bank {
    /// Of windows of these lengths.
    pub(super) fn new(model: &impl Model, parameters: usize, lengths: &[u32]) -> Self {
        let (channels, windows) = (model.channels(), lengths.len());
        let stride = channels.next_multiple_of(SIDE);
        let parameters = parameters.next_multiple_of(linear::LANES);
        Self {
            windows: lengths
                .iter()
                .map(|&length| Window { length, age: 0, excess: 0.0, noise: vec![1.0; channels] })
                .collect(),
            columns: vec![0.0; model.states().next_multiple_of(linear::LANES) * windows * stride],
            readings: vec![Weighed::default(); windows * channels],
            scratch: vec![[0.0; SIDE]; channels.next_multiple_of(linear::LANES)],
            weighted: vec![0.0; if parameters > 0 { channels * windows * stride } else { 0 }],
            score: vec![0.0; windows * stride],
            information: vec![0.0; windows * stride],
            channels,
            stride,
            parameters,
            shared: vec![0.0; windows * stride * parameters],
            gain: vec![0.0; parameters],
        }
    }

    /// New windows: a fault may begin at their first sample.
    pub(super) fn restart(&mut self) {
        (0..self.windows.len()).for_each(|w| self.restart_window(w));
    }

    fn restart_window(&mut self, w: usize) {
        (self.windows[w].age, self.windows[w].excess) = (0, 0.0);
        let (own, p) = (w * self.stride..(w + 1) * self.stride, self.score.len());
        self.columns.chunks_exact_mut(p).for_each(|row| row[own.clone()].fill(0.0));
        self.score[own.clone()].fill(0.0);
        self.information[own.clone()].fill(0.0);
        self.shared[own.start * self.parameters..own.end * self.parameters].fill(0.0);
    }

    /// Whether window `w` is complete.
    pub(super) fn is_over(&self, w: usize) -> bool {
        self.windows[w].age == self.windows[w].length
    }

    /// Samples of window `w` so far.
    pub(super) fn age(&self, w: usize) -> u32 {
        self.windows[w].age
    }

    /// Σ r² less its mean over window `w`.
    pub(super) fn excess(&self, w: usize) -> f64 {
        self.windows[w].excess
    }

    /// What a unit fault of `channel` has done to each state since window `w` began.
    pub(super) fn effect(&self, w: usize, channel: usize) -> impl Iterator<Item = f64> {
        self.columns.chunks_exact(self.score.len()).map(move |row| f64::from(row[w * self.stride + channel]))
    }

    /// Takes a sample, whose update is `single` as well.
    #[inline(always)]
    pub(super) fn update(
        &mut self,
        model: &mut impl Model,
        dt: f64,
        (correction, single): (&Correction, &SingleUpdate),
        news: News<'_>,
        consider: Option<&Consider>,
    ) {
        for w in 0..self.windows.len() {
            if self.is_over(w) {
                self.restart_window(w);
            }
            let Window { age, noise, .. } = &mut self.windows[w];
            if let (0, Some(consider)) = (*age, consider) {
                noise.iter_mut().enumerate().for_each(|(i, noise)| *noise = consider.peak(i));
            }
            *age += 1;
        }
        self.weigh(correction, news);
        let Self { readings, columns, scratch, weighted, score, information, stride, .. } = self;
        let p = score.len();
        model.carry_single(columns, p, dt);
        SingleSignatures { update: single, columns, errors: *stride, readings, scratch, score, information, weighted }
            .take();
        if let Some(consider) = consider {
            let Sensitivity { stride, signatures, .. } = &consider.sensitivity;
            linear::add_outer(1.0, (weighted, p), &signatures[..self.channels * stride], *stride, &mut self.shared);
        }
    }

    /// How each window weighs a sample's readings.
    #[inline(always)]
    fn weigh(&mut self, correction: &Correction, News { known, residuals, runs }: News<'_>) {
        for (window, readings) in self.windows.iter_mut().zip(self.readings.chunks_exact_mut(self.channels)) {
            for (i, (reading, innovation)) in readings.iter_mut().zip(&correction.innovations).enumerate() {
                // A coarse encoder's readings are one as long as they are the same: their error is that of its step.
                let noise = window.noise[i] * runs[i];
                let news = (innovation.value - known[i]).clamp(-ENOUGH, ENOUGH);
                (reading.precision, reading.news) = ((1.0 / noise) as f32, news as f32);
                if innovation.is_used() {
                    window.excess += residuals[i] * residuals[i] / noise - 1.0;
                }
            }
        }
    }

    /// The channel whose fault explains most of those beyond `bound` in window `w`, or that of `only` one: of what the
    /// parameters do not explain, within what they may explain yet.
    #[inline(always)]
    pub(super) fn worst(
        &mut self,
        w: usize,
        consider: Option<&Consider>,
        bound: f64,
        only: Option<usize>,
    ) -> Option<StepEvidence> {
        let (mut worst, q): (Option<StepEvidence>, _) = (None, self.parameters);
        for c in (0..self.channels).filter(|&c| only.is_none_or(|only| only == c)) {
            let at = w * self.stride + c;
            let shared = &self.shared[at * q..][..q];
            let score = self.score[at] - consider.map_or(0.0, |consider| consider.explained(shared));
            let information = self.information[at].max(f64::MIN_POSITIVE);
            // An error of a parameter that looks like the fault makes the ratio smaller: computed only where it could
            // matter.
            if score * score <= bound * information {
                continue;
            }
            let drop = score * score / information;
            if worst.is_some_and(|worst| drop < worst.drop) {
                continue;
            }
            let doubt = consider.map_or(0.0, |consider| consider.doubt(shared, &mut self.gain));
            let ratio = score * score / (information + doubt);
            if ratio > bound {
                let variance = (information + doubt) / (information * information);
                worst = Some(StepEvidence { channel: c, ratio, drop, size: score / information, variance });
            }
        }
        worst
    }
}

/// What there is to know of each channel at a sample beside its innovation.
#[derive(Clone, Copy, Debug)]
pub(super) struct News<'a> {
    /// What known faults add to its innovation, in standard deviations.
    pub(super) known: &'a [f64],
    /// Its residual, less what parameters and known faults explain, in standard deviations.
    pub(super) residuals: &'a [f64],
    /// How often its reading came in a row, of an encoder; else 1.
    pub(super) runs: &'a [f64],
}

/// What a window says of a step in a channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepEvidence {
    pub(super) channel: usize,
    /// Likelihood ratio, parameters being free within their tolerances: χ² with one degree without a step.
    pub(super) ratio: f64,
    /// By how much Σ r² falls with the step.
    pub(super) drop: f64,
    /// Size of the step and the variance of that.
    pub(super) size: f64,
    pub(super) variance: f64,
}
