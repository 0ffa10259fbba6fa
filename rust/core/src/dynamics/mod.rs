//! Rigid-body dynamics of the links and kinematics of the sensors, with exact first derivatives.
//!
//! Set a state on a [`Kinematics`], then ask: every answer is read off the same per-body quantities in the base frame.
//! Where loads and readings alone are wanted, [`NewtonEuler`] gives them with half the work. Matrices are row-major
//! slices. Nothing allocates after construction.

mod batch;
mod definite;
mod elastic;
mod kinematics;
mod loads;
mod newton_euler;
mod sensing;

pub use batch::{Batch, DrivenStates, States};
pub use definite::check_inertia;
pub use elastic::{ElasticDynamics, ElasticLayout};
pub use kinematics::Kinematics;
pub use loads::Loads;
pub use newton_euler::NewtonEuler;
pub(crate) use sensing::Placed;
