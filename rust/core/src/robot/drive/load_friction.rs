//! Friction that grows with the torque that is transmitted: efficiency of gears, bearings under load.

use super::friction::direction;
use crate::check::expect_of;
use crate::error::RobotError;
use crate::scalar::Scalar;

/// Friction of a gear or a bearing as a share of the torque τ through it, against its motion.
///
/// With s the smoothed sign of the speed v and |τ| = √(τ² + ρ²): ½(μ₊ + μ₋)|τ| s + ½(μ₊ − μ₋) τ s², which is μ₊|τ| against
/// the motion where the shaft drives (τ v > 0) and μ₋|τ| where it is driven. A gear of efficiency η that takes τ/η to
/// give τ has μ₊ = 1/η − 1, driven back one that gives η′ τ has μ₋ = 1 − η′.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadFriction {
    /// μ₊.
    pub driving: f64,
    /// μ₋, below 1: one of more does not turn back.
    pub driven: f64,
    /// ρ [N m]: a torque that counts for none.
    pub rounding: f64,
}

/// A friction torque and its slopes by speed and by the torque that is transmitted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Loss<T> {
    /// [N m].
    pub torque: T,
    /// [N m s/rad].
    pub by_speed: T,
    /// A share.
    pub by_load: T,
}

impl LoadFriction {
    /// # Errors
    /// A share that is negative, or so great that nothing turns back; a rounding that is not positive beside one.
    pub(super) fn check(&self, owner: &str) -> Result<(), RobotError> {
        let Self { driving, driven, rounding } = *self;
        let owner = || owner.to_string();
        let fine = driving >= 0.0 && driving.is_finite();
        expect_of(fine, "load friction where it drives", owner, driving, "at least 0")?;
        let fine = (0.0..1.0).contains(&driven);
        expect_of(fine, "load friction where it is driven", owner, driven, "at least 0 and less than 1")?;
        let fine = self.is_none() || rounding > 0.0 && rounding.is_finite();
        expect_of(fine, "rounding of load friction", owner, rounding, "greater than 0")
    }

    /// Whether there is none.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.driving == 0.0 && self.driven == 0.0
    }

    /// At `speed` [rad/s] under the transmitted torque `load` [N m].
    ///
    /// ```
    /// use linkside_core::robot::LoadFriction;
    /// // A gear that drives with 80 % and is driven with 70 %.
    /// let gear = LoadFriction { driving: 0.25, driven: 0.3, rounding: 1e-6 };
    /// let [up, down] = [1.0, -1.0].map(|speed| gear.loss(speed, 40.0).torque);
    /// assert!((up - 10.0).abs() < 1e-3 && (down + 12.0).abs() < 1e-3);
    /// ```
    #[inline(always)]
    pub fn loss<T: Scalar>(&self, speed: T, load: T) -> Loss<T> {
        if self.is_none() {
            return Loss::default();
        }
        let (mean, half) = (0.5 * (self.driving + self.driven), 0.5 * (self.driving - self.driven));
        let (sign, turning) = direction(speed);
        let size = self.size(load);
        let square = sign * sign;
        Loss {
            torque: size * sign * mean + load * square * half,
            by_speed: (size * mean + load * sign * (2.0 * half)) * turning,
            by_load: load / size * sign * mean + square * half,
        }
    }

    /// At `speed`, where all but this friction needs the torque `rest`: of τ = rest + μ|τ| s. The slope `by_load` is by `rest`.
    ///
    /// Where driving and being driven are alike, as in a bearing, this is a quadratic equation: with m = μ s,
    /// (1 − m²) τ = rest + m √(rest² + (1 − m²) ρ²).
    #[inline(always)]
    pub fn loss_beside<T: Scalar>(&self, speed: T, rest: T) -> Loss<T> {
        if self.is_none() {
            return Loss::default();
        }
        let (sign, turning) = direction(speed);
        let share = sign * self.driving;
        let left = -(share * share) + 1.0;
        let root = (rest * rest + left * (self.rounding * self.rounding)).sqrt();
        let torque = share * (root + share * rest) / left;
        let load = rest + torque;
        let size = self.size(load);
        // τ′ (1 − m τ/|τ|) = rest′ + |τ| m′.
        let gain = T::constant(1.0) / (-(share * load / size) + 1.0);
        Loss { torque, by_speed: size * turning * gain * self.driving, by_load: gain + -1.0 }
    }

    /// |τ|.
    #[inline(always)]
    fn size<T: Scalar>(&self, load: T) -> T {
        (load * load + self.rounding * self.rounding).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    const GEAR: LoadFriction = LoadFriction { driving: 0.3, driven: 0.15, rounding: 0.05 };
    const BEARING: LoadFriction = LoadFriction { driving: 0.2, driven: 0.2, rounding: 0.05 };

    fn cases() -> impl Iterator<Item = (f64, f64)> {
        [-1.0, -1e-3, 0.0, 4e-4, 0.3].into_iter().flat_map(|v| [-60.0, -0.02, 0.0, 3.0].map(|load| (v, load)))
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_laws() {
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * (1.0 + a.abs()), "{a} {b}");
        for (v, load) in cases() {
            let [x, y] = [Dual::<2>::variable(v, 0), Dual::variable(load, 1)];
            for (dual, plain) in [
                (GEAR.loss(x, y), GEAR.loss(v, load)),
                (BEARING.loss(x, y), BEARING.loss(v, load)),
                (BEARING.loss_beside(x, y), BEARING.loss_beside(v, load)),
            ] {
                near(dual.torque.value, plain.torque);
                near(dual.torque.gradient[0], plain.by_speed);
                near(dual.torque.gradient[1], plain.by_load);
            }
        }
    }

    #[test]
    fn what_is_left_for_the_load_is_what_was_asked_for() {
        for (v, load) in cases() {
            let all = load + BEARING.loss_beside(v, load).torque;
            assert!((all - BEARING.loss(v, all).torque - load).abs() < 1e-13 * (1.0 + load.abs()), "{v} {load}");
        }
    }

    #[test]
    fn it_never_gives_power() {
        for (v, load) in cases() {
            assert!(GEAR.loss(v, load).torque * v >= 0.0, "{v} {load}");
        }
    }

    #[test]
    fn shares_out_of_range_are_refused() {
        let said = |law: LoadFriction| law.check("it").unwrap_err().to_string();
        assert!(said(LoadFriction { driving: -0.1, ..GEAR }).contains("where it drives of it is -0.1"));
        assert!(
            said(LoadFriction { driven: 1.0, ..GEAR })
                .contains("where it is driven of it is 1, expected at least 0 and")
        );
        assert!(said(LoadFriction { rounding: 0.0, ..GEAR }).contains("rounding of load friction of it is 0"));
        assert!(GEAR.check("it").is_ok() && LoadFriction::default().check("it").is_ok());
    }
}
