//! What is compiled for each instruction set: the phases of a sample.

use super::correction::Correction;
use super::gaussian::Gaussian;
use super::model::Model;
use super::output::{FilterOutput, Tool};
use super::recording::KalmanSample;
use crate::simd::Kernel;

/// To the sample's time.
pub(super) struct Predict<'a, 'b, M> {
    pub(super) model: &'a mut M,
    pub(super) sample: &'a KalmanSample<'b>,
    pub(super) belief: &'a mut Gaussian,
}

impl<M: Model> Kernel for Predict<'_, '_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.model.predict(self.sample, self.belief);
    }
}

/// All channels at `reference`.
pub(super) struct Linearise<'a, M> {
    pub(super) model: &'a mut M,
    pub(super) reference: &'a [f64],
}

impl<M: Model> Kernel for Linearise<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.model.linearise(self.reference);
    }
}

/// By the readings of the channels that were linearised.
pub(super) struct Update<'a, M> {
    pub(super) model: &'a M,
    pub(super) correction: &'a mut Correction,
    pub(super) belief: &'a mut Gaussian,
    pub(super) readings: &'a [f64],
    pub(super) gate: Option<f64>,
}

impl<M: Model> Kernel for Update<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.correction.update(self.model, self.belief, self.readings, self.gate);
    }
}

/// Row `i` of the output, with the whole state where asked for.
pub(super) struct Report<'a, M> {
    pub(super) model: &'a mut M,
    pub(super) memory: &'a [f64],
    pub(super) mean: &'a [f64],
    /// Rows of `stride` numbers.
    pub(super) covariance: &'a [f64],
    pub(super) stride: usize,
    pub(super) tool: &'a mut Tool,
    pub(super) i: usize,
    pub(super) out: &'a mut FilterOutput,
    pub(super) whole: bool,
}

impl<M: Model> Kernel for Report<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, memory, mean, covariance, stride, tool, i, out, whole } = self;
        model.report(memory, mean, i, out);
        out.write_links(i, model.robot(), mean, |r, c| covariance[r * stride + c], tool);
        if whole {
            out.write_state(i, mean, covariance, stride);
        }
    }
}
