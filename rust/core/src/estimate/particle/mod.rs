//! Particle filters: beliefs that are not normal, states with limits, readings with outliers.

mod cloud;
mod conditional;
mod density;
mod filter;
mod guard;
mod initialise;
mod output;
mod past;
mod process_noise;
mod proposal;
mod rao_blackwell;
mod regularise;
mod renew;
mod resample;
mod settings;
mod shared;
mod smoother;
mod sums;

pub use density::Density;
pub use filter::ParticleFilter;
pub use output::{ParticleOutput, Summary};
pub use settings::{Collapse, MOST_PARTICLES, Marginalised, ParticleSettings, Proposal, Resampling};
