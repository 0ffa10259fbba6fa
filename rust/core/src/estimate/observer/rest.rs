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
    Rest::new(robot).find(robot, theta).map(<[f64]>::to_vec)
}

/// The same, with memory of its own: finding allocates nothing.
#[derive(Clone, Debug)]
pub(crate) struct Rest {
    kinematics: Kinematics<f64>,
    loads: Loads<f64>,
    zero: Vec<f64>,
    gravity: Vec<f64>,
    /// What was found.
    q: Vec<f64>,
}

impl Rest {
    /// Memory for `robot`.
    pub(crate) fn new(robot: &Robot) -> Self {
        let (tree, zero) = (&robot.tree, vec![0.0; robot.len()]);
        let (kinematics, loads) = (Kinematics::new(tree), Loads::new(tree));
        Self { kinematics, loads, gravity: zero.clone(), q: zero.clone(), zero }
    }

    /// Link positions (n) at rest for motor positions `theta` (n).
    ///
    /// # Errors
    /// [`DesignError::NoEquilibrium`].
    pub(crate) fn find(&mut self, robot: &Robot, theta: &[f64]) -> Result<&[f64], DesignError> {
        self.q.copy_from_slice(theta);
        for _ in 0..200 {
            self.weigh(robot);
            let mut step: f64 = 0.0;
            for (joint, drive) in robot.drives.iter().enumerate().filter(|(_, d)| d.elastic) {
                let rest = drive.ripple.output(theta[joint]).angle - drive.torsion(self.gravity[joint]);
                step = step.max((rest - self.q[joint]).abs());
                self.q[joint] = rest;
            }
            if step < 1e-15 {
                return Ok(&self.q);
            }
            if !step.is_finite() {
                break;
            }
        }
        // Settled to rounding of large angles is settled, too.
        self.weigh(robot);
        let Self { q, gravity, .. } = self;
        let balanced = robot.drives.iter().enumerate().filter(|(_, d)| d.elastic).all(|(j, d)| {
            let residual = d.spring_torque(d.torsion_between(theta[j], q[j])) - gravity[j];
            residual.abs() <= 1e-9 * (gravity[j].abs() + d.stiffness * theta[j].abs() * 1e-3 + 1.0)
        });
        if balanced { Ok(q) } else { Err(DesignError::NoEquilibrium) }
    }

    /// What was found last.
    pub(crate) fn q(&self) -> &[f64] {
        &self.q
    }

    /// The gravity torque of links that hang at q.
    fn weigh(&mut self, robot: &Robot) {
        let Self { kinematics, loads, zero, gravity, q } = self;
        kinematics.set(&robot.tree, q, zero, zero);
        loads.inverse_dynamics_into(&robot.tree, kinematics, gravity);
    }
}
