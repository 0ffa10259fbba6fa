//! Particle filters: beliefs that are not normal, states with limits, readings with outliers.
//!
//! A sample in order: [resample](Resampling) where few particles carry all weight, [propose](Proposal) each one's move,
//! weigh it by its [density](Density) of the readings, sum up, and hold the cloud against a Kalman filter that runs
//! beside ([`Collapse`]). Biases or accelerations may be [marginalised](Marginalised): a Kalman filter in each
//! particle. Particles go eight at a time through the text that the filters use for one, and random numbers are by
//! counter: the same seed gives the same bits, whatever the threads.

mod cloud;
mod conditional;
mod density;
mod filter;
mod guard;
mod initialise;
mod moments;
mod output;
mod past;
mod prepare;
mod process_noise;
mod proposal;
mod rao_blackwell;
mod regularise;
mod renew;
mod resample;
mod run;
mod sample;
mod settings;
mod shared;
mod smoother;
mod sums;

pub use density::Density;
pub use filter::ParticleFilter;
pub use output::{ParticleOutput, Summary};
pub use settings::{Collapse, MOST_PARTICLES, Marginalised, ParticleSettings, Proposal, Resampling};
