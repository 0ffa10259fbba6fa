//! Densities of readings' noise: the normal one, and those that expect outliers.

use super::cloud::Wide;
use crate::check::expect;
use crate::error::DesignError;
use crate::scalar::{Scalar, ln};
use core::f64::consts::{PI, TAU};

/// Density of a channel's noise, about zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Density {
    /// Normal, with the channel's own variance.
    Normal,
    /// Student's, the variance that of the normal density it tends to.
    Student {
        /// ν, at least 1.
        freedom: f64,
    },
    /// (1 − share) N(0, σ²) + share N(0, (scale σ)²), σ² the channel's own variance.
    Mixture {
        /// Probability of an outlier, between 0 and 1.
        share: f64,
        /// Standard deviation of outliers in units of σ, above 1.
        scale: f64,
    },
}

impl Density {
    /// Whether it is the normal one, with which a bias stays normal.
    pub fn is_normal(&self) -> bool {
        *self == Self::Normal
    }

    /// # Errors
    /// A parameter out of its range.
    pub(super) fn check(&self) -> Result<(), DesignError> {
        let range = |ok, value, expected| expect(ok, "outliers", value, expected);
        match *self {
            Self::Normal => Ok(()),
            Self::Student { freedom } => range(
                (1.0..f64::INFINITY).contains(&freedom),
                freedom,
                "at least 1 degree of freedom, and finitely many",
            ),
            Self::Mixture { share, scale } => {
                range(share > 0.0 && share < 1.0, share, "a share between 0 and 1")?;
                range(scale > 1.0 && scale < 1e12, scale, "a scale above 1 and below 1e12")
            }
        }
    }

    /// At one `variance`, ready to be evaluated.
    pub(super) fn of_variance(self, variance: f64) -> NoiseDensity {
        let constant = match self {
            Self::Normal => -0.5 * ln(TAU * variance),
            Self::Student { freedom } => {
                log_gamma(0.5 * (freedom + 1.0)) - log_gamma(0.5 * freedom) - 0.5 * ln(PI * freedom * variance)
            }
            Self::Mixture { share, .. } => ln(1.0 - share) - 0.5 * ln(TAU * variance),
        };
        NoiseDensity { density: self, variance, constant, odds: self.log_odds() }
    }

    /// Logarithm of an outlier's density over that of its contrary, at zero.
    fn log_odds(&self) -> f64 {
        match *self {
            Self::Mixture { share, scale } => ln(share / (1.0 - share)) - ln(scale),
            _ => 0.0,
        }
    }
}

/// A density of given variance.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseDensity {
    /// Its kind.
    density: Density,
    /// σ², of a mixture that of its first part.
    pub(super) variance: f64,
    /// Logarithm of the density's factor; of a mixture that of its first part.
    constant: f64,
    /// See [`Density::log_odds`].
    odds: f64,
}

impl NoiseDensity {
    /// log p(error).
    #[inline(always)]
    pub(super) fn log_density(&self, error: Wide) -> Wide {
        let square = error * error * (1.0 / self.variance);
        match self.density {
            Density::Normal => square * -0.5 + self.constant,
            Density::Student { freedom } => {
                (square * (1.0 / freedom) + 1.0).map(ln) * (-0.5 * (freedom + 1.0)) + self.constant
            }
            Density::Mixture { scale, .. } => square * -0.5 + self.constant + self.excess(square, scale).map(log_sum),
        }
    }

    /// 1/σ² of the normal density with the same slope at `error`.
    #[inline(always)]
    pub(super) fn precision(&self, error: Wide) -> Wide {
        match self.density {
            Density::Normal => Wide::constant(1.0 / self.variance),
            Density::Student { freedom } => Wide::constant(freedom + 1.0) / (error * error + freedom * self.variance),
            Density::Mixture { scale, .. } => {
                let square = error * error * (1.0 / self.variance);
                let other = 1.0 / (scale * scale);
                let own = self.excess(square, scale).map(|log| 1.0 / (1.0 + Scalar::exp(log.min(700.0))));
                (own * (1.0 - other) + other) * (1.0 / self.variance)
            }
        }
    }

    /// Logarithm of a mixture's second part over its first, where `square` is the error's in units of the variance.
    #[inline(always)]
    fn excess(&self, square: Wide, scale: f64) -> Wide {
        square * (0.5 * (1.0 - 1.0 / (scale * scale))) + self.odds
    }
}

/// ln(1 + eˣ).
fn log_sum(x: f64) -> f64 {
    x.max(0.0) + ln(1.0 + Scalar::exp(-x.abs()))
}

/// ln Γ(x) by Stirling's series above 12 and recurrence below.
pub(super) fn log_gamma(x: f64) -> f64 {
    let (mut y, mut product) = (x, 1.0);
    while y < 12.0 {
        product *= y;
        y += 1.0;
    }
    let z = 1.0 / (y * y);
    let series = (1.0 / 12.0 - z * (1.0 / 360.0 - z * (1.0 / 1260.0 - z / 1680.0))) / y;
    (y - 0.5) * ln(y) - y + 0.5 * ln(TAU) + series - ln(product)
}
