//! A Gaussian belief.

use crate::check::expect_length;
use crate::error::DesignError;
use crate::linear;

/// A reading whose innovation has this many times the variance of its noise leaves no digits for differences.
pub(super) const SHARP: f64 = 1e4;

/// A row of a measurement matrix: dense over the first states, and one of the bias states.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Derivatives in the first `dense.len()` states.
    pub dense: &'a [f64],
    /// The bias state that adds to the reading.
    pub bias: Option<usize>,
}

impl Row<'_> {
    /// `row · v`.
    #[inline(always)]
    pub fn dot(&self, v: &[f64]) -> f64 {
        linear::dot(self.dense, v) + self.bias.map_or(0.0, |b| v[b])
    }
}

/// Symmetric matrix, stored whole, padded with zeros in both directions so that loops over it have no remainder.
#[derive(Clone, Debug)]
pub struct Symmetric {
    /// Rows and columns.
    pub(crate) n: usize,
    /// Numbers from one row to the next: n, padded.
    pub(crate) stride: usize,
    /// All entries, by rows.
    pub(crate) data: Vec<f64>,
}

impl Symmetric {
    /// n × n zeros.
    pub fn zeros(n: usize) -> Self {
        let stride = n.next_multiple_of(linear::LANES);
        Self { n, stride, data: vec![0.0; stride * stride] }
    }

    /// Row `i`, with its padding.
    #[inline(always)]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.data[i * self.stride..][..self.stride]
    }

    /// Entry (i, j).
    #[inline(always)]
    pub fn at(&self, i: usize, j: usize) -> f64 {
        self.data[i * self.stride + j]
    }

    /// Whether there is anything off the diagonal.
    pub(crate) fn is_correlated(&self) -> bool {
        (0..self.n).any(|i| (0..i).any(|j| self.at(i, j) != 0.0))
    }

    /// Sets entries (i, j) and (j, i).
    #[inline(always)]
    pub(crate) fn put(&mut self, i: usize, j: usize, value: f64) {
        self.data[i * self.stride + j] = value;
        self.data[j * self.stride + i] = value;
    }

    /// Copies the upper triangle onto the lower.
    #[inline(always)]
    pub(crate) fn mirror(&mut self) {
        linear::mirror(&mut self.data, self.stride);
    }

    /// Copies rows from the `first` on, up to the diagonal, onto the columns.
    #[inline(always)]
    pub(crate) fn turn_rows(&mut self, first: usize) {
        for i in first..self.n {
            let (above, own) = self.data.split_at_mut(i * self.stride);
            for (row, x) in above.chunks_exact_mut(self.stride).zip(own) {
                row[i] = *x;
            }
        }
    }

    /// `self += factor · Σᵢ aᵢ aᵢᵀ`, one padded row of `a` for each i.
    #[inline(always)]
    pub(crate) fn add_squares(&mut self, factor: f64, a: &[f64]) {
        linear::add_squares(factor, a, self.stride, &mut self.data);
    }

    /// The matrix with its rows padded to a common length.
    pub fn padded(&self) -> &[f64] {
        &self.data[..self.n * self.stride]
    }

    /// `self ← (1 − k hᵀ) self (1 − k hᵀ)ᵀ + r k kᵀ` with the gain k = self h/s, s = hᵀ self h + r, for padded `row` h, where
    /// `projection` is self h.
    ///
    /// Joseph's form as the product that it is: where s is 10⁴ times r and more, as after a long time without readings, the
    /// differences of [`add_squares`](Self::add_squares) would leave few digits or none. At three times its cost.
    #[inline(always)]
    pub(crate) fn condition(&mut self, row: &[f64], projection: &[f64], s: f64, r: f64) {
        let Self { n, stride, data } = self;
        // (1 − k hᵀ) P first, row by row, then the same from the right with r k kᵀ added.
        for (own, x) in data.chunks_exact_mut(*stride).zip(projection) {
            linear::add_scaled(own, -x / s, projection);
            let left = linear::dot(own, row);
            linear::add_scaled(own, (r * x / s - left) / s, projection);
        }
        // Rounding leaves the triangles a little apart: their mean keeps the matrix symmetric.
        for i in 0..*n {
            for j in i + 1..*n {
                let mean = 0.5 * (data[i * *stride + j] + data[j * *stride + i]);
                (data[i * *stride + j], data[j * *stride + i]) = (mean, mean);
            }
        }
    }

    /// The matrix without its padding, row-major.
    pub fn dense(&self) -> impl Iterator<Item = f64> + '_ {
        self.padded().chunks_exact(self.stride).flat_map(|row| row[..self.n].iter().copied())
    }
}

/// Mean and covariance of a state.
///
/// ```
/// use linkside_core::estimate::kalman::Gaussian;
/// let belief = Gaussian::new(&[1.0, 2.0], &[0.04, 0.01, 0.01, 0.09])?;
/// assert_eq!((belief.covariance.at(1, 0), belief.covariance.at(1, 1).sqrt()), (0.01, 0.3));
/// # Ok::<(), linkside_core::error::DesignError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Gaussian {
    /// Mean (n).
    pub mean: Vec<f64>,
    /// Covariance (n × n).
    pub covariance: Symmetric,
}

/// What one scalar measurement did, after those before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Innovation {
    /// y less its prediction, in standard deviations.
    pub(crate) value: f64,
    /// The standard deviation; infinite when the reading was not used.
    pub(crate) std: f64,
}

impl Innovation {
    /// Of a reading that was not used.
    pub(crate) const NONE: Self = Self { value: 0.0, std: f64::INFINITY };

    /// Whether the reading was used.
    #[inline(always)]
    pub(crate) fn is_used(&self) -> bool {
        self.std < f64::INFINITY
    }
}

impl Gaussian {
    /// A mean of zero with independent standard deviations.
    pub fn independent(std: &[f64]) -> Self {
        let mut covariance = Symmetric::zeros(std.len());
        for (i, s) in std.iter().enumerate() {
            covariance.data[i * covariance.stride + i] = s * s;
        }
        Self { mean: vec![0.0; std.len()], covariance }
    }

    /// With this mean (n) and covariance (n × n, row-major).
    ///
    /// # Errors
    /// Lengths that do not belong together.
    pub fn new(mean: &[f64], covariance: &[f64]) -> Result<Self, DesignError> {
        let n = mean.len();
        expect_length("covariance", covariance.len(), n * n)?;
        let mut belief = Self::independent(&vec![0.0; n]);
        belief.mean.copy_from_slice(mean);
        for i in 0..n {
            for j in i..n {
                belief.covariance.put(i, j, covariance[i * n + j]);
            }
        }
        Ok(belief)
    }

    /// A mean of zero, and nothing uncertain.
    pub(super) fn clear(&mut self) {
        self.mean.fill(0.0);
        self.covariance.data.fill(0.0);
    }

    /// Its first entries as `own`; the others are zero, and known to be.
    pub(super) fn begin_with(&mut self, own: &Self) {
        let n = own.mean.len();
        self.clear();
        self.mean[..n].copy_from_slice(&own.mean);
        let Symmetric { stride, data, .. } = &mut self.covariance;
        for (to, from) in data.chunks_exact_mut(*stride).zip(own.covariance.data.chunks_exact(own.covariance.stride)) {
            to[..n].copy_from_slice(&from[..n]);
        }
    }

    /// Takes over another belief of the same size, without allocating.
    #[inline(always)]
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.mean.copy_from_slice(&other.mean);
        self.covariance.data.copy_from_slice(&other.covariance.data);
    }
}
