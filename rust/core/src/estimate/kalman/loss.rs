//! How much a sensor's readings count, by how far they are from what is estimated.
//!
//! A loss ρ of a sensor's m readings is a function of r² = eᵀ R⁻¹ e alone. Its minimum is found by least squares with R/w(r)
//! in place of R, w being that of the estimate before (P. W. Holland and R. E. Welsch 1977):
//!
//! | | ρ | w |
//! | --- | --- | --- |
//! | [`Squares`](NoiseLoss::Squares) | r²/2 | 1 |
//! | [`Huber`](NoiseLoss::Huber) (P. J. Huber 1964) | r²/2 to r = c, then c r − c²/2 | min(1, c/r) |
//! | [`StudentT`](NoiseLoss::StudentT) (K. L. Lange et al. 1989) | (ν + m)/2 · ln(1 + r²/ν) | (ν + m)/(ν + r²) |

use super::model::Model;
use crate::check::expect_length;
use crate::error::DesignError;
use crate::estimate::measurement::Channel;
use crate::scalar::log;
use core::ops::Range;

/// Bound of Huber's squares: 5 % is lost on Gaussian noise.
const BOUND: f64 = 1.345;
/// Degrees of freedom of Student's t.
const FREEDOM: f64 = 4.0;
/// A sensor that counts less than this is said to be left out.
pub(super) const LEFT_OUT: f64 = 0.1;

/// What an error of a sensor's readings costs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoiseLoss {
    /// Half its square: noise is Gaussian.
    #[default]
    Squares,
    /// Huber's: absolute beyond 1.345 standard deviations. Convex, so that an estimate by it is the only one.
    Huber,
    /// That of Student's t with four degrees of freedom: an outlier is forgotten the more the further it is.
    StudentT,
}

impl NoiseLoss {
    /// All, with their names.
    const ALL: [(&'static str, Self); 3] =
        [("squares", Self::Squares), ("huber", Self::Huber), ("student-t", Self::StudentT)];

    /// The loss of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find_map(|(own, loss)| (own == name).then_some(loss))
    }

    /// ρ of `size` readings with this r².
    #[inline(always)]
    pub(super) fn cost(self, squared: f64, size: f64) -> f64 {
        match self {
            Self::Huber if squared > BOUND * BOUND => BOUND * squared.sqrt() - 0.5 * BOUND * BOUND,
            Self::Squares | Self::Huber => 0.5 * squared,
            Self::StudentT => 0.5 * (FREEDOM + size) * log(1.0 + squared / FREEDOM),
        }
    }

    /// w of `size` readings with this r².
    #[inline(always)]
    pub(super) fn weight(self, squared: f64, size: f64) -> f64 {
        match self {
            Self::Squares => 1.0,
            Self::Huber => (BOUND / squared.sqrt()).min(1.0),
            Self::StudentT => (FREEDOM + size) / (FREEDOM + squared),
        }
    }

    /// The convex loss to begin with.
    fn convex(self) -> Self {
        if self == Self::StudentT { Self::Huber } else { self }
    }
}

/// The sensors of a model, each with its channels and its loss: what hits one axis usually hits all.
#[derive(Clone, Debug)]
pub(super) struct SensorLosses {
    list: Vec<(Range<usize>, NoiseLoss)>,
}

impl SensorLosses {
    /// # Errors
    /// Not one loss a channel.
    pub(super) fn new(model: &impl Model, losses: &[NoiseLoss]) -> Result<Self, DesignError> {
        let channels = model.channel_kinds();
        expect_length("losses", losses.len(), channels.len())?;
        let mut list: Vec<(Range<usize>, NoiseLoss)> = Vec::with_capacity(channels.len());
        for (i, (channel, &loss)) in channels.iter().zip(losses).enumerate() {
            match list.last_mut() {
                Some((own, _)) if same(channels[own.start], *channel) => own.end = i + 1,
                _ => list.push((i..i + 1, loss)),
            }
        }
        Ok(Self { list })
    }

    /// All losses squares.
    pub(super) fn of_squares(model: &impl Model) -> Self {
        let list = (0..model.channels()).map(|i| (i..i + 1, NoiseLoss::Squares)).collect();
        Self { list }
    }

    /// Whether some weight may differ from 1.
    #[inline(always)]
    pub(super) fn is_robust(&self) -> bool {
        self.list.iter().any(|(_, loss)| *loss != NoiseLoss::Squares)
    }

    /// The same with convex losses; none where they are.
    pub(super) fn convex(&self) -> Option<Self> {
        let list = self.list.iter().map(|(channels, loss)| (channels.clone(), loss.convex())).collect();
        self.list.iter().any(|(_, loss)| *loss != loss.convex()).then_some(Self { list })
    }

    /// Σ ρ, and w of each channel, for errors squared over their variances, NaN where there is no reading (channels).
    #[inline(always)]
    pub(super) fn weigh(&self, squares: &[f64], weights: &mut [f64]) -> f64 {
        let mut cost = 0.0;
        for (channels, loss) in &self.list {
            let (mut sum, mut size) = (0.0, 0.0);
            for square in squares[channels.clone()].iter().filter(|square| !square.is_nan()) {
                (sum, size) = (sum + square, size + 1.0);
            }
            cost += loss.cost(sum, size);
            weights[channels.clone()].fill(loss.weight(sum, size));
        }
        cost
    }
}

/// Whether two channels are axes of one sensor.
fn same(a: Channel, b: Channel) -> bool {
    match (a, b) {
        (Channel::Acceleration { sensor: a, .. }, Channel::Acceleration { sensor: b, .. })
        | (Channel::Rate { sensor: a, .. }, Channel::Rate { sensor: b, .. })
        | (Channel::Position { sensor: a, .. }, Channel::Position { sensor: b, .. }) => a == b,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weight_is_the_slope_of_its_cost() {
        // dρ/d(r²) = w/2, which is what makes reweighted least squares a descent of ρ.
        for loss in [NoiseLoss::Squares, NoiseLoss::Huber, NoiseLoss::StudentT] {
            for squared in [1e-3, 0.5, 1.7, 2.0, 9.0, 2500.0] {
                for size in [1.0, 3.0] {
                    let h = 1e-6 * squared;
                    let slope = (loss.cost(squared + h, size) - loss.cost(squared - h, size)) / (2.0 * h);
                    assert!((slope - 0.5 * loss.weight(squared, size)).abs() < 1e-7, "{loss:?} {squared} {slope}");
                }
            }
        }
    }

    #[test]
    fn all_have_names() {
        for (name, loss) in NoiseLoss::ALL {
            assert_eq!(NoiseLoss::named(name), Some(loss));
        }
        assert_eq!(NoiseLoss::named("cauchy"), None);
    }
}
