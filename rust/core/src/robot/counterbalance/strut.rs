//! The force of a spring, or of a gas, along the line between two points.

use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;

/// What pulls two points together, or pushes them apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strut {
    /// A mechanical spring that pulls with k (ℓ − ℓ₀) and pushes where it is shorter.
    Spring {
        /// k [N/m].
        stiffness: f64,
        /// ℓ₀ [m], where it is slack; below zero where it pulls at any length, as one wound with pre-tension does.
        length: f64,
    },
    /// A cylinder with gas.
    Gas(GasSpring),
}

/// Gas behind a piston: p Vⁿ stays what it is, and the force is (p − p₀) A.
///
/// A strut that pushes is its own cylinder, whose gas fills what the rod leaves as it moves out. One that pulls presses
/// oil into an accumulator as it moves out, as under heavy arms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GasSpring {
    /// p at the length given [Pa], absolute.
    pub pressure: f64,
    /// V there [m³].
    pub volume: f64,
    /// The length at which both are given [m].
    pub length: f64,
    /// A [m²]: of the rod where it pushes, of the piston around the rod where it pulls.
    pub area: f64,
    /// n: 1 where heat has the time to leave, 1.4 of nitrogen where it has none.
    pub exponent: f64,
    /// p₀ outside [Pa].
    pub ambient: f64,
    /// Whether it pulls its ends together.
    pub pulls: bool,
}

impl Strut {
    /// # Errors
    /// A number that is not finite or out of its range.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let positive = |what, value: f64| {
            expect_of(value > 0.0 && value.is_finite(), what, || owner.into(), value, "greater than 0")
        };
        let (Self::Spring { length, .. } | Self::Gas(GasSpring { length, .. })) = *self;
        expect_of(length.is_finite(), "length", || owner.into(), length, "a finite number")?;
        match *self {
            Self::Spring { stiffness, .. } => positive("stiffness", stiffness),
            Self::Gas(GasSpring { pressure, volume, area, exponent, ambient, .. }) => {
                positive("pressure", pressure)?;
                positive("volume", volume)?;
                positive("area", area)?;
                expect_of((1.0..=2.0).contains(&exponent), "exponent", || owner.into(), exponent, "1 to 2")?;
                let fine = ambient >= 0.0 && ambient.is_finite();
                expect_of(fine, "ambient pressure", || owner.into(), ambient, "at least 0")
            }
        }
    }

    /// The force that pulls the ends together at length ℓ [m], and its slope [N, N/m]; NaN where no gas is left.
    ///
    /// ```
    /// use linkside_core::robot::{GasSpring, Strut};
    /// // A rod of 1 cm² out of a litre at 10 bar: pushed in by 5 m, which takes half of the volume, it pushes twice as hard.
    /// let gas = GasSpring { pressure: 1e6, volume: 1e-3, length: 6.0, area: 1e-4, exponent: 1.0, ambient: 0.0, pulls: false };
    /// let [(far, _), (near, _)] = [6.0, 1.0].map(|length| Strut::Gas(gas).tension(length));
    /// assert!((far + 100.0).abs() < 1e-9 && (near + 200.0).abs() < 1e-9);
    /// ```
    #[inline(always)]
    pub fn tension<T: Scalar>(&self, length: T) -> (T, T) {
        match *self {
            Self::Spring { stiffness, length: slack } => ((length + -slack) * stiffness, T::constant(stiffness)),
            Self::Gas(gas) => gas.tension(length),
        }
    }
}

impl GasSpring {
    /// With V = V₀ ± A (ℓ − ℓ₀): ∓ A (p − p₀), of slope A² n p / V.
    #[inline(always)]
    fn tension<T: Scalar>(&self, length: T) -> (T, T) {
        let out = if self.pulls { -self.area } else { self.area };
        let share = (length + -self.length) * (out / self.volume) + 1.0;
        let pressure = (share.ln() * -self.exponent).exp() * self.pressure;
        let slope = pressure * (self.area * self.area * self.exponent / self.volume) / share;
        ((pressure + -self.ambient) * -out, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::{Dual, Lanes, Series};

    fn struts() -> [Strut; 4] {
        let gas = |exponent, pulls| {
            let (pressure, volume, area) = (1.2e7, 9.6e-4, 1.7e-3);
            Strut::Gas(GasSpring { pressure, volume, length: 0.6, area, exponent, ambient: 1e5, pulls })
        };
        let spring = |length| Strut::Spring { stiffness: 2e4, length };
        [spring(0.3), spring(-0.1), gas(1.0, false), gas(1.35, true)]
    }

    #[test]
    fn slopes_are_derivatives_and_never_negative() {
        for (strut, x) in struts().iter().flat_map(|s| [0.45, 0.6, 0.7].map(|x| (s, x))) {
            let (force, slope) = strut.tension(x);
            let along = strut.tension(Dual::<1>::variable(x, 0)).0;
            assert!((along.gradient[0] - slope).abs() < 1e-12 * slope && along.value == force && slope > 0.0);
            assert_eq!(strut.tension(Lanes([x, 0.5])).0.0[0], force);
            let in_time = strut.tension(Series::<3>([x, 2.0, 0.5])).0;
            assert!((in_time.0[1] - 2.0 * slope).abs() < 1e-12 * slope);
        }
    }

    /// p Vⁿ by the platform's powers.
    #[test]
    #[allow(clippy::disallowed_methods)]
    fn gas_keeps_its_law() {
        let [.., Strut::Gas(gas)] = struts() else { panic!("a gas spring") };
        for x in [0.3_f64, 0.6, 0.9] {
            let pressure = 1.2e7 * (9.6e-4 / (9.6e-4 - 1.7e-3 * (x - 0.6))).powf(1.35);
            assert!((gas.tension(x).0 - 1.7e-3 * (pressure - 1e5)).abs() < 1e-8, "{x}");
        }
        assert!(gas.tension(1.2).0.is_nan());
    }

    #[test]
    fn forces_out_of_range_are_refused() {
        let Strut::Gas(gas) = struts()[2] else { panic!("a gas spring") };
        let said = |gas| Strut::Gas(gas).check("it").unwrap_err().to_string();
        assert!(said(GasSpring { volume: 0.0, ..gas }).contains("volume of it is 0, expected greater than 0"));
        assert!(said(GasSpring { exponent: 0.9, ..gas }).contains("exponent of it is 0.9, expected 1 to 2"));
        assert!(said(GasSpring { ambient: -1.0, ..gas }).contains("ambient pressure of it is -1"));
        let weak = Strut::Spring { stiffness: 0.0, length: 1.0 }.check("it").unwrap_err();
        assert!(weak.to_string().contains("stiffness of it is 0"));
        assert!(struts().iter().all(|strut| strut.check("it").is_ok()));
    }
}
