//! Observers driven by accelerometers (De Luca, Schröder and Thümmel 2007).

mod acceleration;
mod correction;
mod gains;
mod late;
mod poles;
mod recording;
mod rest;
mod run;
mod sampled;
mod settings;

pub use acceleration::{AccelerationMap, Observability};
pub use correction::LONGEST;
pub use gains::{JointModel, closed_form_gains};
pub use poles::{Complex, Poles};
pub use recording::{ObserverOutput, ObserverRecording, ObserverSample};
pub use rest::link_position_at_rest;
pub use run::AccelerationObserver;
pub use sampled::Sampled;
pub use settings::{AccelerationSource, Form, ObserverSettings, Start};
