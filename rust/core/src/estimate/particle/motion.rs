//! What is random in the motion of particles of positions and velocities.
//!
//! Walks of position and velocity are taken apart by joint: w_q − T/2 w_q̇ is what no acceleration does, and what is left
//! of w_q̇ given that is noise in a measurement q̇₊ − q̇ = T q̈ of the acceleration.

use crate::estimate::kalman::{JerkModel, Noise};

/// Walks of one joint over a sample.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct JointWalk {
    /// ∂q/∂ζ and ∂q̇/∂ζ of the joint's own number ζ.
    pub(super) position: f64,
    pub(super) velocity: f64,
    /// The variance of velocity that is left.
    pub(super) rest: f64,
}

impl JointWalk {
    /// From standard deviations of position and velocity.
    pub(super) fn new(position: f64, velocity: f64, dt: f64) -> Self {
        let carried = 0.5 * dt * velocity;
        let std = (position * position + carried * carried).sqrt();
        if std == 0.0 {
            return Self { position: 0.0, velocity: 0.0, rest: velocity * velocity };
        }
        let (own, other) = (position / std, carried / std);
        Self { position: position * own, velocity: -velocity * other, rest: (velocity * own).powi(2) }
    }
}

/// What is random in the motion over a sample, the same for all particles.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    pub(super) dt: f64,
    pub(super) walks: Vec<JointWalk>,
    /// Variances that l gains.
    pub(super) gained: Vec<f64>,
}

impl Motion {
    pub(super) fn new(model: &JerkModel) -> Self {
        let n = model.joints();
        Self { dt: 0.0, walks: vec![JointWalk::default(); n], gained: vec![0.0; model.states() - 2 * n] }
    }

    /// Over `dt`, or at the first sample, where nothing has moved and n is as uncertain as `noise` says.
    pub(super) fn prepare(&mut self, model: &JerkModel, noise: &Noise, dt: f64, first: bool) {
        let n = model.joints();
        self.dt = if first { 0.0 } else { dt };
        let walk = |i: usize| if first { noise.initial[i] } else { noise.link_walk[i] * dt.sqrt() };
        for (j, joint) in self.walks.iter_mut().enumerate() {
            *joint = JointWalk::new(walk(j), walk(n + j), self.dt);
            self.gained[j] = noise.jerk[j].powi(2) * self.dt;
        }
        for (bias, walk) in model.biases.iter().zip(&noise.bias_walk) {
            if let Some(b) = *bias {
                self.gained[b - 2 * n] = walk * walk * self.dt;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_taken_apart_has_the_variances_that_it_was_made_of() {
        for (position, velocity, dt) in
            [(1e-6, 1e-3, 5e-4), (0.3, 0.0, 0.1), (0.0, 0.3, 0.1), (0.2, 0.5, 0.0), (0.0, 0.0, 0.1)]
        {
            let JointWalk { position: p, velocity: v, rest } = JointWalk::new(position, velocity, dt);
            let half = 0.5 * dt;
            let close = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * (position + velocity).powi(2), "{a} {b}");
            close(p * p + half * half * rest, position * position);
            close(v * v + rest, velocity * velocity);
            close(p * v + half * rest, 0.0);
        }
    }
}
