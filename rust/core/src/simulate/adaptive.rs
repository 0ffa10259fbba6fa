//! Steps as long as the tolerance allows, whatever the stiffness.

use super::plant::Plant;
use super::rosenbrock::Rosenbrock;
use crate::check::expect;
use crate::error::{DesignError, SimulationError};
use crate::interrupt::Watch;
use crate::robot::Robot;
use crate::simd;

/// Of the longest step that the error estimate allows.
const SAFETY: f64 = 0.9;
/// Largest and least ratio of a step to the one before.
const LONGER: f64 = 6.0;
const SHORTER: f64 = 0.2;
/// The least error from which the next step's length is predicted.
const ERROR_FLOOR: f64 = 1e-2;
/// The shortest step, as a part of the time to move.
const SHORTEST: f64 = 1e-12;
/// The most steps for it, refused ones included.
const MOST: usize = 100_000;

/// How large the error of a step may be: `atol` + `rtol` |x| of each number of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepTolerance {
    /// Relative.
    pub rtol: f64,
    /// Absolute, of positions [rad, m] and velocities [rad/s, m/s] alike.
    pub atol: f64,
}

impl StepTolerance {
    /// # Errors
    /// A number out of its range.
    pub(super) fn check(&self) -> Result<(), DesignError> {
        let Self { rtol, atol } = *self;
        expect((1e-13..1.0).contains(&rtol), "rtol", rtol, "at least 1e-13 and less than 1")?;
        expect(atol > 0.0 && atol.is_finite(), "atol", atol, "a finite number greater than 0")
    }
}

/// A robot's state, moved by the L-stable method RODAS in steps of Gustafsson's predictive controller
/// (Hairer and Wanner 1996, sections VI.4 and IV.8).
///
/// A vibration that is below the tolerance does not shorten steps, it is damped: a spring may be as stiff as it likes.
///
/// ```
/// use linkside_core::simulate::{Adaptive, Plant, StepTolerance};
///
/// let robot = linkside_core::demo::arm()?;
/// let mut plant = Plant::new(&robot);
/// let mut adaptive = Adaptive::new(&plant, StepTolerance { rtol: 1e-6, atol: 1e-9 })?;
/// // (q, q̇, θ, θ̇): a twisted spring, let go. Half a second later it has come to rest, without any momentum.
/// let mut x = [0.0, 0.0, 0.01, 0.0];
/// adaptive.advance(&robot, &mut plant, &mut x, &[0.0], (0.0, 0.5))?;
/// assert!((1.65 * x[1] + 3.0 * x[3]).abs() < 1e-6 && (x[2] - x[0]).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Adaptive {
    /// RODAS with its stages.
    method: Rosenbrock,
    /// Of the error of a step.
    tolerance: StepTolerance,
    /// Length of the next step [s].
    step: f64,
    /// Length and error of the last step that was taken.
    taken: Option<(f64, f64)>,
}

impl Adaptive {
    /// Room for the robot of `plant`.
    ///
    /// # Errors
    /// Tolerances out of range: `rtol` at least 1e-13 and less than 1, `atol` greater than 0.
    pub fn new(plant: &Plant, tolerance: StepTolerance) -> Result<Self, DesignError> {
        tolerance.check()?;
        Ok(Self { method: Rosenbrock::new(plant), tolerance, step: f64::INFINITY, taken: None })
    }

    /// Moves `x` from time `t` [s] by exactly `span` [s] under motor torques `tau` (n) [N m]; the first step of all
    /// tries the whole span, later ones what the steps before suggest. Does not allocate.
    ///
    /// # Errors
    /// [`Abrupt`](SimulationError::Abrupt) when the tolerance asks for steps that are too short, or too many;
    /// [`NotFinite`](SimulationError::NotFinite) when the state's rate is not a number.
    pub fn advance(
        &mut self,
        robot: &Robot,
        plant: &mut Plant,
        x: &mut [f64],
        tau: &[f64],
        (t, span): (f64, f64),
    ) -> Result<(), SimulationError> {
        simd::dispatch(simd::level(), Advance { adaptive: self, robot, plant, x, tau, t, span })
    }

    /// Whether the step of `length` and `error` is good; the length of the next.
    #[inline(always)]
    fn judge(&mut self, length: f64, error: f64, again: bool) -> bool {
        // The error estimate is of order 4 in the step.
        // By square roots: `powf` of the platform's library would make results depend on it.
        let root = |x: f64| x.sqrt().sqrt();
        let shrink = root(error) / SAFETY;
        // A NaN is no good either.
        let good = error <= 1.0;
        if !good {
            self.step = length * if shrink.is_finite() { (1.0 / shrink).max(SHORTER) } else { SHORTER };
            return false;
        }
        // Gustafsson's predictive controller (1994): the error of the next step continues the trend of the last two.
        let foretold = self.taken.map_or(0.0, |(before, e)| before / length * root(error * error / e) / SAFETY);
        // The more careful of both; after a refusal no longer step than the one that was just good.
        let shrink = shrink.max(foretold).clamp(1.0 / LONGER, 1.0 / SHORTER);
        self.step = length / if again { shrink.max(1.0) } else { shrink };
        self.taken = Some((length, error.max(ERROR_FLOOR)));
        true
    }
}

/// [`Adaptive::advance`], compiled once for every level of instructions.
struct Advance<'a> {
    adaptive: &'a mut Adaptive,
    robot: &'a Robot,
    plant: &'a mut Plant,
    x: &'a mut [f64],
    tau: &'a [f64],
    t: f64,
    span: f64,
}

impl simd::Kernel for Advance<'_> {
    type Output = Result<(), SimulationError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { adaptive, robot, plant, x, tau, t, span } = self;
        let StepTolerance { rtol, atol } = adaptive.tolerance;
        let (mut left, mut again) = (span, false);
        // f and its derivatives at x: kept for all tries from here, for a refused step changes only h in 1/(γ h) − J.
        adaptive.method.start(robot, plant, x, tau);
        let watch = Watch::current();
        for _ in 0..MOST {
            if watch.stops() {
                return Err(SimulationError::Interrupted { time: t });
            }
            // Step, estimate the error, judge; then go on from the end, or try again with a shorter step.
            let length = fit(adaptive.step, left);
            adaptive.method.step(robot, plant, x, tau, length);
            let (error, joint) = adaptive.method.error(x, |size| atol + rtol * size);
            again = !adaptive.judge(length, error, again);
            if !again {
                x.copy_from_slice(&adaptive.method.end);
                plant.layout.confine(robot, x);
                left -= length;
                // Exactly, as `fit` gives the last step all that is left.
                if left == 0.0 {
                    return Ok(());
                }
                adaptive.method.start(robot, plant, x, tau);
            } else if adaptive.step < SHORTEST * span {
                return Err(stuck(error, joint, t + (span - left), adaptive.step));
            }
        }
        let (error, joint) = adaptive.method.error(x, |size| atol + rtol * size);
        Err(stuck(error, joint, t + (span - left), adaptive.step))
    }
}

/// `step`, or what is `left` of the way, the last two steps of one length lest the last is tiny.
#[inline(always)]
fn fit(step: f64, left: f64) -> f64 {
    if step >= left {
        left
    } else if 2.0 * step > left {
        0.5 * left
    } else {
        step
    }
}

fn stuck(error: f64, joint: usize, time: f64, step: f64) -> SimulationError {
    if error.is_finite() { SimulationError::Abrupt { joint, time, step } } else { SimulationError::NotFinite { time } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_end_where_they_should() {
        for step in [0.3, 0.07, 0.51, 2.0, f64::INFINITY] {
            let (mut left, mut shortest) = (1.0, f64::INFINITY);
            while left > 0.0 {
                let length = fit(step, left);
                left -= length;
                shortest = shortest.min(length);
            }
            assert!(left == 0.0 && shortest > 0.49 * step.min(1.0), "{step} {shortest}");
        }
    }

    #[test]
    fn tolerances_that_cannot_be_met_are_refused() {
        for (rtol, atol, name) in
            [(0.0, 1e-9, "rtol"), (1.0, 1e-9, "rtol"), (f64::NAN, 1e-9, "rtol"), (1e-6, 0.0, "atol")]
        {
            let error = StepTolerance { rtol, atol }.check().unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
        assert!(StepTolerance { rtol: 1e-13, atol: f64::INFINITY }.check().is_err());
        assert!(StepTolerance { rtol: 1e-13, atol: 1e-15 }.check().is_ok());
    }
}
