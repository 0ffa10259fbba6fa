//! The classical fourth-order method of Runge and Kutta, torque held over a step.

use super::plant::Plant;
use crate::robot::Robot;
use nalgebra::DMatrix;

/// The method is stable for |λ h| below this, wherever in the left half plane λ is (on the real axis at −2.785).
const RADIUS: f64 = 2.78;

/// A robot's state, moved in fixed steps.
///
/// ```
/// use linkside_core::simulate::{Plant, RungeKutta, largest_stable_step};
///
/// let robot = linkside_core::demo::arm()?;
/// let mut plant = Plant::new(&robot);
/// let mut x = [0.0; 4]; // (q, q̇, θ, θ̇)
/// assert!(largest_stable_step(&robot, &x, &[0.0]) > 1e-3);
/// let mut method = RungeKutta::new(&plant);
/// for _ in 0..100 {
///     method.step(&robot, &mut plant, &mut x, &[46.5], 1e-3);
/// }
/// // 46.5 N m for 0.1 s on motor and link together, whatever the spring does between them.
/// assert!((1.65 * x[1] + 3.0 * x[3] - 4.65).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct RungeKutta {
    /// Where the slope is asked for, the slope, and the new state as it is summed up.
    probe: Vec<f64>,
    slope: Vec<f64>,
    sum: Vec<f64>,
}

impl RungeKutta {
    /// Room for the robot of `plant`.
    pub fn new(plant: &Plant) -> Self {
        let [probe, slope, sum] = core::array::from_fn(|_| vec![0.0; plant.layout.dense]);
        Self { probe, slope, sum }
    }

    /// Moves `x` by `h` [s] under motor torques `tau` (n) [N m].
    #[inline(always)]
    pub fn step(&mut self, robot: &Robot, plant: &mut Plant, x: &mut [f64], tau: &[f64], h: f64) {
        let Self { probe, slope, sum } = self;
        sum.copy_from_slice(x);
        slope.fill(0.0);
        for (reach, weight) in [(0.0, h / 6.0), (0.5 * h, h / 3.0), (0.5 * h, h / 3.0), (h, h / 6.0)] {
            for ((probe, x), slope) in probe.iter_mut().zip(&*x).zip(&*slope) {
                *probe = x + reach * slope;
            }
            plant.rate_into(robot, probe, tau, slope);
            for (sum, slope) in sum.iter_mut().zip(&*slope) {
                *sum += weight * slope;
            }
        }
        x.copy_from_slice(sum);
        plant.layout.confine(robot, x);
    }
}

/// The largest step [s] that keeps the method stable near state `x` under `tau`: bounded by the fastest eigenvalue of
/// the linearised robot; infinite when nothing moves by itself, NaN when the inertia is not positive definite.
pub fn largest_stable_step(robot: &Robot, x: &[f64], tau: &[f64]) -> f64 {
    let Plant { layout, mut dynamics } = Plant::new(robot);
    let a = dynamics.linearise(robot, &layout, x, tau);
    if a.iter().any(|value| !value.is_finite()) {
        return f64::NAN;
    }
    let modes = DMatrix::from_row_slice(layout.dense, layout.dense, &a).complex_eigenvalues();
    RADIUS / modes.iter().map(|mode| mode.norm()).fold(0.0, f64::max)
}
