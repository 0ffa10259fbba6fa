//! Observers driven by accelerometers (De Luca, Schröder and Thümmel 2007).

mod acceleration;
mod gains;
mod poles;
mod rest;
mod run;
mod sampled;

pub use acceleration::{AccelerationMap, Sight};
pub use gains::{JointModel, closed_form_gains};
pub use poles::{Complex, Poles};
pub use rest::link_position_at_rest;
pub use run::{AccelerationObserver, AccelerationSource, Form, Recording, Sample, Settings, Status, Trajectory};
pub use sampled::Sampled;
