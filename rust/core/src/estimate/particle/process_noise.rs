//! What is random in the motion of particles of positions and velocities.
//!
//! A joint's noise (w_q, w_q̇, w_q̈) over T is taken apart: u = w_q − T/2 w_q̇, to which the acceleration before adds
//! nothing, is drawn by a number of its own; what is left of w_q̇ given u is noise in a measurement q̇₊ − q̇ = T q̈ of the
//! acceleration, and goes together with what is left of w_q̈.

use crate::estimate::bias::BiasStep;
use crate::estimate::kalman::{JerkModel, JerkNoise, Symmetric};

/// Noise of one joint over a sample.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct JointNoise {
    /// ∂q/∂ζ, ∂q̇/∂ζ and ∂q̈/∂ζ of the joint's own number ζ.
    pub(super) position: f64,
    /// As above, of the joint's velocity.
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    /// Variances of velocity and acceleration that are left, and their covariance.
    pub(super) rest: f64,
    pub(super) gained: f64,
    pub(super) cross: f64,
}

impl JointNoise {
    /// Of white jerk of a density, and variances that position and velocity gain besides.
    ///
    /// With U = density² T⁵/120, all that white jerk has in u: closed forms in which nothing is subtracted, for any of the
    /// three may be all that there is.
    pub(super) fn new(density: f64, [position, velocity]: [f64; 2], dt: f64) -> Self {
        // Of white jerk over T: Var u = U = density² T⁵/120 for u = w_q − T/2 w_q̇, and the rest in closed forms of it.
        let jerk = density * density * dt / 120.0; // U / T⁴
        let own = jerk * dt.powi(4);
        let variance = own + position + 0.25 * dt * dt * velocity;
        // Nothing random in u: positions follow from velocities, whose noise is all in the measurement.
        if variance == 0.0 {
            let (rest, cross) = (40.0 * jerk * dt * dt + velocity, 60.0 * jerk * dt);
            return Self { rest, cross, gained: 120.0 * jerk, ..Self::default() };
        }
        let std = variance.sqrt();
        let [jolt, walk, turn] = [own / variance, position / variance, velocity / variance];
        Self {
            position: (position - 1.5 * own) / std,
            velocity: -(5.0 * jerk * dt.powi(3) + 0.5 * dt * velocity) / std,
            acceleration: -10.0 * jerk * dt * dt / std,
            rest: jerk * dt * dt * (15.0 * jolt + 40.0 * walk) + velocity * (6.0 * jolt + walk),
            cross: jerk * dt * (10.0 * jolt + 60.0 * walk + 10.0 * dt * dt * turn),
            gained: jerk * (20.0 * jolt + 120.0 * walk + 30.0 * dt * dt * turn),
        }
    }
}

/// What is random in the motion over a sample, the same for all particles.
#[derive(Clone, Debug)]
pub(super) struct ProcessNoise {
    /// Length of the sample [s]; zero at the first.
    pub(super) dt: f64,
    /// Each joint's noise (n).
    pub(super) joints: Vec<JointNoise>,
    /// How biases move.
    pub(super) biases: Vec<BiasStep<f64>>,
}

impl ProcessNoise {
    pub(super) fn new(model: &JerkModel) -> Self {
        let n = model.joints();
        Self {
            dt: 0.0,
            joints: vec![JointNoise::default(); n],
            biases: vec![BiasStep { decay: 1.0, variance: 0.0 }; model.states() - 3 * n],
        }
    }

    /// Over `dt`, or at the first sample, where nothing has moved and n is as uncertain as `first` says.
    pub(super) fn prepare(&mut self, model: &JerkModel, noise: &JerkNoise, dt: f64, first: Option<&Symmetric>) {
        let n = model.joints();
        self.dt = if first.is_some() { 0.0 } else { dt };
        let gained = |i: usize| first.map_or(noise.link_walk[i].powi(2) * dt, |covariance| covariance.at(i, i));
        for (j, joint) in self.joints.iter_mut().enumerate() {
            *joint = JointNoise::new(noise.jerk[j], [gained(j), gained(n + j)], self.dt);
        }
        for (channel, bias) in model.biases.iter().enumerate() {
            if let Some(b) = *bias {
                self.biases[b - 3 * n] = noise.bias_step(channel, self.dt);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::jerk_noise;

    #[test]
    fn noise_taken_apart_has_the_covariance_that_it_was_made_of() {
        for (density, position, velocity, dt) in [
            (3e3, 0.0, 0.0, 5e-4),
            (3e3, 1e-6, 1e-3, 5e-4),
            (1e-3, 0.3, 0.0, 0.1),
            (0.0, 0.0, 0.3, 0.1),
            (5.0, 0.2, 0.5, 0.0),
            (5.0, 0.0, 0.5, 0.0),
            (0.0, 0.0, 0.0, 0.1),
        ] {
            let noise = JointNoise::new(density, [position * position, velocity * velocity], dt);
            let JointNoise { position: p, velocity: v, acceleration: a, rest, gained, cross } = noise;
            let jerk = jerk_noise::covariance(dt).map(|row| row.map(|entry| entry * density * density));
            let half = 0.5 * dt;
            let expected = [
                [jerk[0][0] + position * position, jerk[0][1], jerk[0][2]],
                [jerk[0][1], jerk[1][1] + velocity * velocity, jerk[1][2]],
                [jerk[0][2], jerk[1][2], jerk[2][2]],
            ];
            let found = [
                [p * p + half * half * rest, p * v + half * rest, p * a + half * cross],
                [p * v + half * rest, v * v + rest, v * a + cross],
                [p * a + half * cross, v * a + cross, a * a + gained],
            ];
            for r in 0..3 {
                for c in 0..3 {
                    let scale = (expected[r][r] * expected[c][c]).sqrt() + half * half * velocity * velocity;
                    assert!((found[r][c] - expected[r][c]).abs() <= 1e-12 * scale, "{found:?} {expected:?}");
                }
            }
        }
    }
}
