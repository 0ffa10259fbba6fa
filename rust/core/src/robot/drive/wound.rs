//! A transmission wound up: where its friction elements were left, and the torsion that holds a torque from there.

use super::{Drive, FrictionElement};
use crate::scalar::Scalar;

/// An estimated torsion is noisy, and an element would lose its force by that: steps back and forth within this part of the
/// least reach are ignored. Steps in the direction of the last one are exact.
const PLAY: f64 = 0.02;

/// Where the friction elements of one drive were left: what its torque depends on beside the torsion.
///
/// ```
/// use linkside_core::robot::{FrictionElement, Hysteresis, Wound};
/// let mut drive = linkside_core::demo::arm()?.drives[0].clone(); // 1.2e4 N m/rad
/// drive.hysteresis = Hysteresis { elements: vec![FrictionElement::dahl(6e3, 10.0)] };
/// let mut wound = Wound::new(&drive);
/// wound.rest(&drive, 0.0);
/// let (torsion, _) = wound.twist(&drive, 60.0);
/// assert!((1.2e4 * torsion + 10.0 - 60.0).abs() < 1.0); // the element carries nearly its limit
/// wound.follow(&drive, torsion);
/// assert!((wound.torque(&drive, torsion)[0] - 60.0).abs() < 1e-9);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Debug)]
pub struct Wound {
    /// δ [rad].
    torsion: f64,
    /// z of each element [rad], and how much of what it was at the start is left in it.
    elements: Vec<(f64, f64)>,
}

impl Clone for Wound {
    fn clone(&self) -> Self {
        Self { torsion: self.torsion, elements: self.elements.clone() }
    }

    /// Without an allocation.
    fn clone_from(&mut self, other: &Self) {
        self.torsion = other.torsion;
        self.elements.clone_from(&other.elements);
    }
}

impl Wound {
    /// Of `drive`, elements relaxed.
    pub fn new(drive: &Drive) -> Self {
        Self { torsion: 0.0, elements: vec![(0.0, 1.0); drive.hysteresis.elements.len()] }
    }

    /// Relaxes the elements at a torsion whose spring alone holds `torque` [N m].
    pub fn rest(&mut self, drive: &Drive, torque: f64) {
        self.torsion = drive.torsion(torque);
        self.elements.fill((0.0, 1.0));
    }

    /// Moves on to an estimate of the torsion [rad], of which some noise is no motion: it has to be left behind by `PLAY`.
    pub fn follow(&mut self, drive: &Drive, torsion: f64) {
        let reach = drive.hysteresis.elements.iter().map(FrictionElement::reach).fold(f64::INFINITY, f64::min);
        let lag = torsion - self.torsion;
        if lag.abs() > PLAY * reach {
            self.advance(drive, lag - (PLAY * reach).copysign(lag));
        }
    }

    /// Moves on by a step of the torsion [rad].
    fn advance(&mut self, drive: &Drive, step: f64) {
        for ((z, left), element) in self.elements.iter_mut().zip(&drive.hysteresis.elements) {
            let moved = element.moved(*z, step);
            (*z, *left) = (moved.deflection, *left * moved.fading);
        }
        self.torsion += step;
    }

    /// Torque of spring and elements at a torsion, and its first two derivatives there [N m, N m/rad, N m/rad²]; the
    /// second without the spring's.
    #[inline(always)]
    pub fn torque(&self, drive: &Drive, torsion: f64) -> [f64; 3] {
        let mut sum = [drive.spring_torque(torsion), drive.tangent_stiffness(torsion), 0.0];
        for ((z, _), element) in self.elements.iter().zip(&drive.hysteresis.elements) {
            let moved = element.moved(*z, torsion - self.torsion);
            for (sum, part) in sum.iter_mut().zip([moved.deflection, moved.slope, moved.bend]) {
                *sum += element.stiffness * part;
            }
        }
        sum
    }

    /// What the torque at a torsion gains by all elements having been nearer to their limits at the start, by all of the
    /// way [N m].
    pub fn inherited(&self, drive: &Drive, torsion: f64) -> f64 {
        let own = |((z, left), e): (&(f64, f64), &FrictionElement)| {
            e.limit * left * e.moved(*z, torsion - self.torsion).fading
        };
        self.elements.iter().zip(&drive.hysteresis.elements).map(own).sum()
    }

    /// Torsion at which spring and elements hold `torque`, and one over their slope there.
    #[inline(always)]
    pub fn twist<T: Scalar>(&self, drive: &Drive, torque: T) -> (T, T) {
        let solution = torque.map(|torque| self.solve(drive, torque));
        // One step of Newton's method gives derivative numbers their slopes; those of the slope by what it changes by.
        let at = |part: usize| solution.map(|x| self.torque(drive, x)[part]);
        let torsion = solution + (torque - at(0)) / at(1);
        let slope = at(1)
            + (torsion - solution) * at(2)
            + (drive.tangent_stiffness(torsion) - drive.tangent_stiffness(solution));
        (torsion, T::constant(1.0) / slope)
    }

    /// Newton's method within bounds: the torque rises with torsion, on either side of where it was left.
    fn solve(&self, drive: &Drive, torque: f64) -> f64 {
        let most: f64 = drive.hysteresis.elements.iter().map(|element| element.limit).sum();
        let (mut low, mut high) = (drive.torsion(torque - most), drive.torsion(torque + most));
        let mut torsion = self.torsion.clamp(low, high);
        for _ in 0..100 {
            let [force, slope, _] = self.torque(drive, torsion);
            let excess = force - torque;
            if excess > 0.0 {
                high = torsion
            } else {
                low = torsion
            }
            let mut next = torsion - excess / slope;
            if !(next > low && next < high) {
                next = 0.5 * (low + high);
            }
            let settled = (next - torsion).abs() <= 1e-16 * (torsion.abs() + 1e-6);
            torsion = next;
            if settled {
                break;
            }
        }
        torsion
    }
}

#[cfg(test)]
mod tests {
    use super::super::hysteresis::tests::elements;
    use super::*;
    use crate::robot::{Backlash, Interpolation, SpringCurve};
    use crate::scalar::Dual;

    #[test]
    fn a_wound_drive_holds_the_torque_that_is_asked_for() {
        let mut drive = crate::demo::arm().unwrap().drives.remove(0);
        drive.hysteresis.elements = elements().to_vec();
        let curve = SpringCurve::new(&[[1e-3, 10.0], [4e-3, 60.0]], Interpolation::Monotone).unwrap();
        let backlash = Backlash { half_gap: 1e-3, slope: 0.1, rounding: 1e-4 };
        let table = Drive { curve, ..drive.clone() };
        for drive in [drive.clone(), table, Drive { backlash, ..drive }] {
            let mut wound = Wound::new(&drive);
            wound.rest(&drive, 20.0);
            for torque in [20.0, 35.0, 34.0, -60.0, -59.99, 0.0, 80.0, 80.0, 12.0] {
                let (torsion, compliance) = wound.twist(&drive, Dual::<1>::variable(torque, 0));
                let [force, slope, _] = wound.torque(&drive, torsion.value);
                assert!((force - torque).abs() < 1e-10, "{torque} {force}");
                assert!((torsion.gradient[0] * slope - 1.0).abs() < 1e-10);
                let h = 1e-4;
                let of = |torque: f64| wound.twist(&drive, torque).1;
                let change = (of(torque + h) - of(torque - h)) / (2.0 * h);
                let turned = (torsion.value - wound.torsion).abs() < 1e-9;
                assert!(turned || (compliance.gradient[0] - change).abs() < 1e-4 * compliance.value, "{torque}");
                wound.follow(&drive, torsion.value);
                assert!((wound.torque(&drive, torsion.value)[0] - torque).abs() < 1e-9);
            }
        }
    }
}
