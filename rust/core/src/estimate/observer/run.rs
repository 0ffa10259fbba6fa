//! The observer over whole recordings.

use super::acceleration_observer::AccelerationObserver;
use super::recording::{ObserverOutput, ObserverRecording, ObserverSample};
use crate::check::expect_length;
use crate::error::RunError;
use crate::interrupt::Watch;
use crate::parallel;

impl AccelerationObserver {
    /// Steps through a recording; goes on from where it was, so that a recording may come in pieces.
    ///
    /// # Errors
    /// As [`step`](Self::step), wrong lengths, or a sample after which the estimate is not finite.
    pub fn run(&mut self, recording: ObserverRecording<'_>) -> Result<ObserverOutput, RunError> {
        let ObserverRecording { count, theta, tau, acceleration } = recording;
        let (n, m) = (self.joints(), self.channels());
        for (what, given, width) in [("theta", theta, n), ("tau", tau, n), ("acceleration", acceleration, m)] {
            expect_length(what, given.len(), count * width)?;
        }
        let mut out = ObserverOutput::with_capacity(count, n, self.has_tool(), !self.q_std().is_empty())?;
        let watch = Watch::current();
        for i in 0..count {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: self.taken() });
            }
            self.take(ObserverSample {
                theta: &theta[i * n..][..n],
                tau: &tau[i * n..][..n],
                acceleration: &acceleration[i * m..][..m],
            })?;
            if !self.is_finite() {
                return Err(RunError::NotFinite { sample: self.taken() - 1 });
            }
            self.append(&mut out);
        }
        Ok(out)
    }

    /// Runs each of `recordings` from a fresh copy of this observer, on all cores.
    pub fn run_all(&self, recordings: &[ObserverRecording<'_>]) -> Vec<Result<ObserverOutput, RunError>> {
        let jobs: Vec<_> = recordings.iter().map(|&recording| (self, recording)).collect();
        Self::run_each(&jobs)
    }

    /// As [`run_all`](Self::run_all), each recording with an observer of its own.
    pub fn run_each(jobs: &[(&Self, ObserverRecording<'_>)]) -> Vec<Result<ObserverOutput, RunError>> {
        parallel::map(jobs, |&(observer, recording)| observer.clone().run(recording))
    }

    /// One row more.
    fn append(&self, out: &mut ObserverOutput) {
        out.q.extend_from_slice(self.q());
        out.dq.extend_from_slice(self.dq());
        out.ddq.extend_from_slice(self.ddq());
        for j in 0..self.joints() {
            let (theta, dtheta) = self.motor(j);
            out.theta.push(theta);
            out.dtheta.push(dtheta);
        }
        if self.has_tool() {
            out.tool.extend_from_slice(&self.tool());
        }
        out.q_std.extend_from_slice(self.q_std());
        if self.has_tool() && !self.q_std().is_empty() {
            out.tool_std.extend_from_slice(&self.tool_std());
        }
        out.status.push(self.status());
    }
}
