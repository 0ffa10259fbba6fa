//! The iterated smoother: the trajectory of largest posterior density.
//!
//! It minimises, over all states of a recording at once,
//!
//! ½ ‖x₀ − x̄₀‖²_P₀⁻¹ + Σ ½ ‖xₖ − f(xₖ₋₁)‖²_Q⁻¹ + Σ ρ(‖yₖ − h(xₖ)‖_R⁻¹)
//!
//! with a [`NoiseLoss`] ρ of each sensor. A step of Gauss and Newton is the linear smoother of the model linearised at the last
//! trajectory (B. M. Bell, SIAM J. Optimization 4, 1994), so that time and memory grow as the recording does; a loss that is
//! not a square divides R by a weight (A. Y. Aravkin et al. 2014). A step that does not lower the sum is halved until it does.

use super::filter::ExtendedKalmanFilter;
use super::history::History;
use super::loss::SensorLosses;
use super::misfit::Misfit;
use super::output::{FilterOutput, Keep};
use super::path::StatePath;
use super::phases::Phases;
use super::recording::KalmanRecording;
use super::smoother::Smoother;
use crate::error::RunError;
use crate::estimate::Status;
use crate::interrupt::Watch;
use crate::linear;
use crate::memory::filled;
use crate::simd::Kernel;
use std::sync::Arc;

/// Most steps of Gauss and Newton, with each loss.
const MOST: usize = 50;
/// Most halvings of a step.
const HALVINGS: i32 = 12;
/// A step that lowers the sum by less is the last. Near a minimum the sum falls by half the step's square, in standard deviations
/// of whatever it changes: by this, 0.0014 of them. Reweighting converges slowly, and what is left may be some times as much.
const SMALL: f64 = 1e-6;
/// A row that another step would move by more than this many standard deviations of a link has not converged.
const MOVING: f64 = 0.2;

/// Smoother that is linearised at its own estimate, whatever the start, with robust losses.
///
/// Where a filter or a [`Smoother`] linearises each sample at what was known before it, this one does so at what is known after
/// all. On a linear model with squares for losses it is the smoother.
#[derive(Clone, Debug)]
pub struct IteratedSmoother<M> {
    /// The filter as it is before a recording.
    filter: ExtendedKalmanFilter<M>,
}

impl<M: Phases> IteratedSmoother<M> {
    /// A smoother on `filter`'s model, noise, losses and settings; it starts from rest at a recording's first sample, and goes by
    /// derivatives whatever the filter goes by.
    pub fn new(filter: &ExtendedKalmanFilter<M>) -> Self {
        let mut filter = filter.clone();
        filter.set_points(None);
        filter.reset();
        Self { filter }
    }

    /// Smooths a recording: the estimate at each sample by all samples. Rows that have not converged must not be used,
    /// and say so by their status.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::run`].
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<FilterOutput, RunError> {
        self.filter.model.check(&recording)?;
        if recording.dt.is_empty() {
            return Smoother::new(&self.filter).run(recording, keep);
        }
        // Nobody asks the passes how well they fit, nor what tolerances add to a covariance that is not looked at.
        let mut plain = self.filter.without_tolerances();
        plain.watch(false);
        plain.sensors = SensorLosses::of_squares(&plain.model);
        let mut path = self.start(&plain, recording)?;
        // A loss that is not convex has many minima: from that of Huber's, which has one, it is the right one's more often.
        for sensors in self.filter.sensors.convex().iter().chain([&self.filter.sensors]) {
            path = Descent { plain: &plain, sensors, recording }.minimise(path)?;
        }
        // Once more with all that belongs to an estimate, linearised at the minimum.
        let path = Arc::new(path);
        let mut last = Smoother::new(&self.filter);
        last.filter.set_path(Some(Arc::clone(&path)));
        let mut out = last.run(recording, keep)?;
        out.flag_moved(&path);
        Ok(out)
    }

    /// The plain smoother's trajectory, all readings counting fully.
    fn start(&self, plain: &ExtendedKalmanFilter<M>, recording: KalmanRecording<'_>) -> Result<StatePath, RunError> {
        let (states, channels) = (self.filter.model.states(), self.filter.model.channels());
        let weights = filled(1.0, recording.dt.len(), channels)?;
        Ok(StatePath { states, channels, means: Smoother::new(plain).means(recording)?, weights })
    }
}

/// One minimisation.
struct Descent<'a, 'b, M> {
    plain: &'a ExtendedKalmanFilter<M>,
    sensors: &'a SensorLosses,
    recording: KalmanRecording<'b>,
}

impl<M: Phases> Descent<'_, '_, M> {
    /// The minimum near `path`, with the weights there.
    fn minimise(&self, mut path: StatePath) -> Result<StatePath, RunError> {
        let mut misfit = Misfit::new(self.plain, self.sensors, self.recording)?;
        for _ in 0..MOST {
            // 1. How well the path fits: the sum to beat, and weights and variances that hold until it is beaten.
            let now = misfit.weigh(&mut path)?;
            let path_now = Arc::new(path);
            // 2. The minimum of the sum linearised and reweighted there.
            let mut smoother = Smoother::new(self.plain);
            smoother.filter.set_path(Some(Arc::clone(&path_now)));
            let aim = smoother.means(self.recording)?;
            drop(smoother);
            path = Arc::unwrap_or_clone(path_now);
            // 3. As far that way as the sum itself falls.
            let fallen = self.step(&mut misfit, &mut path, &aim, now)?;
            if fallen < SMALL {
                break;
            }
        }
        misfit.weigh(&mut path)?;
        Ok(path)
    }

    /// Moves the path to `aim`, or a part of the way; gives by how much the sum fell from `now`.
    fn step(&self, misfit: &mut Misfit<'_, M>, path: &mut StatePath, aim: &[f64], now: f64) -> Result<f64, RunError> {
        let mut trial = path.means.clone();
        for halving in 0..HALVINGS {
            let part = 0.5_f64.powi(halving);
            for ((trial, from), to) in trial.iter_mut().zip(&path.means).zip(aim) {
                *trial = if halving == 0 { *to } else { from + part * (to - from) };
            }
            let fallen = now - misfit.sum(&trial)?;
            // What rounding makes of a minimum's neighbourhood is no rise.
            if fallen > -SMALL {
                path.means = trial;
                return Ok(fallen);
            }
        }
        Ok(0.0)
    }
}

/// Past sample `i`'s readings, the smoothed mean there, and on to the sample before.
pub(super) struct MeanBack<'a, M> {
    smoother: &'a mut Smoother<M>,
    history: &'a History,
    i: usize,
    out: &'a mut [f64],
}

impl<M: Phases> Kernel for MeanBack<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { smoother, history, i, out } = self;
        let states = out.len();
        smoother.load_rows(history, i);
        smoother.pull(history, i);
        // x̂ = x⁻ − P⁻ λ.
        for (r, row) in history.covariance(i).chunks_exact(smoother.lambda.len()).enumerate() {
            out[r] = history.means[i * states + r] - linear::dot(row, &smoother.lambda);
        }
        smoother.filter.model.carry_back(history.memory(i), &mut smoother.lambda[..states], 1, history.dt[i]);
    }
}

impl<M: Phases> Smoother<M> {
    /// The smoothed means alone (samples × states), at little more than the filter's cost.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::run`].
    pub(super) fn means(&mut self, recording: KalmanRecording<'_>) -> Result<Vec<f64>, RunError> {
        let states = self.filter.model.states();
        let mut means = filled(0.0, recording.dt.len(), states)?;
        let starts = self.starts(recording)?;
        self.finish();
        let watch = Watch::current();
        for (start, rows) in starts.into_iter().rev() {
            let mut filter = start;
            let own = recording.rows(rows.clone(), &filter.model);
            let mut history = History::with_capacity(rows.len(), &filter.model, self.lambda.len())?;
            filter.run_with(own, Keep::default(), Some(&mut history))?;
            for i in (0..rows.len()).rev() {
                if watch.stops() {
                    return Err(RunError::Interrupted { sample: rows.start + i });
                }
                let out = &mut means[(rows.start + i) * states..][..states];
                M::mean_phase(MeanBack { smoother: &mut *self, history: &history, i, out });
            }
        }
        Ok(means)
    }
}

impl FilterOutput {
    /// Flags the rows that have not converged: one step more has moved a link by more than is not known of it.
    fn flag_moved(&mut self, path: &StatePath) {
        let n = self.q.len() / self.status.len();
        for (i, status) in self.status.iter_mut().enumerate() {
            let now = path.state(i);
            if (0..n).any(|j| (self.q[i * n + j] - now[j]).abs() > MOVING * self.q_std[i * n + j]) {
                *status |= Status::CONTRADICTED;
            }
        }
    }
}
