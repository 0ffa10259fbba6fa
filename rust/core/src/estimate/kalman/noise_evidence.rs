//! What a recording says of the sizes of noise: its likelihood with the derivatives by them.
//!
//! Q and R are sums of what independent sources of noise have in them, each times a factor θ that is 1 now: a [`JerkNoise`] of
//! that source alone. Beside the filter run the derivatives of x⁻ and P⁻ by each ln θ (N. K. Gupta and R. K. Mehra, IEEE Trans.
//! Automatic Control 19, 1974): P′ ← F P′ Fᵀ + Q′ over a step of time, where h is linearised no other than in the filter. For
//! a source with d random numbers the M-step of expectation and maximisation follows from the score by Fisher's identity
//! (A. P. Dempster, N. M. Laird and D. B. Rubin, J. R. Stat. Soc. B 39, 1977), so that nothing has to run backwards:
//!
//! θ ← θ (1 + 2/d ∂ ln p/∂ ln θ).

use super::driven::JerkDriven;
use super::filter::ExtendedKalmanFilter;
use super::gaussian::{Innovation, Symmetric};
use super::jerk::JerkNoise;
use super::model::Model;
use super::recording::KalmanRecording;
use crate::check::expect_at_least;
use crate::error::RunError;
use crate::interrupt::Watch;
use crate::linear;
use crate::memory::filled;
use crate::parallel;
use crate::simd::{self, Kernel};

/// What a recording says of p sources of noise, at their present size.
#[derive(Clone, Debug, Default)]
pub struct NoiseEvidence {
    /// Logarithm of each sample's density, given those before it (count).
    pub log_likelihood: Vec<f64>,
    /// Its derivatives by the logarithms of the sources' variances (count × p).
    pub scores: Vec<f64>,
    /// How many random numbers of each source are in each sample: directions of its Q′, and readings used with its R′ (count × p).
    pub dimensions: Vec<f64>,
    /// Σ ∂ν ∂νᵀ/s + ½ ∂ln s ∂ln sᵀ over innovations ν of variance s: Fisher's information along each stretch (stretches × p × p).
    pub information: Vec<f64>,
}

/// A recording, the filter to run it through, the sources of its noise, and samples a stretch.
pub type NoiseJob<'a> = (&'a ExtendedKalmanFilter<JerkDriven>, KalmanRecording<'a>, &'a [JerkNoise], usize);

impl ExtendedKalmanFilter<JerkDriven> {
    /// What each recording says of the sizes of its noise; each from a fresh start, on all cores.
    pub fn noise_evidence(jobs: &[NoiseJob<'_>]) -> Vec<Result<NoiseEvidence, RunError>> {
        parallel::map(jobs, |&(filter, recording, shares, stretch)| {
            let mut filter = filter.clone();
            filter.reset();
            filter.watch(false);
            filter.differentiate(recording, shares, stretch)
        })
    }

    fn differentiate(
        mut self,
        recording: KalmanRecording<'_>,
        shares: &[JerkNoise],
        stretch: usize,
    ) -> Result<NoiseEvidence, RunError> {
        self.model.check(&recording)?;
        shares.iter().try_for_each(|share| self.model.jerk_model().check_deviations(share))?;
        expect_at_least("samples of a stretch", stretch, 1)?;
        let (count, p) = (recording.dt.len(), shares.len());
        let mut evidence = NoiseEvidence {
            log_likelihood: filled(0.0, count, 1)?,
            scores: filled(0.0, count, p)?,
            dimensions: filled(0.0, count, p)?,
            information: filled(0.0, count.div_ceil(stretch), p * p)?,
        };
        let mut slopes = Slopes::new(&self.model, shares);
        let watch = Watch::current();
        for i in 0..count {
            if watch.stops() {
                return Err(RunError::Interrupted { sample: i });
            }
            let sample = recording.sample(i, &self.model);
            let time = self.is_started().then_some(sample.dt);
            self.advance(&sample)?;
            self.correct(&sample);
            if !self.is_finite(&sample) {
                return Err(RunError::NotFinite { sample: i });
            }
            self.taken += 1;
            simd::phase(AdvanceSlopes { filter: &mut self, slopes: &mut slopes, time });
            evidence.log_likelihood[i] = self.correction.log_likelihood;
            slopes.add(
                &self.correction.innovations,
                &mut evidence.scores[i * p..][..p],
                &mut evidence.information[i / stretch * p * p..][..p * p],
            );
            for (dimensions, slope) in evidence.dimensions[i * p..].iter_mut().zip(&slopes.each) {
                *dimensions = slope.dimensions;
            }
        }
        Ok(evidence)
    }
}

/// The derivatives of a filter by the sizes of its noise.
#[derive(Debug)]
struct Slopes<'a> {
    /// One a source.
    each: Vec<Slope<'a>>,
    /// Rows of H, one padded row for each channel.
    rows: Vec<f64>,
    /// Scratch: a gain, P′ hᵀ, and what P′ loses by that; P′ turned.
    gain: Vec<f64>,
    projection: Vec<f64>,
    loss: Vec<f64>,
    turned: Vec<f64>,
}

/// Those by one of them.
#[derive(Debug)]
struct Slope<'a> {
    /// Its Q′ and R′.
    share: &'a JerkNoise,
    /// x′ and P′.
    mean: Vec<f64>,
    covariance: Symmetric,
    /// ν′ and s′ of each channel's innovation at the last sample.
    value: Vec<f64>,
    variance: Vec<f64>,
    /// Its random numbers in the last sample.
    dimensions: f64,
}

/// Past a sample: first over the `time` before it, where there is any, then through its readings.
struct AdvanceSlopes<'a, 'b> {
    filter: &'a mut ExtendedKalmanFilter<JerkDriven>,
    slopes: &'a mut Slopes<'b>,
    time: Option<f64>,
}

impl Kernel for AdvanceSlopes<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { filter, slopes, time } = self;
        slopes.load_rows(&filter.model, &filter.correction.innovations);
        for at in 0..slopes.each.len() {
            slopes.each[at].dimensions = 0.0;
            if let Some(dt) = time {
                slopes.carry(&mut filter.model, at, dt);
            }
            slopes.correct(filter, at);
        }
    }
}

impl<'a> Slopes<'a> {
    fn new(model: &JerkDriven, shares: &'a [JerkNoise]) -> Self {
        let (states, m) = (model.states(), model.channels());
        let slope = |share| {
            let covariance = Symmetric::zeros(states);
            Slope {
                share,
                mean: vec![0.0; covariance.stride],
                covariance,
                value: vec![0.0; m],
                variance: vec![0.0; m],
                dimensions: 0.0,
            }
        };
        let stride = Symmetric::zeros(states).stride;
        let [gain, projection, loss] = core::array::from_fn(|_| vec![0.0; stride]);
        Self {
            each: shares.iter().map(slope).collect(),
            rows: vec![0.0; m * stride],
            turned: vec![0.0; stride * stride],
            gain,
            projection,
            loss,
        }
    }

    #[inline(always)]
    fn load_rows(&mut self, model: &JerkDriven, innovations: &[Innovation]) {
        let (d, stride) = (model.dense(), self.gain.len());
        for (c, row) in self.rows.chunks_exact_mut(stride).enumerate().filter(|(c, _)| innovations[*c].is_used()) {
            row.fill(0.0);
            row[..d].copy_from_slice(&model.linearised().jacobian[c * d..][..d]);
            if let Some(b) = model.biases()[c] {
                row[b] = 1.0;
            }
        }
    }

    /// x′ ← F x′, P′ ← F P′ Fᵀ + Q′: from the left, and once more from the left what is turned, as P′ is symmetric.
    #[inline(always)]
    fn carry(&mut self, model: &mut JerkDriven, at: usize, dt: f64) {
        let Self { each, turned, .. } = self;
        let Slope { share, mean, covariance, dimensions, .. } = &mut each[at];
        let Symmetric { stride, data, .. } = covariance;
        model.carry_noise_free(mean, 1, dt);
        model.carry_process(data, *stride, dt);
        linear::transpose(data, *stride, turned);
        model.carry_process(turned, *stride, dt);
        data.copy_from_slice(turned);
        *dimensions += model.jerk_model().add_noise(share, dt, covariance);
        // Sensors take their next value of links that noise has moved.
        let Symmetric { stride, data, .. } = covariance;
        model.carry_sensors(data, *stride);
        linear::transpose(data, *stride, turned);
        model.carry_sensors(turned, *stride);
        data.copy_from_slice(turned);
    }

    /// One reading after the other. With its row h of H, gain k, and innovation ν of variance s, and g = P′ hᵀ:
    ///
    /// s′ = h g + R′,  ν′ = −h x′,  c = g − k s′,  x′ ← x′ + k ν′ + c ν/s,
    ///
    /// P′ ← (1 − k h) P′ (1 − k h)ᵀ + R′ k kᵀ = P′ − k gᵀ − c kᵀ.
    #[inline(always)]
    fn correct(&mut self, filter: &ExtendedKalmanFilter<JerkDriven>, at: usize) {
        let Self { each, rows, gain, projection, loss, .. } = self;
        let Slope { share, mean, covariance, value, variance, dimensions } = &mut each[at];
        let (n, stride) = (covariance.n, covariance.stride);
        for (c, row) in rows.chunks_exact(stride).enumerate() {
            let innovation = filter.correction.innovations[c];
            (value[c], variance[c]) = (0.0, 0.0);
            if !innovation.is_used() {
                continue;
            }
            let own = filter.model.measurement.noise_variance(share, c);
            *dimensions += f64::from(own > 0.0);
            for (k, w) in gain.iter_mut().zip(&filter.correction.rows()[c * stride..]) {
                *k = w / innovation.std;
            }
            for (g, p) in projection.iter_mut().zip(covariance.data.chunks_exact(stride)).take(n) {
                *g = linear::dot(p, row);
            }
            variance[c] = linear::dot(row, projection) + own;
            value[c] = -linear::dot(row, mean);
            for ((loss, g), k) in loss.iter_mut().zip(&*projection).zip(&*gain) {
                *loss = g - k * variance[c];
            }
            linear::add_scaled(mean, value[c], gain);
            linear::add_scaled(mean, innovation.value / innovation.std, loss);
            for ((p, k), loss) in covariance.data.chunks_exact_mut(stride).zip(&*gain).zip(&*loss).take(n) {
                linear::add_scaled(p, -k, projection);
                linear::add_scaled(p, -loss, gain);
            }
        }
        covariance.mirror();
    }

    /// Adds the last sample's innovations to its `scores` (p) and to the `information` (p × p).
    fn add(&self, innovations: &[Innovation], scores: &mut [f64], information: &mut [f64]) {
        for (c, &Innovation { value, std }) in innovations.iter().enumerate().filter(|(_, one)| one.is_used()) {
            let relative = |slope: &Slope<'_>| (slope.value[c] / std, slope.variance[c] / (std * std));
            for ((score, slope), row) in
                scores.iter_mut().zip(&self.each).zip(information.chunks_exact_mut(self.each.len()))
            {
                let (by_value, by_variance) = relative(slope);
                *score -= value * by_value + 0.5 * (1.0 - value * value) * by_variance;
                for (information, other) in row.iter_mut().zip(&self.each) {
                    let (other_value, other_variance) = relative(other);
                    *information += by_value * other_value + 0.5 * by_variance * other_variance;
                }
            }
        }
    }
}
