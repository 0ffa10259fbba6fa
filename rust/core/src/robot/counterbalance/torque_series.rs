//! A torque that is a function of an angle: a Fourier series.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;

/// One harmonic of a torque over an angle α: c cos kα + s sin kα.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TorqueHarmonic {
    /// k, cycles a turn; 0 for a torque that is always there.
    pub order: u32,
    /// c [N m].
    pub cosine: f64,
    /// s [N m].
    pub sine: f64,
}

/// The sum of such harmonics.
///
/// ```
/// use linkside_core::robot::{TorqueHarmonic, TorqueSeries};
/// let series = TorqueSeries(vec![TorqueHarmonic { order: 2, cosine: 3.0, sine: 4.0 }]);
/// let (torque, slope) = series.torque(0.3_f64.sin_cos());
/// assert!((torque - 3.0 * 0.6_f64.cos() - 4.0 * 0.6_f64.sin()).abs() < 1e-14);
/// assert!((slope + 6.0 * 0.6_f64.sin() - 8.0 * 0.6_f64.cos()).abs() < 1e-14);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TorqueSeries(pub Vec<TorqueHarmonic>);

/// Harmonics are found by turning on and on, so that errors of rounding grow with their order.
const MOST: u32 = 100;

impl TorqueSeries {
    /// # Errors
    /// A number that is not finite, an order of more than a hundred.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        for TorqueHarmonic { order, cosine, sine } in &self.0 {
            let sum = cosine + sine;
            expect_of(*order <= MOST, "order", || owner.into(), f64::from(*order), "at most 100")?;
            expect_of(sum.is_finite(), "torque", || owner.into(), sum, "a finite number")?;
        }
        Ok(())
    }

    /// Torque and its slope at the angle of this sine and cosine [N m, N m/rad].
    #[inline(always)]
    pub fn torque<T: Scalar>(&self, turn: (T, T)) -> (T, T) {
        let (mut torque, mut slope) = (T::default(), T::default());
        for TorqueHarmonic { order, cosine, sine } in &self.0 {
            let (sin, cos) = (0..*order).fold((T::default(), T::constant(1.0)), |at, _| add_angles(at, turn));
            torque += cos * *cosine + sin * *sine;
            slope += (cos * *sine - sin * *cosine) * f64::from(*order);
        }
        (torque, slope)
    }
}

/// Sine and cosine of the sum of two angles.
#[inline(always)]
pub(crate) fn add_angles<T: Scalar>((sin, cos): (T, T), (sine, cosine): (T, T)) -> (T, T) {
    (sin * cosine + cos * sine, cos * cosine - sin * sine)
}
