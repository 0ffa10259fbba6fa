//! Rigid-body dynamics of the links and kinematics of the sensors, with exact first derivatives.
//!
//! Set a state on a [`Kinematics`], then ask: every answer is read off the same per-body quantities in the base frame.
//! Matrices are row-major slices. Nothing allocates after construction.

mod batch;
mod definite;
mod elastic;
mod forward;
mod kinematics;
mod loads;
mod sensing;

pub use batch::{Batch, DrivenStates, States};
pub use definite::check_inertia;
pub use elastic::{ElasticDynamics, ElasticLayout};
pub use forward::{ElasticJacobian, ElasticState, ForwardDynamics};
pub use kinematics::Kinematics;
pub use loads::Loads;
pub(crate) use sensing::Placed;
