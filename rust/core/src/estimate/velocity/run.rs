//! Recordings.

use super::VelocityObserver;
use crate::error::{DesignError, RunError};
use crate::interrupt::Watch;
use crate::memory::room;
use crate::parallel;

/// A recording: `count` samples of positions and torques, row-major.
#[derive(Clone, Copy, Debug)]
pub struct VelocityRecording<'a> {
    /// Number of samples.
    pub count: usize,
    /// Positions, n columns [rad]; NaN where missing.
    pub q: &'a [f64],
    /// Torques, n columns [N m]; NaN where missing.
    pub torque: &'a [f64],
}

/// Estimates of a recording, row-major, one row a sample.
#[derive(Clone, Debug, Default)]
pub struct VelocityOutput {
    /// Positions without wraps (n).
    pub q: Vec<f64>,
    /// Velocities (n).
    pub dq: Vec<f64>,
    /// Accelerations by the model (n).
    pub ddq: Vec<f64>,
    /// Tool centre point (3); empty when the robot has none.
    pub tool: Vec<f64>,
    /// Level of the gain.
    pub level: Vec<u8>,
    /// See [`Status`](crate::estimate::Status).
    pub status: Vec<u8>,
}

impl VelocityOutput {
    fn with_capacity(count: usize, n: usize, tool: bool) -> Result<Self, DesignError> {
        Ok(Self {
            q: room(count, n)?,
            dq: room(count, n)?,
            ddq: room(count, n)?,
            tool: room(if tool { count } else { 0 }, 3)?,
            level: room(count, 1)?,
            status: room(count, 1)?,
        })
    }
}

impl VelocityObserver {
    /// Goes on from the present state with the samples of a recording.
    ///
    /// # Errors
    /// As [`step`](Self::step), and when the estimate is no longer finite; names the sample.
    pub fn run(&mut self, recording: VelocityRecording<'_>) -> Result<VelocityOutput, RunError> {
        let n = self.joints();
        let tool = self.has_tool();
        let mut out = VelocityOutput::with_capacity(recording.count, n, tool)?;
        let watch = Watch::current();
        for (q, torque) in recording.q.chunks_exact(n).zip(recording.torque.chunks_exact(n)) {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: self.samples() });
            }
            self.take(q, torque)?;
            if !self.is_finite() {
                return Err(RunError::NotFinite { sample: self.samples() - 1 });
            }
            self.report(&mut out, tool);
        }
        Ok(out)
    }

    /// Runs each recording from a copy of its observer, on all cores.
    pub fn run_each(jobs: &[(&Self, VelocityRecording<'_>)]) -> Vec<Result<VelocityOutput, RunError>> {
        parallel::map(jobs, |&(observer, recording)| observer.clone().run(recording))
    }

    fn report(&self, out: &mut VelocityOutput, tool: bool) {
        out.q.extend_from_slice(self.q());
        out.dq.extend_from_slice(self.dq());
        out.ddq.extend_from_slice(self.ddq());
        if tool {
            out.tool.extend_from_slice(&self.tool());
        }
        out.level.push(u8::try_from(self.level()).unwrap_or(u8::MAX));
        out.status.push(self.status());
    }
}
