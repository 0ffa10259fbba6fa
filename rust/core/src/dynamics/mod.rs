//! Rigid-body dynamics of the links and kinematics of the sensors, with exact first derivatives.
//!
//! Set a state on a [`Kinematics`], then ask: every answer is read off the same per-body quantities in the base frame.
//! Where loads and readings alone are wanted, [`NewtonEuler`] gives them with half the work. Matrices are row-major
//! slices. Nothing allocates after construction.
//!
//! | to compute | take | cost |
//! | --- | --- | --- |
//! | poses, velocities, accelerations of bodies, frames and sensors | [`Kinematics`] | O(n) |
//! | τ = M q̈ + C q̇ + g; M; C; ∂τ/∂(q, q̇, q̈) | [`Loads`] on a [`Kinematics`] | O(n), or O(n · depth) for matrices |
//! | τ and readings, no derivatives; M | [`NewtonEuler`] | O(n), about half; O(n · depth) for M |
//! | q̈ and θ̈ from motor torques, with springs, frictions and rotors on links | [`ElasticDynamics`] | O(n³) |
//! | all of them over arrays of states | [`Batch`] | on all cores |
//!
//! Conventions are those of Featherstone (2008), with every body's quantities about the base origin and in its axes.

mod batch;
mod composites;
mod counterbalances;
mod definite;
mod elastic;
mod kinematics;
mod loads;
mod newton_euler;
mod sensing;
mod wrenches;

pub use batch::{Batch, DrivenStates, States};
pub use definite::check_inertia;
pub(crate) use elastic::ElementRow;
pub use elastic::{ElasticDynamics, ElasticLayout};
pub use kinematics::Kinematics;
pub use loads::Loads;
pub use newton_euler::NewtonEuler;
pub(crate) use sensing::Placed;
