//! What a fault that begins now would do to all later innovations of a filter.

use super::consider::Consider;
use super::correction::Correction;
use super::model::Model;
use super::sensitivity::Sensitivity;
use crate::linear;

/// Generalised likelihood ratios of a step in each channel (A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control
/// 21, 1976), for an onset that moves on from window to window.
///
/// The state takes a fault up, so that it soon shows in other channels than its own: its signature is carried along with
/// the filter, s = H Σ⁻ + e_c with Σ as in the consider filter. Without a fault (Σ s r)²/Σ s² is χ² with one degree. Where
/// innovations stayed correlated before, by a model that is not quite right, their sums vary by more, and that counts.
#[derive(Clone, Debug)]
pub(super) struct Bank {
    /// Samples of a window.
    length: u32,
    /// Samples of the present window so far.
    pub(super) age: u32,
    /// Σ r² less its mean over the window, r being residuals that parameters and known faults leave.
    pub(super) excess: f64,
    /// Σ and s of a unit fault of each channel that began with the window.
    pub(super) sensitivity: Sensitivity,
    /// s of each reading over the variance of its noise.
    weighted: Vec<f64>,
    /// Σ s r and Σ s² of each channel.
    score: Vec<f64>,
    /// Σ s² of each channel: one over the variance with which the window tells the size of its fault.
    information: Vec<f64>,
    /// How many there are.
    channels: usize,
    /// Σ s sₚ of each channel with each parameter: what an error of a parameter would look like.
    parameters: usize,
    /// Those sums, channels × parameters (padded).
    shared: Vec<f64>,
    /// Scratch: Cov[p] times a row of them.
    gain: Vec<f64>,
    /// Variance of the noise of each channel that lasted before the window, in multiples of the filter's; at least 1.
    noise: Vec<f64>,
}

impl Bank {
    pub(super) fn new(model: &impl Model, parameters: usize, length: u32) -> Self {
        let sensitivity = Sensitivity::new(model, model.channels());
        let (stride, parameters) = (sensitivity.stride, parameters.next_multiple_of(linear::LANES));
        Self {
            length,
            age: 0,
            excess: 0.0,
            weighted: vec![0.0; sensitivity.signatures.len()],
            sensitivity,
            score: vec![0.0; stride],
            information: vec![0.0; stride],
            channels: model.channels(),
            parameters,
            shared: vec![0.0; stride * parameters],
            gain: vec![0.0; parameters],
            noise: vec![1.0; model.channels()],
        }
    }

    /// A new window: a fault may begin at its first sample.
    pub(super) fn restart(&mut self) {
        (self.age, self.excess) = (0, 0.0);
        self.sensitivity.columns.fill(0.0);
        self.score.fill(0.0);
        self.information.fill(0.0);
        self.shared.fill(0.0);
    }

    /// Whether the window is complete.
    pub(super) fn is_over(&self) -> bool {
        self.age == self.length
    }

    /// Takes a sample.
    #[inline(always)]
    pub(super) fn update(
        &mut self,
        model: &mut impl Model,
        dt: f64,
        correction: &Correction,
        News { known, residuals, runs }: News<'_>,
        consider: Option<&Consider>,
    ) {
        if self.is_over() {
            self.restart();
        }
        if let (0, Some(consider)) = (self.age, consider) {
            self.noise.iter_mut().enumerate().for_each(|(i, noise)| *noise = consider.peak(i));
        }
        self.age += 1;
        let p = self.sensitivity.stride;
        model.carry_noise_free(&mut self.sensitivity.columns, p, dt);
        // A fault is in its own reading, and by way of the state in those of all others.
        self.sensitivity.signatures.fill(0.0);
        (0..self.channels).for_each(|c| self.sensitivity.signatures[c * p + c] = 1.0);
        self.sensitivity.update(model, correction);
        let rows = self.sensitivity.signatures.chunks_exact(p).zip(self.weighted.chunks_exact_mut(p));
        for (i, ((signature, weighted), innovation)) in rows.zip(&correction.innovations).enumerate() {
            // A coarse encoder's readings are one as long as they are the same: their error is that of its step.
            let noise = self.noise[i] * runs[i];
            let precision = 1.0 / (innovation.variance * noise);
            for ((weighted, information), s) in weighted.iter_mut().zip(&mut self.information).zip(signature) {
                *weighted = s * precision;
                *information += *weighted * s;
            }
            if innovation.variance.is_finite() {
                linear::add_scaled(&mut self.score, innovation.value - known[i], weighted);
                self.excess += residuals[i] * residuals[i] / noise - 1.0;
            }
        }
        if let Some(consider) = consider {
            let Sensitivity { stride, signatures, .. } = &consider.sensitivity;
            linear::add_outer(1.0, (&self.weighted, p), signatures, *stride, &mut self.shared);
        }
    }

    /// The channel whose fault explains most of those beyond `bound`, or that of `only` one: of what the parameters do not
    /// explain, within what they may explain yet.
    #[inline(always)]
    pub(super) fn worst(
        &mut self,
        consider: Option<&Consider>,
        bound: f64,
        only: Option<usize>,
    ) -> Option<StepEvidence> {
        let (mut worst, q): (Option<StepEvidence>, _) = (None, self.parameters);
        for c in (0..self.channels).filter(|&c| only.is_none_or(|only| only == c)) {
            let shared = &self.shared[c * q..][..q];
            let score = self.score[c] - consider.map_or(0.0, |consider| consider.explained(shared));
            let information = self.information[c].max(f64::MIN_POSITIVE);
            // An error of a parameter that looks like the fault makes the ratio smaller: computed only where it could
            // matter.
            let drop = score * score / information;
            if drop <= bound || worst.is_some_and(|worst| drop < worst.drop) {
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
    /// What known faults add to its innovation.
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
