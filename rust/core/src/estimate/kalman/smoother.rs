//! The smoother: what later readings say of earlier states.
//!
//! The mean is Bierman's (1973) form of the Rauch–Tung–Striebel smoother, on the filter's own scalar updates: an adjoint
//! state λ runs backwards through the same rows and gains, and the smoothed state is x⁻ − P⁻λ. The covariance is that of
//! Fraser and Potter's (1969) two filters, (P⁻¹ + Λ)⁻¹ with the [`Information`] Λ of this and later readings: the adjoint's own,
//! P⁻ − P⁻Λ̂P⁻, is the difference of two numbers that agree in all digits after a long time without readings.

use super::consider_back::ConsiderBack;
use super::dependence::DependenceHistory;
use super::effect::EffectBack;
use super::filter::ExtendedKalmanFilter;
use super::gaussian::Innovation;
use super::history::History;
use super::information::Information;
use super::output::{FilterOutput, Keep};
use super::phases::{Phases, WriteReport};
use super::recording::KalmanRecording;
use crate::error::RunError;
use crate::estimate::Status;
use crate::interrupt::Watch;
use crate::linear;
use crate::simd::Kernel;
use core::ops::Range;

/// Fixed-interval smoother over whole recordings.
///
/// The filter's history is kept for one stretch of the recording at a time: a first pass leaves a belief at the start
/// of each, and each is filtered again on the way back. Memory is bounded by the stretch, whatever the recording's length.
///
/// ```
/// use linkside_core::estimate::kalman::{
///     ExtendedKalmanFilter, FilterSettings, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanRecording, Keep, Smoother,
/// };
/// use linkside_core::estimate::measurement::Kind;
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let model = JerkModel::new(robot, &[Kind::Motor], &[false])?;
/// # let noise = JerkNoise {
/// #     jerk: vec![100.0], link_walk: vec![0.0; 2], reading: vec![1e-5], torsion: 1e-3, bias_walk: vec![0.0],
/// #     bias_time: vec![f64::INFINITY], initial: vec![1e-4, 1e-3, 0.1], initial_bias: vec![0.0],
/// # };
/// let settings = FilterSettings { gate: None, iterations: 1 };
/// let mut filter = ExtendedKalmanFilter::new(JerkDriven::new(model, noise, false)?, settings)?;
///
/// let theta: Vec<f64> = (0..200).map(|i| 0.1 * (0.01 * f64::from(i)).sin()).collect();
/// let (zero, nan) = (vec![0.0; 200], vec![f64::NAN; 200]);
/// let inputs = Inputs { jerk: &zero, dtheta: &nan, ..Inputs::default() };
/// let recording = KalmanRecording { dt: &[1e-3; 200], readings: &theta, inputs };
/// let smoothed = Smoother::new(&filter).run(recording, Keep::default())?;
/// let filtered = filter.run(recording, Keep::default())?;
///
/// // Later readings narrow every estimate but the last, after which there is none.
/// assert!(smoothed.q_std[100] < filtered.q_std[100]);
/// assert!((smoothed.q[199] - filtered.q[199]).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Smoother<M> {
    /// The filter as it is before a recording: model, noise and settings.
    pub(super) filter: ExtendedKalmanFilter<M>,
    /// λ, the adjoint state (padded).
    pub(super) lambda: Vec<f64>,
    /// Λ, what this and later readings say of the state.
    information: Information,
    /// One padded row for each reading: h, and h/√r.
    rows: Vec<f64>,
    whitened: Vec<f64>,
    /// x̂ (states).
    mean: Vec<f64>,
    /// P̂, of q or of the whole state (states × stride).
    smoothed: Vec<f64>,
    /// The way back of the sensitivities to parameters.
    consider: Option<ConsiderBack>,
    /// That of the faults.
    effect: EffectBack,
}

/// Past sample `i`'s readings, and the smoothed estimate there.
pub(super) struct SmoothBack<'a, M> {
    /// With λ and Λ from after the sample's readings.
    smoother: &'a mut Smoother<M>,
    /// Of the stretch that the sample is in.
    history: &'a History,
    i: usize,
    whole: bool,
}

impl<M: Phases> Kernel for SmoothBack<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { smoother, history, i, whole } = self;
        smoother.back(history, i);
        smoother.smooth(history, i, whole);
    }
}

/// From sample `i` to the one before.
pub(super) struct Retreat<'a, M> {
    smoother: &'a mut Smoother<M>,
    history: &'a History,
    i: usize,
}

impl<M: Phases> Kernel for Retreat<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { smoother: Smoother { filter, lambda, information, consider, effect, .. }, history, i } = self;
        // The order is that of prediction turned round: sensors' states last of all then, first of all now.
        let (memory, dt, stride) = (history.memory(i), history.dt[i], information.matrix.stride);
        if let Some(consider) = consider {
            consider.retreat(&mut filter.model, memory, dt);
        }
        if effect.is_active() {
            effect.retreat(&mut filter.model, memory, dt);
        }
        filter.model.retreat_sensors(memory, lambda, &mut information.matrix);
        filter.model.noise_rows(memory, dt, &mut information.noise, stride);
        // Λ ← (Λ⁻¹ + Q)⁻¹ before Fᵀ Λ F: what later readings say is blurred by the noise between, then carried back.
        information.blur();
        filter.model.retreat(memory, dt, lambda, &mut information.matrix);
    }
}

/// The filter as it is before a stretch, and the stretch.
pub(super) type Stretch<M> = (ExtendedKalmanFilter<M>, Range<usize>);

/// Bytes of history that a stretch may take.
const STRETCH: usize = 256 << 20;

impl<M: Phases> Smoother<M> {
    /// A smoother on `filter`'s model, noise and settings; it starts from rest at a recording's first sample.
    pub fn new(filter: &ExtendedKalmanFilter<M>) -> Self {
        let mut filter = filter.clone();
        filter.reset();
        let states = filter.model.states();
        let information = Information::none(states);
        let (m, stride) = (filter.model.channels(), information.matrix.stride);
        Self {
            lambda: vec![0.0; stride],
            rows: vec![0.0; m * stride],
            whitened: vec![0.0; m * stride],
            mean: vec![0.0; states],
            smoothed: vec![0.0; states * stride],
            information,
            consider: filter.consider.as_ref().map(|consider| ConsiderBack::new(consider, states)),
            effect: EffectBack::new(states, filter.model.robot().len()),
            filter,
        }
    }

    /// Smooths a recording: the estimate at each sample by all samples.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::run`].
    pub fn run(&mut self, recording: KalmanRecording<'_>, keep: Keep) -> Result<FilterOutput, RunError> {
        let starts = self.starts(recording)?;
        // Backwards, the last stretch first: λ and Λ, the information of later readings, stay in `self` from one to the next.
        self.finish();
        let mut parts = Vec::with_capacity(starts.len());
        for (start, rows) in starts.iter().rev() {
            parts.push(self.stretch_back(start, recording.rows(rows.clone(), &self.filter.model), keep)?);
        }
        let mut parts = parts.into_iter().rev();
        let first = parts.next().unwrap_or_default();
        Ok(parts.try_fold(first, FilterOutput::followed_by)?)
    }

    /// The stretches of a recording, and the filter as it is before each.
    pub(super) fn starts(&self, recording: KalmanRecording<'_>) -> Result<Vec<Stretch<M>>, RunError> {
        self.filter.model.check(&recording)?;
        let (count, stretch) = (recording.dt.len(), self.stretch());
        let mut filter = self.filter.clone();
        let mut starts = Vec::with_capacity(count / stretch + 1);
        // Forwards through all stretches, remembering but the filter at the start of each: memory for one, not for all.
        for from in (0..count).step_by(stretch) {
            let to = (from + stretch).min(count);
            starts.push((filter.clone(), from..to));
            if to < count {
                filter.run(recording.rows(from..to, &self.filter.model), Keep::default())?;
            }
        }
        Ok(starts)
    }

    /// Samples whose history fits into the memory set aside.
    pub fn stretch(&self) -> usize {
        let (states, stride) = (self.mean.len(), self.lambda.len());
        let model = &self.filter.model;
        let numbers = states * (stride + 1)
            + model.channels() * (model.dense() + stride + 3)
            + DependenceHistory::size(model)
            + model.memory()
            + 1;
        (STRETCH / (8 * numbers)).max(1)
    }

    /// Forgets what later stretches said: the next one is a recording's last.
    pub fn finish(&mut self) {
        self.lambda.fill(0.0);
        self.information.clear();
        if let Some(consider) = &mut self.consider {
            consider.finish();
        }
        self.effect.finish();
    }

    /// Smooths a stretch of a recording, the last stretch first; `start` is the filter as it was before the stretch.
    ///
    /// # Errors
    /// As [`ExtendedKalmanFilter::run`].
    pub fn stretch_back(
        &mut self,
        start: &ExtendedKalmanFilter<M>,
        recording: KalmanRecording<'_>,
        keep: Keep,
    ) -> Result<FilterOutput, RunError> {
        let mut filter = start.clone();
        let count = recording.dt.len();
        filter.model.check(&recording)?;
        let mut history = History::with_capacity(count, &filter.model, self.lambda.len())?;
        // Forwards once more, now keeping P⁻, W and innovations of every sample…
        let mut out = filter.run_with(recording, keep, Some(&mut history))?;
        if let (Some(back), Some(consider)) = (&mut self.consider, &filter.consider) {
            // The parameters' estimates by all readings are those after the last; only from there is the way back
            // consistent.
            back.learn(consider);
        }
        // Faults began before they were found: with all steps known, their effect once more from where they did.
        if self.effect.learn(filter.monitor.as_ref().map_or(&[], |monitor| &monitor.effect.steps), start.taken()) {
            history = History::with_capacity(count, &filter.model, self.lambda.len())?;
            filter = start.clone();
            filter.follow(&self.effect.steps);
            filter.run_with(recording, Keep::default(), Some(&mut history))?;
        }
        let history = &history;
        let watch = Watch::current();
        // …and backwards: undo the sample's readings, read off the smoothed state, undo its prediction (Bierman 1973).
        for i in (0..count).rev() {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            M::back_phase(SmoothBack { smoother: &mut *self, history, i, whole: keep.covariance });
            if self.is_moved(history, i) {
                out.status[i] |= Status::CONTRADICTED | Status::FAULTY;
            }
            self.report(history, i, &mut out, keep.covariance);
            M::retreat_phase(Retreat { smoother: &mut *self, history, i });
        }
        Ok(out)
    }

    /// λ and Λ from after sample `i`'s readings to before them.
    ///
    /// For a row h of noise r, with gain k and innovation ν of variance s: λ ← (1 − k h)ᵀ λ − hᵀν/s, the last reading first,
    /// and Λ ← Λ + hᵀh/r.
    #[inline(always)]
    fn back(&mut self, history: &History, i: usize) {
        let m = self.load_rows(history, i);
        self.pull(history, i);
        let corrections = history.corrections(i);
        self.information.learn(&self.whitened);
        if let Some(consider) = &mut self.consider {
            consider.back(&history.consider, i, &history.innovations[i * m..][..m], &self.rows, corrections);
        }
        if self.effect.is_active() {
            self.effect.back(&history.effect, i, &history.innovations[i * m..][..m], &self.rows, corrections);
        }
    }

    /// What [`back`](Self::back) does to λ, with the rows of H that were loaded.
    #[inline(always)]
    pub(super) fn pull(&mut self, history: &History, i: usize) {
        let (stride, corrections) = (self.lambda.len(), history.corrections(i));
        let m = self.rows.len() / stride;
        // Readings in the order opposite to that in which the filter used them, as each gain belongs to the P of its
        // turn.
        for a in (0..m).rev() {
            let Innovation { value, std } = history.innovations[i * m + a];
            if std.is_finite() {
                let pull = linear::dot(&corrections[a * stride..][..stride], &self.lambda) + value;
                linear::add_scaled(&mut self.lambda, -pull / std, &self.rows[a * stride..][..stride]);
            }
        }
    }

    /// Whether faults move some smoothed link of sample `i` by more than its standard deviation.
    fn is_moved(&self, history: &History, i: usize) -> bool {
        let (m, stride) = (self.rows.len() / self.lambda.len(), self.lambda.len());
        self.effect.is_active()
            && self.effect.counts(&history.effect, i, m, history.covariance(i), &self.smoothed, stride)
    }

    /// Whole rows of H at sample `i`, of readings with independent errors, and each over √r; zero where a reading was not used.
    /// Returns how many.
    #[inline(always)]
    pub(super) fn load_rows(&mut self, history: &History, i: usize) -> usize {
        let Self { filter: ExtendedKalmanFilter { model, .. }, rows, whitened, lambda, .. } = self;
        let (m, d, stride) = (model.channels(), model.dense(), lambda.len());
        for (c, row) in rows.chunks_exact_mut(stride).enumerate() {
            row.fill(0.0);
            let at = i * m + c;
            // A gated or missing reading said nothing: a row of zeros leaves λ and Λ alone.
            if history.innovations[at].is_used() {
                row[..d].copy_from_slice(&history.jacobians[at * d..][..d]);
                if let Some(b) = model.biases()[c] {
                    row[b] = 1.0;
                }
            }
        }
        history.dependence.separate(i, m, rows);
        for (c, (row, white)) in rows.chunks_exact(stride).zip(whitened.chunks_exact_mut(stride)).enumerate() {
            let factor = 1.0 / history.variances[i * m + c].sqrt();
            for (white, h) in white.iter_mut().zip(row) {
                *white = factor * h;
            }
        }
        m
    }

    /// The smoothed mean, and the covariance of q or of the whole state.
    #[inline(always)]
    fn smooth(&mut self, history: &History, i: usize, whole: bool) {
        let (states, stride) = (self.mean.len(), self.lambda.len());
        let predicted = history.covariance(i);
        // x̂ = x⁻ − P⁻ λ.
        for (r, row) in predicted.chunks_exact(stride).enumerate() {
            self.mean[r] = history.means[i * states + r] - linear::dot(row, &self.lambda);
        }
        let rows = if whole { states } else { self.filter.model.reported() };
        self.information.smooth(predicted, rows, &mut self.smoothed);
        if let Some(consider) = &mut self.consider {
            consider.sum_up(&history.consider, i, predicted, stride, rows, history.dt[i]);
            for r in 0..rows {
                linear::add_scaled(&mut self.smoothed[r * stride..][..rows], 1.0, &consider.total[r * rows..][..rows]);
            }
        }
    }

    /// The smoothed estimate into row `i`; motors as the filter remembered them there.
    fn report(&mut self, history: &History, i: usize, out: &mut FilterOutput, whole: bool) {
        let Self { filter, mean, smoothed: covariance, lambda, .. } = self;
        let ExtendedKalmanFilter { model, tool, .. } = filter;
        let (memory, stride) = (history.memory(i), lambda.len());
        M::report_phase(WriteReport { model, memory, mean, covariance, stride, more: None, tool, i, out, whole });
    }
}
