//! Robots that move in the computer: integration, sensors, and a controller in the loop.
//!
//! A [`Plant`] is moved by a [`Stepping`] under the torque of a [`Controller`](crate::control::Controller), which knows
//! what a [`Feedback`] makes of a [`Suite`]'s readings. All are independent of each other: a new integrator, a new
//! fault of a sensor or a new law is one type. [`simulate`](simulate()) runs the loop.

mod adaptive;
mod feedback;
mod integrator;
mod plant;
mod recording;
mod rosenbrock;
mod run;
mod sensors;
mod start;

pub use adaptive::{Adaptive, StepTolerance};
pub use feedback::{Feedback, FilterFeedback, Known, ObserverFeedback, SensorFeedback, TrueState};
pub use integrator::{RungeKutta, largest_stable_step};
pub use plant::Plant;
pub use recording::SimulatedRecording;
pub use run::{Outside, Plan, Stepping, simulate};
pub use sensors::{JointMotion, SensorModel, Suite};
pub use start::SimulationStart;
