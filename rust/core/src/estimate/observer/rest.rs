//! Where the links hang when nothing moves.

use crate::dynamics::{Kinematics, Loads};
use crate::error::DesignError;
use crate::robot::Robot;

/// Link positions at rest for motor positions `theta` (n): K(θ − q) + the spring's nonlinear part = g(q).
///
/// The fixed-point iteration q ← θ − φ⁻¹(g(q)) contracts when gravity's stiffness is below the springs'; each spring
/// is inverted by Newton's method.
///
/// ```
/// use linkside_core::estimate::observer::link_position_at_rest;
/// let robot = linkside_core::demo::arm()?; // turns about the vertical: nothing twists its spring
/// assert_eq!(link_position_at_rest(&robot, &[0.4])?, [0.4]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`DesignError::NoEquilibrium`] when it does not settle: gravity is too strong for the springs.
pub fn link_position_at_rest(robot: &Robot, theta: &[f64]) -> Result<Vec<f64>, DesignError> {
    let tree = &robot.tree;
    let (mut kinematics, mut loads) = (Kinematics::new(tree), Loads::new(tree));
    let zero = vec![0.0; tree.len()];
    let (mut q, mut gravity) = (theta.to_vec(), zero.clone());
    for _ in 0..200 {
        kinematics.set(tree, &q, &zero, &zero);
        loads.inverse_dynamics_into(tree, &kinematics, &mut gravity);
        let mut step: f64 = 0.0;
        for (joint, drive) in robot.drives.iter().enumerate().filter(|(_, d)| d.elastic) {
            let rest = drive.ripple.output(theta[joint]).angle - drive.torsion(gravity[joint]);
            step = step.max((rest - q[joint]).abs());
            q[joint] = rest;
        }
        if step < 1e-15 {
            return Ok(q);
        }
        if !step.is_finite() {
            break;
        }
    }
    // Settled to rounding of large angles is settled, too.
    kinematics.set(tree, &q, &zero, &zero);
    loads.inverse_dynamics_into(tree, &kinematics, &mut gravity);
    let balanced = robot.drives.iter().enumerate().filter(|(_, d)| d.elastic).all(|(j, d)| {
        let residual = d.spring_torque(d.torsion_between(theta[j], q[j])) - gravity[j];
        residual.abs() <= 1e-9 * (gravity[j].abs() + d.stiffness * theta[j].abs() * 1e-3 + 1.0)
    });
    if balanced { Ok(q) } else { Err(DesignError::NoEquilibrium) }
}
