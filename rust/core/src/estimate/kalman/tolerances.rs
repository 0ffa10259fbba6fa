//! How well a robot's numbers are known, one by one and together.

use super::uncertain::Tolerance;
use crate::check::{LARGEST, expect};
use crate::error::DesignError;
use crate::linear;
use core::ops::Deref;

/// Rounding of a file's digits may leave correlations so far from a matrix that is positive semi-definite.
const ROUNDING: f64 = 1e-9;

/// Numbers of a robot that are known to a tolerance only, and how the errors of some go together.
///
/// ```
/// use linkside_core::estimate::kalman::{Tolerance, Tolerances, Uncertain};
///
/// // What a link is heavier is what its spring is stiffer: a resonance tells their ratio.
/// let of = |parameter| Tolerance { parameter, std: 0.1 };
/// let each = vec![of(Uncertain::Stiffness(0)), of(Uncertain::Mass(0))];
/// assert!(Tolerances::correlated(each.clone(), vec![(0, 1, 0.999)]).is_ok());
/// assert!(Tolerances::correlated(each, vec![(0, 1, 1.1)]).is_err());
/// ```
#[derive(Clone, Debug, Default)]
pub struct Tolerances {
    each: Vec<Tolerance>,
    /// Two of them, and their correlation; every pair once, others being independent.
    correlations: Vec<(usize, usize, f64)>,
}

impl Tolerances {
    /// Of numbers whose errors are correlated, pair by pair.
    ///
    /// # Errors
    /// A pair that is not of two of `each`, is there twice or is of a number that changes with time; a correlation outside
    /// −1 to 1; correlations that no errors have together.
    pub fn correlated(each: Vec<Tolerance>, correlations: Vec<(usize, usize, f64)>) -> Result<Self, DesignError> {
        each.iter().try_for_each(|one| expect(one.std.abs() <= LARGEST, "a tolerance", one.std, "at most 1e100"))?;
        let n = each.len();
        let mut matrix = vec![0.0; n * n];
        matrix.iter_mut().step_by(n + 1).for_each(|own| *own = 1.0);
        for &(i, j, value) in &correlations {
            let wrong = |value, expected| DesignError::Range { what: "a correlation", value, expected };
            if i == j || i.max(j) >= n || ![i, j].iter().all(|&k| each[k].parameter.is_constant()) {
                return Err(wrong(value, "one of two constants of the robot that have tolerances"));
            }
            if value.is_nan() || value.abs() > 1.0 {
                return Err(wrong(value, "-1 to 1"));
            }
            if matrix[i * n + j] != 0.0 {
                return Err(wrong(value, "one of each pair"));
            }
            (matrix[i * n + j], matrix[j * n + i]) = (value, value);
        }
        if !correlations.is_empty() {
            matrix.iter_mut().step_by(n + 1).for_each(|own| *own += ROUNDING);
            linear::factorise(&mut matrix, n);
            if !linear::is_definite(&matrix, n) {
                let least = matrix.iter().step_by(n + 1).fold(1.0, |least: f64, pivot| least.min(*pivot));
                let (what, expected) = ("a pivot of the correlations", "at least 0: no errors go together like this");
                return Err(DesignError::Range { what, value: least, expected });
            }
        }
        Ok(Self { each, correlations })
    }

    /// Two columns and the correlation of their numbers, pair by pair.
    pub(crate) fn correlations(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        self.correlations.iter().copied()
    }

    /// Covariances of those that are correlated, as [counted](Tolerance::counted): two columns and a value each.
    pub(super) fn covariances(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        let counted = |i: usize| self.each[i].counted();
        self.correlations.iter().map(move |&(i, j, value)| (i, j, value * counted(i) * counted(j)))
    }
}

/// Of independent numbers.
impl From<Vec<Tolerance>> for Tolerances {
    fn from(each: Vec<Tolerance>) -> Self {
        Self { each, correlations: Vec::new() }
    }
}

impl Deref for Tolerances {
    type Target = [Tolerance];

    fn deref(&self) -> &[Tolerance] {
        &self.each
    }
}

#[cfg(test)]
mod tests {
    use super::super::uncertain::Uncertain as U;
    use super::*;
    use proptest::prelude::*;

    fn each(count: usize) -> Vec<Tolerance> {
        (0..count).map(|j| Tolerance { parameter: U::Stiffness(j), std: 0.1 + j as f64 }).collect()
    }

    #[test]
    fn what_no_errors_can_be_is_refused() {
        for wrong in [
            vec![(0, 0, 0.1)],
            vec![(0, 3, 0.1)],
            vec![(0, 1, f64::NAN)],
            vec![(0, 1, -1.01)],
            vec![(0, 1, 0.1), (1, 0, 0.1)],
            vec![(0, 1, 0.9), (1, 2, 0.9), (0, 2, -0.9)],
        ] {
            assert!(Tolerances::correlated(each(3), wrong.clone()).is_err(), "{wrong:?}");
        }
        let mut changing = each(2);
        changing[1].parameter = U::LostMotion(0);
        assert!(Tolerances::correlated(changing, vec![(0, 1, 0.1)]).is_err());
    }

    proptest! {
        /// Numbers that go by three others: their correlations, which are singular, are always accepted.
        #[test]
        fn what_errors_are_is_accepted(by in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 2..7)) {
            let product = |i: usize, j: usize| (0..3).map(|k| by[i][k] * by[j][k]).sum::<f64>();
            prop_assume!((0..by.len()).all(|i| product(i, i) > 1e-3));
            let pairs = (0..by.len()).flat_map(|j| (0..j).map(move |i| (i, j)));
            let of = |i, j| (product(i, j) / (product(i, i) * product(j, j)).sqrt()).clamp(-1.0, 1.0);
            let correlations: Vec<_> = pairs.map(|(i, j)| (i, j, of(i, j))).filter(|c| c.2 != 0.0).collect();
            let found = Tolerances::correlated(each(by.len()), correlations.clone()).unwrap();
            for ((i, j, covariance), (_, _, value)) in found.covariances().zip(correlations) {
                let expected = value * found[i].counted() * found[j].counted();
                prop_assert!((covariance - expected).abs() <= 1e-15 * expected.abs());
            }
        }
    }
}
