//! Torques that make a robot with elastic joints do what is wanted.
//!
//! Laws are [`Controller`]s, called once a sample with what is known of the robot: [`JointPd`], [`StateFeedback`] along
//! a motion that [`feedforward`] has planned, and [`SimpleAdaptive`].

pub mod feedforward;
mod joint_pd;
mod learning;
mod reference;
mod simple_adaptive;
mod state_feedback;
mod transmission;

pub use joint_pd::JointPd;
pub use learning::{LearningLoop, LearningStep};
pub use reference::Reference;
pub use simple_adaptive::{AdaptiveGains, SimpleAdaptive};
pub use state_feedback::StateFeedback;

/// What a controller knows of the robot, n numbers each.
#[derive(Clone, Debug, Default)]
pub struct RobotState {
    /// q [rad].
    pub q: Vec<f64>,
    /// q̇ [rad/s].
    pub dq: Vec<f64>,
    /// θ [rad]; q where the joint is rigid.
    pub theta: Vec<f64>,
    /// θ̇ [rad/s]; q̇ where the joint is rigid.
    pub dtheta: Vec<f64>,
}

impl RobotState {
    /// At rest at zero.
    pub fn new(joints: usize) -> Self {
        let [q, dq, theta, dtheta] = core::array::from_fn(|_| vec![0.0; joints]);
        Self { q, dq, theta, dtheta }
    }
}

/// The controller will give no torque; it knows why itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused;

/// Anything that turns a state into motor torques.
///
/// ```
/// use linkside_core::control::{Controller, Refused, RobotState};
///
/// /// A damper at each motor.
/// struct Brake(f64);
///
/// impl Controller for Brake {
///     fn torque(&mut self, _t: f64, state: &RobotState, out: &mut [f64]) -> Result<(), Refused> {
///         for (torque, speed) in out.iter_mut().zip(&state.dtheta) {
///             *torque = -self.0 * speed;
///         }
///         Ok(())
///     }
/// }
///
/// let (mut state, mut torque) = (RobotState::new(1), [0.0]);
/// state.dtheta[0] = 0.5;
/// Brake(40.0).torque(0.0, &state, &mut torque).unwrap();
/// assert_eq!(torque, [-20.0]);
/// ```
pub trait Controller {
    /// Motor torques `out` (n) [N m] from time `t` [s] until the next sample, asked for once a sample, in order.
    ///
    /// # Errors
    /// [`Refused`] ends the run.
    fn torque(&mut self, t: f64, state: &RobotState, out: &mut [f64]) -> Result<(), Refused>;
}
