//! Whole recordings, one or many.

use super::filter::ParticleFilter;
use super::output::ParticleOutput;
use crate::error::RunError;
use crate::estimate::Status;
use crate::estimate::kalman::{KalmanRecording, Keep, Model};
use crate::interrupt::Watch;
use crate::parallel;

impl ParticleFilter {
    /// Filters a recording, `count` rows; goes on from where it was, so that it may come in pieces.
    ///
    /// # Errors
    /// As [`step`](Self::step), wrong lengths, or a sample after which the estimate is not finite.
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<ParticleOutput, RunError> {
        self.run_with(recording, keep, |_| {})
    }

    /// [`run`](Self::run), calling `after` at each sample.
    pub(super) fn run_with(
        &mut self,
        recording: KalmanRecording<'_>,
        keep: Keep,
        mut after: impl FnMut(&mut Self),
    ) -> Result<ParticleOutput, RunError> {
        self.model.check(&recording)?;
        let (count, before) = (recording.dt.len(), self.taken);
        let mut out = ParticleOutput::zeros(count, self, keep)?;
        let watch = Watch::current();
        for i in 0..count {
            // Resample, move, weigh, judge: see `take`.
            let done = self.take(recording.sample(i, &self.model));
            // Blocks are left out once it is to stop, and then the sample is not a whole one.
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            done?;
            if !self.is_finite() {
                return Err(RunError::NotFinite { sample: self.taken - 1 });
            }
            out.report(i, self, keep);
            after(self);
        }
        Status::doubt_start(&mut out.links.status, before);
        out.links.findings.extend_from_slice(self.guard.kalman.findings());
        Ok(out)
    }

    /// Runs each recording from a fresh start with the settings of its filter, on all cores.
    pub fn run_each(jobs: &[(&Self, KalmanRecording<'_>)], keep: Keep) -> Vec<Result<ParticleOutput, RunError>> {
        Self::each(jobs, |filter, recording| filter.run(recording, keep))
    }

    /// `one` with a new filter for each recording, on all cores.
    pub(super) fn each(
        jobs: &[(&Self, KalmanRecording<'_>)],
        one: impl Fn(&mut Self, KalmanRecording<'_>) -> Result<ParticleOutput, RunError> + Sync,
    ) -> Vec<Result<ParticleOutput, RunError>> {
        parallel::map(jobs, |&(like, recording)| {
            // New, not cloned: a cloud is large, and this one's particles are none of the recording's business.
            let model = like.guard.kalman.model().clone();
            let mut filter = Self::new(model, like.settings.clone(), like.marginalised)?;
            filter.set_start(like.start.clone())?;
            one(&mut filter, recording)
        })
    }
}
