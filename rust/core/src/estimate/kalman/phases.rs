//! What is compiled for each instruction set: the phases of a sample.
//!
//! A phase takes what it works on as one value and is compiled once for each instruction set and model. The filter's loop
//! is then a sequence of calls, chosen at each sample ([`simd::phase`]), and holds no arithmetic of its own.

use super::consider::Consider;
use super::correction::{Correction, Readings};
use super::driven::JerkDriven;
use super::elastic::ElasticModel;
use super::gaussian::{Gaussian, Symmetric};
use super::iterated::MeanBack;
use super::loss::SensorLosses;
use super::model::Model;
use super::monitor::Monitor;
use super::output::{FilterOutput, Tool};
use super::recording::KalmanSample;
use super::smoother::{Retreat, SmoothBack};
use crate::simd::{self, Kernel};

/// A model whose phases are compiled in this crate: what a crate that uses a filter has to compile is then little more
/// than calls.
#[allow(private_interfaces)] // what a phase works on is this crate's own
pub trait Phases: Model {
    #[doc(hidden)]
    fn predict_phase(phase: Predict<'_, '_, Self>);
    #[doc(hidden)]
    fn linearise_phase(phase: Linearise<'_, Self>);
    #[doc(hidden)]
    fn regress_phase(phase: Regress<'_, Self>);
    #[doc(hidden)]
    fn update_phase(phase: Update<'_, Self>);
    #[doc(hidden)]
    fn weigh_phase(phase: WeighReadings<'_, Self>);
    #[doc(hidden)]
    fn judge_phase(phase: Judge<'_, '_, Self>);
    #[doc(hidden)]
    fn report_phase(phase: WriteReport<'_, Self>);
    #[doc(hidden)]
    fn back_phase(phase: SmoothBack<'_, Self>);
    #[doc(hidden)]
    fn mean_phase(phase: MeanBack<'_, Self>);
    #[doc(hidden)]
    fn retreat_phase(phase: Retreat<'_, Self>);
}

/// One text for all models; a provided method would be compiled where it is called.
macro_rules! phases {
    ($($model:ty),*) => {$(
        #[allow(private_interfaces)]
        impl Phases for $model {
            fn predict_phase(phase: Predict<'_, '_, Self>) {
                simd::phase(phase);
            }

            fn linearise_phase(phase: Linearise<'_, Self>) {
                simd::phase(phase);
            }

            fn regress_phase(phase: Regress<'_, Self>) {
                simd::phase(phase);
            }

            fn update_phase(phase: Update<'_, Self>) {
                simd::phase(phase);
            }

            fn weigh_phase(phase: WeighReadings<'_, Self>) {
                simd::phase(phase);
            }

            fn judge_phase(phase: Judge<'_, '_, Self>) {
                simd::phase(phase);
            }

            fn report_phase(phase: WriteReport<'_, Self>) {
                simd::phase(phase);
            }

            fn back_phase(phase: SmoothBack<'_, Self>) {
                simd::phase(phase);
            }

            fn mean_phase(phase: MeanBack<'_, Self>) {
                simd::phase(phase);
            }

            fn retreat_phase(phase: Retreat<'_, Self>) {
                simd::phase(phase);
            }
        }
    )*};
}

phases!(JerkDriven, ElasticModel);

/// To the sample's time.
pub(crate) struct Predict<'a, 'b, M> {
    pub(crate) model: &'a mut M,
    pub(crate) sample: &'a KalmanSample<'b>,
    pub(crate) belief: &'a mut Gaussian,
}

impl<M: Model> Kernel for Predict<'_, '_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.model.predict(self.sample, self.belief);
    }
}

/// All channels at `reference`.
pub(crate) struct Linearise<'a, M> {
    pub(crate) model: &'a mut M,
    pub(crate) reference: &'a [f64],
}

impl<M: Model> Kernel for Linearise<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.model.linearise(self.reference);
    }
}

/// The same by sigma points of a belief whose leading states have the mean `reference`.
pub(super) struct Regress<'a, M> {
    pub(super) model: &'a mut M,
    pub(super) reference: &'a [f64],
    pub(super) covariance: &'a Symmetric,
}

impl<M: Model> Kernel for Regress<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.model.regress(self.reference, self.covariance);
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

/// How much the readings of the channels that were linearised count.
pub(super) struct WeighReadings<'a, M> {
    pub(super) model: &'a M,
    pub(super) correction: &'a mut Correction,
    pub(super) belief: &'a Gaussian,
    pub(super) readings: Readings<'a>,
    pub(super) sensors: &'a SensorLosses,
}

impl<M: Model> Kernel for WeighReadings<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.correction.weigh(self.model, self.belief, self.readings, self.sensors);
    }
}

/// What the update says of parameters and of channels.
pub(crate) struct Judge<'a, 'b, M> {
    pub(super) model: &'a mut M,
    pub(super) belief: &'a Gaussian,
    pub(super) correction: &'a mut Correction,
    pub(super) consider: Option<&'a mut Consider>,
    pub(super) monitor: Option<&'a mut Monitor>,
    pub(super) sample: &'a KalmanSample<'b>,
}

impl<M: Model> Kernel for Judge<'_, '_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, belief, correction, mut consider, monitor, sample } = self;
        if let Some(consider) = &mut consider {
            consider.update(model, correction);
            correction.nis = consider.nis();
        }
        if let Some(monitor) = monitor {
            correction.status |= monitor.judge(model, belief, sample, correction, consider);
        }
    }
}

/// Row `i` of the output, with the whole state where asked for.
pub(super) struct WriteReport<'a, M> {
    pub(super) model: &'a mut M,
    pub(super) memory: &'a [f64],
    pub(super) mean: &'a [f64],
    /// Rows of `stride` numbers.
    pub(super) covariance: &'a [f64],
    pub(super) stride: usize,
    /// What parameters add to the covariance of the first states, and of how many.
    pub(super) more: Option<(&'a [f64], usize)>,
    pub(super) tool: &'a mut Tool,
    pub(super) i: usize,
    pub(super) out: &'a mut FilterOutput,
    pub(super) whole: bool,
}

impl<M: Model> Kernel for WriteReport<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, memory, mean, covariance, stride, more, tool, i, out, whole } = self;
        model.report(memory, mean, i, out);
        let total = |r: usize, c: usize| covariance[r * stride + c] + more.map_or(0.0, |(more, n)| more[r * n + c]);
        out.write_links(i, model.robot(), mean, total, tool);
        if let Some(first) = model.link_disturbance() {
            out.write_disturbances(i, (first, model.robot().len()), mean, total);
        }
        if let Some(first) = model.wrench() {
            out.write_wrenches(i, (first, model.robot().wrench_states()), mean, total);
        }
        if whole {
            out.write_state(i, mean, covariance, stride);
            if let Some((more, _)) = more {
                out.add_covariance(i, more);
            }
        }
    }
}
