//! Whether a robot's inertia is one that masses can have.

use super::{ElasticDynamics, ElasticLayout};
use crate::error::RobotError;
use crate::robot::Robot;
use core::f64::consts::TAU;

/// Postures that are looked at.
const POSTURES: u32 = 500;

/// Looks at the inertia of links and motors together in five hundred postures, spread evenly.
///
/// A rotor's inertia B and coupling S belong together: [M S; Sᵀ B] is positive definite in every posture if M holds
/// S B⁻¹ Sᵀ beside the links' own inertia. Without a coupling it is as good as M, and nothing is looked at.
///
/// # Errors
/// A posture in which it is not positive definite.
pub fn check_inertia(robot: &Robot) -> Result<(), RobotError> {
    if robot.coupling.iter().all(|&s| s == 0.0) {
        return Ok(());
    }
    let n = robot.len();
    let layout = ElasticLayout::new(robot, false);
    let mut dynamics = ElasticDynamics::<f64>::new(robot, &layout);
    let (zero, mut q, mut x) = (vec![0.0; n], vec![0.0; n], vec![0.0; layout.dense]);
    let root = generalised_golden_ratio(n);
    for i in 0..POSTURES {
        // Roberts' low-discrepancy sequence: fractional parts of multiples of powers of 1/φ_n.
        for (j, q) in q.iter_mut().enumerate() {
            *q = TAU * ((f64::from(i) * root.powi(-(j as i32) - 1)).fract() - 0.5);
        }
        layout.gather([&q, &zero, &q, &zero], &mut x);
        dynamics.accelerate(robot, &layout, &x, &zero);
        let pivot = dynamics.least_pivot();
        if pivot.is_nan() || pivot <= 0.0 {
            return Err(RobotError::Indefinite { posture: q });
        }
    }
    Ok(())
}

/// The root of x^(n+1) = x + 1.
fn generalised_golden_ratio(n: usize) -> f64 {
    (0..60).fold(1.5, |x: f64, _| (1.0 + x).powf(1.0 / (n as f64 + 1.0)))
}
