//! Robots that move in the computer: integration, sensors, and a controller in the loop.

mod feedback;
mod integrator;
mod random;
mod recording;
mod run;
mod sensors;
mod start;

pub use feedback::{Feedback, FilterFeedback, Known, ObserverFeedback, SensorFeedback, TrueState};
pub use integrator::{RungeKutta, largest_stable_step};
pub use recording::Recording;
pub use run::{Plan, simulate};
pub use sensors::{Kind, Motion, SensorModel, Suite};
pub use start::Start;
