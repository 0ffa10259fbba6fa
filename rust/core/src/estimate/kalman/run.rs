//! Whole recordings through a filter or a smoother, one or many.

use super::filter::ExtendedKalmanFilter;
use super::gaussian::Gaussian;
use super::history::History;
use super::iterated::IteratedSmoother;
use super::monitor::Monitor;
use super::output::{FilterOutput, Keep};
use super::phases::{Phases, WriteReport};
use super::recording::{KalmanRecording, KalmanSample};
use super::smoother::Smoother;
use crate::error::RunError;
use crate::estimate::Status;
use crate::interrupt::Watch;
use crate::parallel;

/// What is made of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Each sample by those up to it: [`ExtendedKalmanFilter::run`].
    Filter,
    /// Each by all: [`Smoother`].
    Smooth,
    /// Each by all, linearised at the estimate itself: [`IteratedSmoother`].
    Iterate,
}

impl<M: Phases> ExtendedKalmanFilter<M> {
    /// Filters a recording, `count` rows; goes on from where it was, so that it may come in pieces.
    ///
    /// # Errors
    /// As [`step`](Self::step), wrong lengths, or a sample after which the estimate is not finite.
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<FilterOutput, RunError> {
        self.model.check(&recording)?;
        self.run_with(recording, keep, None)
    }

    /// Runs each of `recordings` from a fresh start, on all cores.
    pub fn run_all(
        &self,
        recordings: &[KalmanRecording<'_>],
        way: Way,
        keep: Keep,
    ) -> Vec<Result<FilterOutput, RunError>> {
        let jobs: Vec<_> = recordings.iter().map(|&recording| (self, recording)).collect();
        Self::run_each(&jobs, way, keep)
    }

    /// As [`run_all`](Self::run_all), each recording with a filter of its own.
    pub fn run_each(
        jobs: &[(&Self, KalmanRecording<'_>)],
        way: Way,
        keep: Keep,
    ) -> Vec<Result<FilterOutput, RunError>> {
        parallel::map(jobs, |&(filter, recording)| match way {
            Way::Smooth => Smoother::new(filter).run(recording, keep),
            Way::Iterate => IteratedSmoother::new(filter).run(recording, keep),
            Way::Filter => {
                // A fresh start for each, so that the estimate depends on its own recording alone, whichever core it
                // falls to.
                let mut filter = filter.clone();
                filter.reset();
                filter.run(recording, keep)
            }
        })
    }

    /// As [`run`](Self::run), remembering what a smoother needs.
    pub(super) fn run_with(
        &mut self,
        recording: KalmanRecording<'_>,
        keep: Keep,
        mut history: Option<&mut History>,
    ) -> Result<FilterOutput, RunError> {
        let (count, before) = (recording.dt.len(), self.taken);
        let mut out = FilterOutput::zeros(count, &self.model, keep)?;
        let watch = Watch::current();
        // The recursion of Kalman (1960) with the derivatives of the extended filter, sample by sample; each step is a
        // phase of its own, compiled for each instruction set (see `phases`).
        for i in 0..count {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: self.taken });
            }
            // 1. Time update: the belief becomes that before this sample's readings, x⁻ and P⁻.
            let sample = recording.sample(i, &self.model);
            self.advance(&sample)?;
            if let Some(history) = &mut history {
                // The smoother starts from the prior: it undoes readings one by one on the way back.
                history.push_prediction(sample.dt, &self.belief, self.consider.as_ref());
            }
            // Asked for before they are used: afterwards the belief has them in it.
            if keep.innovations {
                self.report_innovations(i, &sample, &mut out);
            }
            // 2. Measurement update, by one reading after the other, and judgement of their innovations.
            self.correct(&sample);
            if let Some(history) = &mut history {
                history.push_update(&self.model, &self.correction, self.consider.as_ref());
                if let Some(Monitor { effect, .. }) = self.monitor.as_ref().filter(|m| m.effect.is_active()) {
                    history.effect.push(i, effect);
                }
            }
            // 3. A likelihood or a mean that is not finite will not become so again: say where, and stop.
            if !self.is_finite(&sample) {
                return Err(RunError::NotFinite { sample: self.taken });
            }
            self.taken += 1;
            // 4. The row of the output. With a history the smoother writes it on the way back.
            if history.is_none() {
                self.report(i, &mut out, keep.covariance);
            }
            out.write_fit(i, &self.correction);
        }
        Status::doubt_start(&mut out.status, before);
        out.findings.extend_from_slice(self.findings());
        Ok(out)
    }

    /// Differences of readings and predictions with their standard deviations, into row `at`.
    fn report_innovations(&mut self, at: usize, sample: &KalmanSample<'_>, out: &mut FilterOutput) {
        self.linearise();
        let m = sample.readings.len();
        let (innovation, std) = (&mut out.innovation[at * m..][..m], &mut out.innovation_std[at * m..][..m]);
        self.correction.compare(&self.model, &self.belief, sample.readings, innovation, std);
    }

    /// The belief into row `i`: links, motors and tool, and the `whole` state where asked for.
    pub(super) fn report(&mut self, i: usize, out: &mut FilterOutput, whole: bool) {
        let Self { model, belief: Gaussian { mean, covariance }, memory, tool, .. } = self;
        memory.clear();
        model.remember(memory);
        // Σ Σᵀ, which tolerances add to P, is summed for the rows that are written and no more.
        let rows = if whole { mean.len() } else { model.reported() };
        let more = self.consider.as_mut().map(|consider| {
            consider.sum_up(rows);
            (&consider.total[..rows * rows], rows)
        });
        let (covariance, stride) = (&covariance.data, covariance.stride);
        M::report_phase(WriteReport { model, memory, mean, covariance, stride, more, tool, i, out, whole });
    }
}
