//! How a particle filter goes about it.

use super::density::Density;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::estimate::kalman::{JerkModel, MOST_ITERATIONS};
use crate::estimate::measurement::Channel;

/// Most particles that a filter takes.
pub const MOST_PARTICLES: usize = 1 << 22;

/// Where particles go next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Proposal {
    /// Wherever the process takes them; the readings only weigh them (Gordon, Salmond and Smith 1993).
    Bootstrap,
    /// Where process and readings take them, by the readings linearised at each particle (Doucet, Godsill and Andrieu
    /// 2000). Drawn as process noise, which has fewer dimensions than the state.
    Linearised {
        /// How often readings are linearised, each time at the mode of the time before.
        iterations: usize,
        /// Degrees of freedom of Student's density that takes the normal one's place; None keeps the normal density.
        tail: Option<u32>,
    },
}

/// What is known in closed form for each particle (Rao–Blackwellised; Schön, Gustafsson and Nordlund 2005).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marginalised {
    /// Nothing: all of the state is drawn.
    Nothing,
    /// Biases. As each adds to its channel, and nothing else depends on it, their variances are the same for all particles.
    Biases,
    /// Accelerations and biases, with a covariance for each particle.
    Accelerations,
}

/// How particles are chosen in proportion to their weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resampling {
    /// One random number, N equal steps (Kitagawa 1996).
    Systematic,
    /// One random number in each of N equal parts.
    Stratified,
    /// Whole copies first, the rest systematically.
    Residual,
    /// N independent choices.
    Multinomial,
}

/// What to do when no particle explains a sample's readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Collapse {
    /// Stop, and name the sample.
    Stop,
    /// Flag the sample, and leave the cloud as it is.
    Flag,
    /// Flag the sample, and draw the cloud again from a Kalman filter that runs beside it.
    Reseed,
}

/// Settings of a particle filter.
///
/// What decides is the proposal: with precise encoders the bootstrap's particles hardly ever land where readings are,
/// and a few hundred with [`Proposal::Linearised`] do what it does not with a hundred thousand. Then densities, where
/// readings have outliers. Number and resampling come last: the error of chance falls with the root of the number.
#[derive(Clone, Debug, PartialEq)]
pub struct ParticleSettings {
    /// N.
    pub particles: usize,
    /// The same seed gives the same numbers, on any machine and number of threads.
    pub seed: u64,
    /// Where particles go next.
    pub proposal: Proposal,
    /// How particles are chosen.
    pub resampling: Resampling,
    /// Resample when fewer than this share of N is effective.
    pub threshold: f64,
    /// Width of the normal density around each chosen particle, in units of the cloud's own (Liu and West 2001); mean and
    /// covariance of the cloud stay what they were. None leaves copies where they are.
    pub kernel: Option<f64>,
    /// Of each channel's noise (channels).
    pub densities: Vec<Density>,
    /// Least and largest position of each joint (n).
    pub limits: Vec<(f64, f64)>,
    /// Link positions that particles start from in turn, at rest (any number of rows of n); empty for one at rest.
    pub initial: Vec<f64>,
    /// What to do when the cloud does not explain the readings.
    pub collapse: Collapse,
    /// Shares of probability whose quantiles of position are reported.
    pub quantiles: Vec<f64>,
}

impl ParticleSettings {
    /// # Errors
    /// A setting out of its range, or of a length that does not fit `model`.
    pub(super) fn check(&self, model: &JerkModel, marginalised: Marginalised) -> Result<(), DesignError> {
        let unused = !model.channels.contains(&Channel::MotorVelocity(0));
        expect(unused, "motor_velocities", 1.0, "0: a particle filter does not measure with them")?;
        let count = self.particles as f64;
        expect((1..=MOST_PARTICLES).contains(&self.particles), "particles", count, "1 to 4194304")?;
        expect((0.0..=1.0).contains(&self.threshold), "threshold", self.threshold, "a share of 0 to 1")?;
        if let Some(h) = self.kernel {
            expect(h > 0.0 && h <= 1.0, "kernel", h, "a width above 0 and up to 1")?;
        }
        if let Proposal::Linearised { iterations, tail } = self.proposal {
            expect((1..=MOST_ITERATIONS).contains(&iterations), "iterations", iterations as f64, "1 to 100")?;
            let dof = tail.unwrap_or(2);
            expect(dof >= 2 && dof % 2 == 0, "proposal_tail", f64::from(dof), "an even number of at least 2")?;
        }
        expect_length("densities", self.densities.len(), model.channels())?;
        for density in &self.densities {
            density.check()?;
            let fits = density.is_normal() || marginalised == Marginalised::Nothing;
            expect(fits, "outliers", 1.0, "normal noise where biases are marginalised")?;
        }
        expect_length("limits", self.limits.len(), model.joints())?;
        for &(low, high) in &self.limits {
            expect(low < high, "limits", low, "a lower limit below the upper one")?;
        }
        let rows = self.initial.len().div_ceil(model.joints());
        expect_length("initial", self.initial.len(), rows * model.joints())?;
        if let Some(&q) = self.initial.iter().find(|q| !q.is_finite()) {
            expect(false, "initial", q, "finite positions")?;
        }
        for &share in &self.quantiles {
            expect(share > 0.0 && share < 1.0, "quantiles", share, "shares between 0 and 1")?;
        }
        Ok(())
    }
}
