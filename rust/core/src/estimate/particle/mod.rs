//! Particle filters: beliefs that are not normal, states with limits, readings with outliers.

mod accelerations;
mod cloud;
mod conditional;
mod density;
mod filter;
mod guard;
mod motion;
mod moves;
mod output;
mod proposal;
mod renewal;
mod resample;
mod settings;
mod shared;
mod smoother;
mod start;
mod sums;

pub use density::Density;
pub use filter::ParticleFilter;
pub use output::{ParticleOutput, Summary};
pub use settings::{Collapse, MOST_PARTICLES, Marginalised, ParticleSettings, Proposal, Resampling};
