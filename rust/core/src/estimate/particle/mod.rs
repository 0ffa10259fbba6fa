//! Particle filters: beliefs that are not normal, states with limits, readings with outliers.

mod cloud;
mod density;
mod evaluation;
mod filter;
mod moves;
mod output;
mod proposal;
mod random;
mod resample;
mod settings;
mod shared;
mod smoother;
mod start;

pub use density::Density;
pub use filter::ParticleFilter;
pub use output::{ParticleOutput, Summary};
pub use settings::{Collapse, MOST_PARTICLES, ParticleSettings, Proposal, Resampling};
