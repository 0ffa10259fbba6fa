//! Densities of a reading's noise: what outliers do to them.

use super::cloud::Wide;
use crate::error::DesignError;
use crate::scalar::{Scalar, ln};

/// Density of one channel's noise, relative to the variance that the noise has without outliers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Density {
    /// No outliers.
    Normal,
    /// Student's.
    Student {
        /// Degrees of freedom.
        dof: f64,
    },
    /// A normal density, and for a share of the readings a wider one.
    Mixture {
        /// Share of the readings that are outliers.
        share: f64,
        /// Standard deviation of outliers, in multiples of the noise's.
        scale: f64,
    },
}

impl Density {
    pub(super) fn is_normal(self) -> bool {
        self == Self::Normal
    }

    /// # Errors
    /// Parameters for which there is no such density.
    pub(super) fn check(self) -> Result<(), DesignError> {
        let (ok, value, expected) = match self {
            Self::Normal => return Ok(()),
            Self::Student { dof } => (dof >= 1.0 && dof.is_finite(), dof, "at least 1 degree of freedom"),
            Self::Mixture { share, .. } if !(share > 0.0 && share < 1.0) => (false, share, "a share between 0 and 1"),
            Self::Mixture { scale, .. } => (scale > 1.0 && scale.is_finite(), scale, "outliers wider than the noise"),
        };
        if ok { Ok(()) } else { Err(DesignError::Range { what: "outliers", value, expected }) }
    }

    /// Precision of the normal density with the same slope at `error`.
    #[inline(always)]
    pub(super) fn precision(self, error: Wide, variance: f64) -> Wide {
        match self {
            Self::Normal => Wide::constant(1.0 / variance),
            Self::Student { dof } => Wide::constant(dof + 1.0) / (error * error + dof * variance),
            Self::Mixture { share, scale } => {
                let narrow = narrow(error * error * (1.0 / variance), share, scale);
                let wide = share / scale;
                let least = 1.0 / (scale * scale);
                (narrow + wide * least) / (narrow + wide) * (1.0 / variance)
            }
        }
    }

    /// Logarithm of the density at `error`, less [`log_factor`](Self::log_factor).
    #[inline(always)]
    pub(super) fn log_shape(self, error: Wide, variance: f64) -> Wide {
        let square = error * error * (1.0 / variance);
        match self {
            Self::Normal => square * -0.5,
            Self::Student { dof } => (square * (1.0 / dof) + 1.0).map(ln) * (-0.5 * (dof + 1.0)),
            Self::Mixture { share, scale } => {
                (narrow(square, share, scale) + share / scale).map(ln) - square * (0.5 / (scale * scale))
            }
        }
    }

    /// Logarithm of the density's constant factor.
    pub(super) fn log_factor(self, variance: f64) -> f64 {
        match self {
            Self::Normal | Self::Mixture { .. } => -0.5 * ln(core::f64::consts::TAU * variance),
            Self::Student { dof } => {
                let scale = core::f64::consts::PI * dof * variance;
                log_gamma(0.5 * (dof + 1.0)) - log_gamma(0.5 * dof) - 0.5 * ln(scale)
            }
        }
    }
}

/// The narrow part of a mixture over the exponential of the wide one, which never overflows.
#[inline(always)]
fn narrow(square: Wide, share: f64, scale: f64) -> Wide {
    (square * (-0.5 * (1.0 - 1.0 / (scale * scale)))).exp() * (1.0 - share)
}

/// Student's log-density of n dimensions negated, less the same of the normal one's constant.
#[inline(always)]
pub(super) fn student_term(square: Wide, dof: f64, n: usize) -> Wide {
    let n = n as f64;
    // Γ((ν+n)/2)/Γ(ν/2) over (ν/2)^(n/2), by recurrence from half-integers.
    let constant = log_gamma(0.5 * (dof + n)) - log_gamma(0.5 * dof) - 0.5 * n * ln(0.5 * dof);
    (square * (1.0 / dof) + 1.0).map(ln) * (0.5 * (dof + n)) + -constant
}

/// ln Γ(x) by Stirling's series above 12 and recurrence below.
fn log_gamma(x: f64) -> f64 {
    let (mut y, mut product) = (x, 1.0);
    while y < 12.0 {
        product *= y;
        y += 1.0;
    }
    let z = 1.0 / (y * y);
    let series = (1.0 / 12.0 - z * (1.0 / 360.0 - z * (1.0 / 1260.0 - z / 1680.0))) / y;
    (y - 0.5) * ln(y) - y + 0.5 * ln(core::f64::consts::TAU) + series - ln(product)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DENSITIES: [Density; 4] = [
        Density::Normal,
        Density::Student { dof: 4.0 },
        Density::Mixture { share: 0.02, scale: 50.0 },
        Density::Mixture { share: 0.5, scale: 2.0 },
    ];

    fn log_density(density: Density, error: f64, variance: f64) -> f64 {
        density.log_shape(Wide::constant(error), variance).0[0] + density.log_factor(variance)
    }

    #[test]
    fn densities_integrate_to_one() {
        for density in DENSITIES {
            // x = s tan φ takes the whole line to an interval.
            let (count, variance) = (20_000, 0.3_f64);
            let step = core::f64::consts::PI / f64::from(count);
            let sum: f64 = (0..count)
                .map(|i| {
                    let (sin, cos) = ((f64::from(i) + 0.5) * step - core::f64::consts::FRAC_PI_2).sin_cos();
                    let jacobian = variance.sqrt() / (cos * cos);
                    log_density(density, variance.sqrt() * sin / cos, variance).exp() * jacobian * step
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-6, "{density:?}: {sum}");
        }
    }

    #[test]
    fn precision_is_the_slope_over_the_error() {
        for density in DENSITIES {
            for error in [0.01, 0.3, 1.7, 4.0, 30.0] {
                let (variance, h) = (0.3, 1e-5 * error);
                let slope = (log_density(density, error - h, variance) - log_density(density, error + h, variance))
                    / (2.0 * h * error);
                let precision = density.precision(Wide::constant(error), variance).0[0];
                assert!((precision / slope - 1.0).abs() < 1e-6, "{density:?} at {error}: {precision}, {slope}");
            }
        }
    }

    #[test]
    fn absurd_readings_leave_finite_numbers() {
        for density in &DENSITIES[1..] {
            assert!(log_density(*density, 1e9, 1e-6).is_finite());
            assert!(density.precision(Wide::constant(1e9), 1e-6).0[0].is_finite());
        }
    }
}
