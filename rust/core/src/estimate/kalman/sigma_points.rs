//! Sigma points: a function of a Gaussian belief by its values at a few points in place of derivatives.
//!
//! With P = Σ uᵢuᵢᵀ over d directions, the points are x̂ ± √d uᵢ, each of weight 1/2d (I. Arasaratnam and S. Haykin, IEEE Trans. Automatic
//! Control 54, 2009). What the values have that is odd in a direction is a slope, what is even a curvature:
//!
//! | of the function | is |
//! | --- | --- |
//! | mean | (1/2d) Σ (y⁺ᵢ + y⁻ᵢ) |
//! | slope A | that of the regression on x: A uᵢ = (y⁺ᵢ − y⁻ᵢ)/2√d |
//! | covariance of what A leaves, Ω | (1/d) Σ eᵢeᵢᵀ, eᵢ = (y⁺ᵢ + y⁻ᵢ)/2 − mean |
//!
//! so that its covariance A P Aᵀ + Ω is a sum of squares. The unscented rule (S. J. Julier and J. K. Uhlmann, Proc. IEEE 92, 2004; α = 1, β = 2,
//! κ = 0) adds 2 e₀e₀ᵀ of the centre: then Ω of a square of one Gaussian number is its variance. A filter that takes the mean, A and Ω
//! for its linearised function is the unscented or cubature Kalman filter (T. Lefebvre, H. Bruyninckx and J. De Schutter, IEEE Trans.
//! Automatic Control 47, 2002).

use super::gaussian::Symmetric;
use crate::linear;

/// Which points, and how they count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SigmaRule {
    /// With the centre.
    Unscented,
    /// Without.
    Cubature,
}

impl SigmaRule {
    /// By its name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "unscented" => Some(Self::Unscented),
            "cubature" => Some(Self::Cubature),
            _ => None,
        }
    }

    /// Weight of the centre in Ω.
    fn of_centre(self) -> Option<f64> {
        (self == Self::Unscented).then_some(2.0)
    }
}

/// The regression of a function's values on its argument; see the module.
#[derive(Clone, Debug)]
pub(super) struct SigmaPoints {
    rule: SigmaRule,
    /// Numbers in an argument, and from one row of directions to the next.
    inputs: usize,
    stride: usize,
    /// uᵢ, a padded row each.
    directions: Vec<f64>,
    /// A point.
    point: Vec<f64>,
    /// y⁺ and then (y⁺ − y⁻)/2√d, and y⁻ and then eᵢ, a padded row for each direction.
    odd: Vec<f64>,
    even: Vec<f64>,
    /// e₀.
    centre: Vec<f64>,
    /// Mean of the values.
    pub(super) mean: Vec<f64>,
    /// Ω.
    pub(super) residual: Symmetric,
}

impl SigmaPoints {
    pub(super) fn new(rule: SigmaRule, inputs: usize, outputs: usize) -> Self {
        let (stride, residual) = (inputs.next_multiple_of(linear::LANES), Symmetric::zeros(outputs));
        let values = || vec![0.0; stride * residual.stride];
        Self {
            rule,
            inputs,
            stride,
            directions: vec![0.0; stride * stride],
            point: vec![0.0; inputs],
            odd: values(),
            even: values(),
            centre: vec![0.0; residual.stride],
            mean: vec![0.0; outputs],
            residual,
        }
    }

    /// The mean and Ω of `function` at a belief of this mean, whose covariance's first rows and columns are those of the argument.
    #[inline(always)]
    pub(super) fn evaluate(
        &mut self,
        mean: &[f64],
        covariance: &Symmetric,
        mut function: impl FnMut(&[f64], &mut [f64]),
    ) {
        let (d, m, width) = (self.inputs, self.mean.len(), self.residual.stride);
        let reach = (d as f64).sqrt();
        let rows = self.directions.chunks_exact_mut(self.stride).zip(covariance.data.chunks_exact(covariance.stride));
        for (row, from) in rows.take(d) {
            row[..d].copy_from_slice(&from[..d]);
        }
        // What is known, or follows from the states before it, has no direction of its own.
        linear::upper_factor(&mut self.directions, d, self.stride);
        self.mean.fill(0.0);
        for i in 0..d {
            let u = &self.directions[i * self.stride..][..d];
            let (odd, even) = (&mut self.odd[i * width..][..m], &mut self.even[i * width..][..m]);
            for (values, sign) in [(&mut *odd, reach), (&mut *even, -reach)] {
                for ((point, x), u) in self.point.iter_mut().zip(mean).zip(u) {
                    *point = x + sign * u;
                }
                function(&self.point, values);
            }
            for ((odd, even), mean) in odd.iter_mut().zip(even).zip(&mut self.mean) {
                let (forth, back) = (*odd, *even);
                *odd = (forth - back) / (2.0 * reach);
                *even = 0.5 * (forth + back);
                *mean += *even / d as f64;
            }
        }
        self.residual.data.fill(0.0);
        for even in self.even.chunks_exact_mut(width).take(d) {
            even.iter_mut().zip(&self.mean).for_each(|(even, mean)| *even -= mean);
        }
        self.residual.add_squares(1.0 / d as f64, &self.even);
        if let Some(weight) = self.rule.of_centre() {
            function(mean, &mut self.centre[..m]);
            self.centre.iter_mut().zip(&self.mean).for_each(|(centre, mean)| *centre -= mean);
            self.residual.add_squares(weight, &self.centre);
        }
    }

    /// From the derivative H of the function at the mean (outputs × inputs, in rows of `width`) to A.
    ///
    /// In a direction that the belief does not have, A is H.
    #[inline(always)]
    pub(super) fn correct(&mut self, slopes: &mut [f64], width: usize) {
        let (d, own) = (self.inputs, self.residual.stride);
        for (odd, u) in self.odd.chunks_exact_mut(own).zip(self.directions.chunks_exact(self.stride)).take(d) {
            for (odd, row) in odd.iter_mut().zip(slopes.chunks_exact(width)) {
                *odd -= linear::dot(&row[..d], u);
            }
        }
        // (A − H) Uᵀ is `odd` turned, for U of rows uᵢ.
        linear::backward(&self.directions, self.stride, &mut self.odd, own);
        for (k, more) in self.odd.chunks_exact(own).enumerate().take(d) {
            for (row, more) in slopes.chunks_exact_mut(width).zip(more) {
                row[k] += more;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P of two correlated numbers.
    fn covariance() -> Symmetric {
        let mut p = Symmetric::zeros(2);
        p.put(0, 0, 0.04);
        p.put(0, 1, 0.01);
        p.put(1, 1, 0.09);
        p
    }

    #[test]
    fn a_linear_function_has_its_slope_and_no_more() {
        let mut points = SigmaPoints::new(SigmaRule::Unscented, 2, 1);
        points.evaluate(&[1.0, -2.0], &covariance(), |x, y| y[0] = 3.0 * x[0] - 0.5 * x[1] + 7.0);
        let mut slopes = [0.0, 0.0];
        points.correct(&mut slopes, 2);
        assert!((points.mean[0] - 11.0).abs() < 1e-14);
        assert!((slopes[0] - 3.0).abs() < 1e-13 && (slopes[1] + 0.5).abs() < 1e-13, "{slopes:?}");
        assert!(points.residual.at(0, 0) < 1e-28);
    }

    /// Of x² of variance s² about 0: mean s², slope 0, variance 2 s⁴.
    #[test]
    fn a_square_has_its_own_variance() {
        let mut points = SigmaPoints::new(SigmaRule::Unscented, 1, 1);
        let mut p = Symmetric::zeros(1);
        p.put(0, 0, 0.25);
        points.evaluate(&[0.0], &p, |x, y| y[0] = x[0] * x[0]);
        let mut slope = [0.3];
        points.correct(&mut slope, 1);
        assert!((points.mean[0] - 0.25).abs() < 1e-15 && slope[0].abs() < 1e-15);
        assert!((points.residual.at(0, 0) - 2.0 * 0.0625).abs() < 1e-15);
    }

    #[test]
    fn a_direction_that_is_known_keeps_its_derivative() {
        let mut points = SigmaPoints::new(SigmaRule::Cubature, 2, 1);
        let mut p = Symmetric::zeros(2);
        p.put(1, 1, 0.01);
        points.evaluate(&[1.0, 2.0], &p, |x, y| y[0] = 5.0 * x[0] + x[1]);
        let mut slopes = [5.0, 0.0];
        points.correct(&mut slopes, 2);
        assert!((slopes[0] - 5.0).abs() < 1e-14 && (slopes[1] - 1.0).abs() < 1e-13);
    }
}
