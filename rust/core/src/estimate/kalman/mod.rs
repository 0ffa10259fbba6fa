//! Kalman filter and smoother, and the models that they run on.
//!
//! A filter is a method ([`ExtendedKalmanFilter`], [`Smoother`]) on a [`Model`], which is a [`Process`] (f, Q and their
//! adjoints) [`Paired`] with a [`Measurement`] (h, its derivatives, R). Three models are here:
//!
//! | | [`JerkDriven`] | [`ElasticModel`] | [`ElasticModel::moved_by_jerk`] |
//! | --- | --- | --- | --- |
//! | state | q, q̇, q̈, biases | q, q̇, θ, θ̇, disturbances, biases | q, q̇, θ, θ̇, θ̈, biases |
//! | moved by | commanded and random jerk of links | measured motor torques | commanded and random jerk of motors |
//! | motors | measure the links through springs | are states | are states that links follow |
//! | from | Axelsson, Karlsson and Norrlöf 2012 | Ulrich and Sasiadek 2011 | both |
//!
//! Filter and smoother may go by values at [sigma points](SigmaRule) in place of derivatives, on any of them. What else may be in it, for either: sensors that are late ([`Lateness`]), numbers known to a tolerance only
//! ([`Tolerance`]), and a judge of the innovations ([`Finding`]).

mod bank;
mod consider;
mod consider_back;
mod correction;
mod dependence;
mod disturbance;
mod drift;
mod driven;
mod effect;
mod elastic;
mod elastic_measurement;
mod elastic_process;
mod elastic_sensitivity;
mod exponential;
mod filter;
mod findings;
mod fixed_lag;
mod gaussian;
mod history;
mod information;
mod isolation;
mod iterated;
mod jerk;
mod jerk_process;
mod lag_window;
mod late;
mod loss;
mod misfit;
mod model;
mod monitor;
mod motor_jerk;
mod motor_torques;
mod motor_velocity;
mod noise_evidence;
mod output;
mod paired;
mod path;
mod phases;
mod recording;
mod regression;
mod run;
mod sensitivity;
mod sigma_points;
mod signal;
mod single;
mod smoother;
mod step;
mod step_noise;
mod tolerances;
mod transition;
mod uncertain;
mod window_sum;

pub use disturbance::{LinkDisturbance, WrenchLaw};
pub use driven::{JerkDriven, JerkMeasurement};
pub use elastic::{Discretization, ElasticModel, ElasticNoise, ElasticSettings};
pub use elastic_measurement::ElasticMeasurement;
pub use elastic_process::ElasticProcess;
pub use filter::{ExtendedKalmanFilter, FilterSettings, MOST_ITERATIONS};
pub use findings::Finding;
pub use fixed_lag::FixedLagSmoother;
pub use gaussian::{Gaussian, Row, Symmetric};
pub use iterated::IteratedSmoother;
pub use jerk::{JerkModel, JerkNoise};
pub use jerk_process::JerkProcess;
pub use late::Lateness;
pub use loss::NoiseLoss;
pub use model::{Linearised, Measurement, Model, Process, Report};
pub use monitor::largest_nis;
pub use motor_jerk::{MotorJerkNoise, MotorJerkSettings};
pub use noise_evidence::{NoiseEvidence, NoiseJob};
pub(crate) use output::Tool;
pub use output::{FilterOutput, Keep};
pub use paired::Paired;
pub use phases::Phases;
pub(crate) use phases::{Linearise, Predict};
pub use recording::{Inputs, KalmanRecording, KalmanSample};
pub use run::Way;
pub use sigma_points::SigmaRule;
pub use signal::Fault;
pub(crate) use signal::Signal;
pub use smoother::Smoother;
pub use tolerances::Tolerances;
pub(crate) use uncertain::shares_of_link;
pub use uncertain::{Tolerance, Uncertain};
