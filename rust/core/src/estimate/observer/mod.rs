//! Observers driven by accelerometers (De Luca, Schröder and Thümmel 2007).
//!
//! The idea: with link accelerations measured, each joint's motor and spring are a linear system of four states,
//! whatever the links' dynamics are. Its observer has error dynamics of chosen poles ([`Poles`],
//! [`closed_form_gains`]), in discrete time exactly ([`Sampled`]); accelerometers give q̈ by least squares at the
//! estimated posture ([`AccelerationMap`]); what is nonlinear is fed forward at the estimate. Masses and inertias of
//! the links do not come into it.

mod acceleration;
mod acceleration_observer;
mod bound;
mod correction;
mod deviations;
mod excess;
mod gains;
mod joint_error;
mod last_torque;
mod late;
mod link_load;
mod matrix;
mod poles;
mod recording;
mod repeats;
mod rest;
mod run;
mod sampled;
mod sensor_errors;
mod settings;
mod uncertainty;

pub use acceleration::{AccelerationMap, Observability};
pub use acceleration_observer::AccelerationObserver;
pub use bound::UltimateBound;
pub use correction::LONGEST;
pub use gains::{JointModel, closed_form_gains};
pub use poles::{Complex, Poles};
pub use recording::{ObserverOutput, ObserverRecording, ObserverSample};
pub(crate) use rest::Rest;
pub use rest::link_position_at_rest;
pub use sampled::Sampled;
pub use settings::{AccelerationSource, Form, ObserverSettings, Start};
pub use uncertainty::Uncertainty;
