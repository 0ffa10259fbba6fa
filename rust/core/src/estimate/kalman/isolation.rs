//! Innovations in their standard deviations, and which channel contradicts all others (W. Baarda 1968).

use super::consider::Consider;
use super::correction::Correction;
use super::findings::Alarm;

/// A sum of squares of residuals, and how many they are.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Squares {
    pub(super) sum: f64,
    pub(super) count: f64,
}

impl Squares {
    /// One more, of this weight.
    #[inline(always)]
    pub(super) fn add(&mut self, square: f64, weight: f64) {
        self.sum += weight * square;
        self.count += weight;
    }

    /// All of another sum.
    #[inline(always)]
    pub(super) fn join(&mut self, other: &Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    /// By how much it is beyond its mean.
    #[inline(always)]
    pub(super) fn excess(self) -> f64 {
        self.sum - self.count
    }
}

/// One sample's residuals, channel by channel.
#[derive(Clone, Debug)]
pub(super) struct Isolation {
    /// Innovations in their standard deviations, less what parameters explain; NaN where not used (channels).
    pub(super) residuals: Vec<f64>,
    /// Standard deviations of the innovations, with what parameters may do to them (channels).
    std: Vec<f64>,
    /// Scratch: Λ ν and columns of L⁻¹ (channels).
    pull: Vec<f64>,
    solution: Vec<f64>,
}

impl Isolation {
    pub(super) fn new(channels: usize) -> Self {
        let room = |value| vec![value; channels];
        Self { residuals: room(f64::NAN), std: room(1.0), pull: room(0.0), solution: room(0.0) }
    }

    /// Σ r² over the channels that were used.
    #[inline(always)]
    pub(super) fn squares(&self) -> f64 {
        self.residuals.iter().filter(|r| r.is_finite()).map(|r| r * r).sum()
    }

    /// The same less its mean.
    #[inline(always)]
    pub(super) fn excess(&self) -> f64 {
        self.residuals.iter().filter(|r| r.is_finite()).map(|r| r * r - 1.0).sum()
    }

    /// Residuals in standard deviations, less what parameters and `known` faults explain; sum of squares, the latter left in,
    /// and number, of all and of what is noise.
    ///
    /// What parameters add to an innovation lasts: a window of many samples tells no more of it than one does. So it counts
    /// by the share of its variance that is noise.
    #[inline(always)]
    pub(super) fn load(&mut self, correction: &Correction, consider: Option<&Consider>, known: &[f64]) -> [Squares; 2] {
        let [mut all, mut white] = [Squares::default(); 2];
        for (i, innovation) in correction.innovations.iter().enumerate() {
            if !innovation.is_used() {
                self.residuals[i] = f64::NAN;
                continue;
            }
            let (residual, factor) = match consider {
                Some(c) => (c.residuals[i], c.factor(i)),
                None => (innovation.value, 1.0),
            };
            let wider = factor.sqrt();
            self.std[i] = innovation.std * wider;
            self.residuals[i] = residual - known[i] / wider;
            all.add(residual * residual, 1.0);
            white.add(residual * residual, 1.0 / factor);
        }
        [all, white]
    }

    /// Largest t = [Λν]ᵢ/√Λᵢᵢ: each channel against the prediction and all others, with ν = L e, Cov e diagonal and L of
    /// S = L D Lᵀ.
    #[inline(always)]
    pub(super) fn worst(&mut self, correction: &Correction, only: Option<usize>) -> Alarm {
        let (m, width, upper) = (self.residuals.len(), correction.width(), correction.factor());
        let lower = |k: usize, i: usize| upper[i * width + k] / upper[i * width + i];
        // Λ ν = L⁻ᵀ D⁻¹ e by back substitution, with the factor that the update left.
        for i in (0..m).rev() {
            self.pull[i] = if self.residuals[i].is_finite() { self.residuals[i] / self.std[i] } else { 0.0 };
            for k in (i + 1..m).filter(|&k| self.residuals[k].is_finite()) {
                self.pull[i] -= lower(k, i) * self.pull[k];
            }
        }
        let mut worst =
            Alarm { channel: 0, size: 0.0, deviations: 0.0, age: 0, variance: 0.0, bank: None, fault: None };
        for c in (0..m).filter(|&c| self.residuals[c].is_finite() && only.is_none_or(|only| only == c)) {
            let mut precision = 0.0;
            // Λ_cc = ‖D^(−1/2) L⁻¹ e_c‖², column c of L⁻¹ by forward substitution.
            for k in (c..m).filter(|&k| self.residuals[k].is_finite()) {
                self.solution[k] = if k == c { 1.0 } else { 0.0 };
                for j in (c..k).filter(|&j| self.residuals[j].is_finite()) {
                    self.solution[k] -= lower(k, j) * self.solution[j];
                }
                precision += (self.solution[k] / self.std[k]).powi(2);
            }
            let deviations = self.pull[c].abs() / precision.sqrt();
            if deviations > worst.deviations {
                let (size, variance) = (self.pull[c] / precision, 1.0 / precision);
                worst = Alarm { channel: c, size, deviations, variance, ..worst };
            }
        }
        worst
    }
}
