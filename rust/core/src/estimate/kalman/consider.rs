//! Parameters that count without being estimated: the Schmidt–Kalman filter in its sensitivity form.
//!
//! S. F. Schmidt (1966); the sensitivity of the error follows D. C. Woodbury and J. L. Junkins (2010), and what the
//! innovations say of the parameters is the second stage of B. Friedland's filter (IEEE Trans. Automatic Control 14,
//! 1969). Gains stay those of the filter without parameters, so its mean does not change.

use super::correction::Correction;
use super::gaussian::Symmetric;
use super::model::Model;
use super::sensitivity::Sensitivity;
use super::tolerances::Tolerances;
use super::uncertain::Uncertain;
use crate::linear;

/// Samples of one sum, from which low-frequency noise is estimated.
const BLOCK: u32 = 32;
/// Blocks that such noise is averaged over.
const BLOCKS: f64 = 8.0;
/// Part of the excess of such noise that is left a block later: a wrong model shows where the robot moves, not always.
const FADING: f64 = 1.0 - 1.0 / 64.0;
/// Every n-th sample updates the parameters: neighbours hardly differ, and the filter stays fast.
const THIN: u32 = 8;
/// Part of the prior variance that no reading takes away: effects are linear in the parameters to about a sixth of them.
const KEPT: f64 = 0.03;
/// A residual beyond this many standard deviations has another cause and does not update the parameters.
const STRANGE: f64 = 5.0;
/// From this many on the effect of the parameters is evaluated at once: a motion may begin with a shock.
const SURPRISING: f64 = 2.5;

/// How the error of the state depends on the parameters, and what is known of these.
///
/// With Σ = ∂(x − x̂)/∂p, predicted by Σ⁻ = F Σ + Ψ and corrected by Σ = (1 − K H) Σ⁻ − K N, the covariance of the
/// error is P + Σ E[p pᵀ] Σᵀ. An innovation's mean is s p, s = H Σ⁻ + N, so innovations tell p: E[p pᵀ] is its second
/// moment about the values of robot.yaml, given all readings so far.
///
/// Σ is states × parameters: a sample costs as much more than the filter as there are parameters for a state. Gains are
/// those of the filter without them, so that switching tolerances off changes standard deviations and not the estimate.
#[derive(Clone, Debug)]
pub(super) struct Consider {
    /// Parameters.
    pub(super) count: usize,
    /// Σ and s.
    pub(super) sensitivity: Sensitivity,
    /// Variances of the parameters as robot.yaml's tolerances have them.
    prior: Vec<f64>,
    /// Their covariances: two columns and a value each, where the tolerances are correlated.
    joint: Vec<(usize, usize, f64)>,
    /// Share of each prior variance that no reading takes away, and the square root of the rest.
    kept: Vec<f64>,
    open: Vec<f64>,
    /// E[p] given the readings.
    mean: Vec<f64>,
    /// Cov[p] given the readings.
    spread: Symmetric,
    /// E[p pᵀ].
    moment: Symmetric,
    /// Variance of the noise of each channel's innovations as it lasts, in multiples of the filter's.
    lasting: Vec<f64>,
    /// The most that it lately was; at least 1.
    peak: Vec<f64>,
    /// Sums of each channel's residuals over the present block, and samples taken.
    sums: Vec<f64>,
    taken: u32,
    /// Scratch: Cov[p] s, and Σ E[p pᵀ].
    gain: Vec<f64>,
    wide: Vec<f64>,
    /// See [`swings`](super::model::Measurement::swings).
    pub(super) swings: Vec<f64>,
    /// By how much a vibration of each joint is damped in Σ: the share by which its frequency may be off.
    blur: Vec<f64>,
    /// Σ E[p pᵀ] Σᵀ of the first states.
    pub(super) total: Vec<f64>,
    held: Held,
    /// Scratch beside it.
    apart: Held,
    /// Time since `total` was last summed up.
    elapsed: f64,
    /// Innovations less what the parameters explain, in their standard deviations; NaN where not used.
    pub(super) residuals: Vec<f64>,
    /// Variances of the residuals with what the parameters may do to them, in multiples of the filter's (channels).
    variances: Vec<f64>,
}

impl Consider {
    pub(super) fn new(model: &impl Model) -> Option<Self> {
        let tolerances = model.tolerances();
        let (count, m, states) = (tolerances.len(), model.channels(), model.states());
        let stride = count.next_multiple_of(linear::LANES);
        let kept: Vec<f64> = tolerances.iter().map(|t| if t.parameter.is_constant() { KEPT } else { 1.0 }).collect();
        let mut consider = Self {
            open: kept.iter().map(|kept| (1.0 - kept).sqrt()).collect(),
            kept,
            count,
            sensitivity: Sensitivity::new(model, count),
            prior: tolerances.iter().map(|t| t.counted() * t.counted()).collect(),
            joint: tolerances.covariances().collect(),
            mean: vec![0.0; stride],
            spread: Symmetric::zeros(stride),
            moment: Symmetric::zeros(stride),
            lasting: vec![0.0; m],
            peak: vec![1.0; m],
            sums: vec![0.0; m],
            taken: 0,
            gain: vec![0.0; stride],
            wide: vec![0.0; states * stride],
            swings: vec![0.0; model.robot().len()],
            blur: (0..model.robot().len()).map(|j| blur(tolerances, j)).collect(),
            total: vec![0.0; states * states],
            held: Held::new(model.robot().len()),
            apart: Held::new(model.robot().len()),
            elapsed: 0.0,
            residuals: vec![f64::NAN; m],
            variances: vec![1.0; m],
        };
        consider.reset();
        (count > 0).then_some(consider)
    }

    /// Forgets all that readings said.
    pub(super) fn reset(&mut self) {
        self.sensitivity.columns.fill(0.0);
        self.held.reset();
        self.elapsed = 0.0;
        self.mean.fill(0.0);
        self.spread.data.fill(0.0);
        for (i, variance) in self.prior.iter().enumerate() {
            self.spread.put(i, i, *variance);
        }
        for &(i, j, covariance) in &self.joint {
            self.spread.put(i, j, covariance);
        }
        self.lasting.fill(1.0);
        self.peak.fill(1.0);
        self.sums.fill(0.0);
        self.taken = 0;
        // E[p pᵀ] = Cov[p] + E[p] E[p]ᵀ: the state is not corrected by E[p], so that a mean off zero is an error as
        // well.
        self.moment.data.copy_from_slice(&self.spread.data);
    }

    /// Σ where a filter starts: links are where the motors' readings and the predicted torsion put them, so that an error of
    /// either is one of the link, the other way round.
    pub(super) fn start(&mut self, model: &mut impl Model) {
        let Sensitivity { stride, columns, signatures, .. } = &mut self.sensitivity;
        model.start_columns(*stride, signatures, columns);
    }

    /// Σ through the step last predicted, vibrations damped by [`blur`].
    #[inline(always)]
    pub(super) fn carry(&mut self, model: &mut impl Model, dt: f64) {
        let Sensitivity { stride: p, columns, .. } = &mut self.sensitivity;
        let (p, n) = (*p, self.swings.len());
        self.elapsed += dt;
        model.carry(columns, p, dt);
        for j in (0..n).filter(|&j| self.swings[j] > 0.0) {
            let share = self.blur[j] * dt / (self.swings[j] + self.blur[j] * dt);
            let motor = model.motor_velocity(j);
            for k in 0..p {
                let beside = motor.map_or(0.0, |motor| columns[motor * p + k]);
                let link = &mut columns[(n + j) * p + k];
                *link -= share * (*link - beside);
            }
        }
    }

    /// Σ through the update that `correction` has done, and what it says of the parameters.
    #[inline(always)]
    pub(super) fn update(&mut self, model: &mut impl Model, correction: &Correction) {
        model.signatures(self.sensitivity.stride, &mut self.sensitivity.signatures);
        model.swings(&mut self.swings);
        self.sensitivity.update(model, correction);
        self.weigh(model, correction);
    }

    /// Residuals of the innovations, the noise that lasts in them, and the parameters by them.
    #[inline(always)]
    fn weigh(&mut self, model: &impl Model, correction: &Correction) {
        self.taken += 1;
        let stride = self.sensitivity.stride;
        let learn = self.taken.is_multiple_of(THIN);
        for (i, innovation) in correction.innovations.iter().enumerate() {
            if !innovation.is_used() {
                self.residuals[i] = f64::NAN;
                continue;
            }
            let signature = &self.sensitivity.signatures[i * stride..][..stride];
            // What the parameters' estimates leave of the innovation, in its standard deviations. For white residuals their
            // sum over a block has the block's length for a variance; whatever lasts makes it larger, and must not be taken
            // for news of the parameters.
            let residual = innovation.value - linear::dot(signature, &self.mean);
            self.sums[i] += residual;
            if learn || residual * residual > SURPRISING * SURPRISING * self.variances[i] {
                // Friedland's second stage (1969): the innovation is a reading of p by s, of the filter's variance and
                // what lasts.
                for (g, row) in self.gain.iter_mut().zip(self.spread.data.chunks_exact(self.spread.stride)) {
                    *g = linear::dot(row, signature);
                }
                let known = linear::dot(&self.gain, signature);
                self.variances[i] = 1.0 + known + self.kept_doubt(signature);
                let variance = self.lasting[i].max(1.0) + known;
                if learn && model.teaches(i) && residual * residual < STRANGE * STRANGE * variance {
                    self.learn(residual, variance);
                }
            }
            self.residuals[i] = residual / self.variances[i].sqrt();
        }
        if self.taken.is_multiple_of(BLOCK) {
            for (lasting, sum) in self.lasting.iter_mut().zip(&mut self.sums) {
                *lasting += (*sum * *sum / f64::from(BLOCK) - *lasting) / BLOCKS;
                *sum = 0.0;
            }
            for (peak, lasting) in self.peak.iter_mut().zip(&self.lasting) {
                *peak = lasting.max(1.0 + (*peak - 1.0) * FADING);
            }
        }
        if learn {
            self.moment.data.copy_from_slice(&self.spread.data);
            let doubt = self.doubt_of_model(model);
            let rows = self.moment.data.chunks_exact_mut(stride);
            for ((m, row), open) in self.mean.iter().zip(rows).zip(&self.open) {
                linear::add_scaled(row, *m, &self.mean);
                row.iter_mut().zip(&self.open).for_each(|(x, other)| *x *= open * other * doubt);
            }
            for (i, (prior, kept)) in self.prior.iter().zip(&self.kept).enumerate() {
                self.moment.data[i * stride + i] += kept * prior;
            }
            for &(i, j, covariance) in &self.joint {
                self.moment.data[i * stride + j] += self.kept[i] * covariance;
                self.moment.data[j * stride + i] += self.kept[i] * covariance;
            }
        }
    }

    /// Deviation of what lasts and no parameter explains, in deviations of the noise; at least 1. As long as it is there,
    /// the error that the parameters tell of is not all of the model's.
    #[inline(always)]
    fn doubt_of_model(&self, model: &impl Model) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (lasting, _) in self.lasting.iter().zip(0..).filter(|(_, i)| model.teaches(*i)) {
            (sum, count) = (sum + lasting, count + 1.0);
        }
        if count > 0.0 { f64::max(sum / count, 1.0).sqrt() } else { 1.0 }
    }

    /// Kalman's update of the parameters by a residual of this variance, the gain holding Cov[p] s.
    #[inline(always)]
    fn learn(&mut self, residual: f64, variance: f64) {
        linear::add_scaled(&mut self.mean, residual / variance, &self.gain);
        for (g, row) in self.gain.iter().zip(self.spread.data.chunks_exact_mut(self.spread.stride)) {
            linear::add_scaled(row, -g / variance, &self.gain);
        }
    }

    /// Σ E[p pᵀ] Σᵀ of the first `rows` states, into [`total`](Self::total), rows apart by `rows`, whatever the phase of a
    /// vibration.
    #[inline(always)]
    pub(super) fn sum_up(&mut self, rows: usize) {
        let Self { sensitivity: Sensitivity { columns, .. }, moment, wide, total, swings, held, elapsed, .. } = self;
        spread_of(columns, swings, moment, rows, wide, total);
        held.raise(swings, core::mem::take(elapsed), total, rows);
    }

    /// The same for one who looks on: what the next sample finds is as it was.
    pub(super) fn sum_up_apart(&mut self, rows: usize) {
        self.apart.variances.copy_from_slice(&self.held.variances);
        let Self { sensitivity: Sensitivity { columns, .. }, moment, wide, total, swings, apart, elapsed, .. } = self;
        spread_of(columns, swings, moment, rows, wide, total);
        apart.raise(swings, *elapsed, total, rows);
    }

    /// E[p pᵀ] by the readings so far.
    pub(super) fn moment(&self) -> &Symmetric {
        &self.moment
    }

    /// Normalised innovation squared, with what the parameters explain and what they may.
    #[inline(always)]
    pub(super) fn nis(&self) -> f64 {
        self.residuals.iter().filter(|r| r.is_finite()).map(|r| r * r).sum()
    }

    /// E[s · p] for a signature s.
    #[inline(always)]
    pub(super) fn explained(&self, signature: &[f64]) -> f64 {
        linear::dot(signature, &self.mean)
    }

    /// Var[s · p] for a signature s, with what no reading takes away.
    #[inline(always)]
    pub(super) fn doubt(&self, signature: &[f64], gain: &mut [f64]) -> f64 {
        for (g, row) in gain.iter_mut().zip(self.spread.data.chunks_exact(self.spread.stride)) {
            *g = linear::dot(row, signature);
        }
        linear::dot(gain, signature) + self.kept_doubt(signature)
    }

    /// The part of it that no reading takes away.
    #[inline(always)]
    fn kept_doubt(&self, signature: &[f64]) -> f64 {
        let each = self.prior.iter().zip(&self.kept).zip(signature);
        let shared =
            |&(i, j, covariance): &(usize, usize, f64)| 2.0 * self.kept[i] * covariance * signature[i] * signature[j];
        each.map(|((prior, kept), s)| kept * prior * s * s).sum::<f64>() + self.joint.iter().map(shared).sum::<f64>()
    }

    /// The most that the noise of channel `i`'s innovations lately lasted, in multiples of the filter's; at least 1.
    pub(super) fn peak(&self, i: usize) -> f64 {
        self.peak[i]
    }

    /// By how much the parameters widen the variance of channel `i`'s innovation.
    #[inline(always)]
    pub(super) fn factor(&self, i: usize) -> f64 {
        self.variances[i]
    }

    /// E[p] and the standard deviations of p given the readings so far.
    pub(super) fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        let std = (0..self.count).map(|i| self.spread.at(i, i).max(0.0).sqrt()).collect();
        (self.mean[..self.count].to_vec(), std)
    }
}

/// `out` ← C E[p pᵀ] Cᵀ for the first `rows` of `columns`, and for links C those of velocities over frequencies beside it.
///
/// A link on its spring swings at a frequency that is known to a tolerance only, so that soon nothing is known of when it
/// passes through zero: what is sure is the amplitude, and the square of that is x² + (ẋ/ω)².
#[inline(always)]
pub(super) fn spread_of(
    columns: &[f64],
    swings: &[f64],
    moment: &Symmetric,
    rows: usize,
    wide: &mut [f64],
    out: &mut [f64],
) {
    let (p, n) = (moment.stride, swings.len());
    let most = rows.max(2 * n);
    linear::product(&columns[..most * p], p, &moment.data, p, wide);
    let entry = |r: usize, c: usize| linear::dot(&wide[r * p..][..p], &columns[c * p..][..p]);
    for r in 0..rows {
        for c in r..rows {
            let mut sum = entry(r, c);
            if c < n {
                sum += swings[r] * swings[c] * entry(n + r, n + c);
            }
            out[r * rows + c] = sum;
            out[c * rows + r] = sum;
        }
    }
}

/// Variances of links that parameters account for, as they lately were.
///
/// What ends a vibration of the model, a stop that comes at the right time, does not end one of another frequency: it takes
/// a period for a standard deviation to fall to 1/e.
#[derive(Clone, Debug)]
pub(super) struct Held {
    variances: Vec<f64>,
    factors: Vec<f64>,
}

impl Held {
    pub(super) fn new(joints: usize) -> Self {
        Self { variances: vec![0.0; joints], factors: vec![1.0; joints] }
    }

    pub(super) fn reset(&mut self) {
        self.variances.fill(0.0);
    }

    /// Takes over a sample `dt` away from the last one, and raises `total` (`rows` × `rows`) to what is held.
    #[inline(always)]
    pub(super) fn raise(&mut self, swings: &[f64], dt: f64, total: &mut [f64], rows: usize) {
        let held = self.variances.iter_mut().zip(&mut self.factors);
        for (j, ((held, factor), swing)) in held.zip(swings).enumerate() {
            let (now, period) = (total[j * rows + j], core::f64::consts::PI * swing);
            *held = if *swing > 0.0 { now.max(*held * period / (period + dt)) } else { now };
            *factor = if *held > now && now > 0.0 { (*held / now).sqrt() } else { 1.0 };
        }
        let n = self.factors.len();
        let factor = |i: usize| if i < n { self.factors[i] } else { 1.0 };
        for (r, row) in total.chunks_exact_mut(rows).take(rows).enumerate() {
            row.iter_mut().enumerate().for_each(|(c, x)| *x *= factor(r) * factor(c)); // symmetric to the last bit
        }
    }
}

/// How a vibration of joint `j` is damped in Σ, as a share of its frequency: twice the damping ratio.
///
/// Of modes whose frequencies differ by the share σ/2 for σ in ln K, the differences are in the end as large as √2 times
/// the vibration. On a spring that does not damp, Σ would grow with time for ever; damped by this it ends there.
fn blur(tolerances: &Tolerances, j: usize) -> f64 {
    let own = tolerances.iter().find(|t| t.parameter == Uncertain::Stiffness(j));
    own.map_or(0.0, |t| t.counted() * core::f64::consts::FRAC_1_SQRT_2)
}
