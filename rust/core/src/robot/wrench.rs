//! Forces and moments that something outside the model gives a link: a process, a rope, a contact.

use super::{Frame, Robot, Tree};
use crate::check::expect_of;
use crate::error::RobotError;

/// Numbers of a wrench: force along x, y and z, moment about them.
pub const WRENCH: usize = 6;

/// A force and a moment on a link, about the origin and in the axes of a frame that the link carries.
///
/// ```
/// use linkside_core::dynamics::{Kinematics, Loads};
/// use linkside_core::robot::{Acting, Wrench};
/// let robot = linkside_core::demo::arm()?;
/// let frame = robot.tool.clone().unwrap(); // 1 m from the axis
/// let acting = Acting::Constant([0.0, 10.0, 0.0, 0.0, 0.0, 2.0]);
/// let robot = robot.with_wrenches(vec![Wrench { frame, acting }])?;
/// let (mut kinematics, mut loads) = (Kinematics::new(&robot.tree), Loads::new(&robot.tree));
/// let mut tau = [0.0];
/// kinematics.set(&robot.tree, &[0.7], &[0.0], &[0.0]);
/// loads.inverse_dynamics_into(&robot.tree, &kinematics, &mut tau);
/// assert!((tau[0] + 12.0).abs() < 1e-12); // so much less has the joint to give
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Wrench {
    /// Where, and in which axes.
    pub frame: Frame,
    /// How much, as far as the robot's description says it.
    pub acting: Acting,
}

/// What is known of a wrench beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Acting {
    /// It is always this [N, N m].
    Constant([f64; WRENCH]),
    /// It changes, and is part of the state; whether a sensor measures it.
    Varying {
        /// Whether it has channels.
        measured: bool,
    },
}

impl Robot {
    /// The same robot with `wrenches`.
    ///
    /// # Errors
    /// One that is not finite.
    pub fn with_wrenches(mut self, wrenches: Vec<Wrench>) -> Result<Self, RobotError> {
        for (i, wrench) in wrenches.iter().enumerate() {
            let Acting::Constant(values) = wrench.acting else { continue };
            let sum: f64 = values.iter().sum();
            expect_of(sum.is_finite(), "wrench", || format!("wrench {i}"), sum, "finite numbers")?;
        }
        self.tree.wrenches = wrenches;
        Ok(self)
    }

    /// Numbers of all varying wrenches.
    pub fn wrench_states(&self) -> usize {
        WRENCH * self.tree.varying().count()
    }

    /// Which of these numbers are measured, in their order.
    pub fn wrench_channels(&self) -> impl Iterator<Item = usize> + '_ {
        let measured = |wrench: &Wrench| wrench.acting == Acting::Varying { measured: true };
        let of = move |(k, wrench)| (k * WRENCH..(k + 1) * WRENCH).filter(move |_| measured(wrench));
        self.tree.varying().enumerate().flat_map(of)
    }
}

impl Tree {
    /// Wrenches that are not constant.
    pub(crate) fn varying(&self) -> impl Iterator<Item = &Wrench> {
        self.wrenches.iter().filter(|wrench| matches!(wrench.acting, Acting::Varying { .. }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrench_without_end_is_refused() {
        let robot = crate::demo::arm().unwrap();
        let frame = robot.tool.clone().unwrap();
        let acting = Acting::Constant([0.0, f64::INFINITY, 0.0, 0.0, 0.0, 0.0]);
        let refused = robot.with_wrenches(vec![Wrench { frame, acting }]).unwrap_err().to_string();
        assert_eq!(refused, "wrench of wrench 0 is inf, expected finite numbers");
    }
}
