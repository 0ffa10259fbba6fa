//! How a sensor's bias moves over a step of time: a Gauss–Markov process, which wanders and stays bounded.

use crate::scalar::Scalar;

/// b ← `decay` b + w with w of this `variance`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BiasStep<T> {
    /// e^(−dt/time): what is left of the bias.
    pub(crate) decay: T,
    /// What it wanders by meanwhile.
    pub(crate) variance: T,
}

/// Over `dt` [s], of a bias that wanders by `walk` in one second [unit/√s] and forgets over `time` [s].
///
/// ḃ = −b/τ + white noise: decay e^(−dt/τ), variance walk² τ/2 (1 − e^(−2 dt/τ)), exact for every step. Its own variance
/// tends to walk² τ/2 and stays there, however long nothing is read; an infinite `time` is a random walk, unbounded.
#[inline(always)]
pub(crate) fn bias_step<T: Scalar>(walk: f64, time: f64, dt: T) -> BiasStep<T> {
    let one = T::constant(1.0);
    if time.is_infinite() {
        return BiasStep { decay: one, variance: dt * (walk * walk) };
    }
    // With t = tanh(dt/2τ) no digit is lost however short the step: e^(−dt/τ) = (1 − t)/(1 + t).
    let t = (dt * (0.5 / time)).tanh();
    let inverse = one / (t + 1.0);
    BiasStep { decay: (one - t) * inverse, variance: t * inverse * inverse * (2.0 * time * walk * walk) }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods)] // the oracle is the platform's
mod tests {
    use super::*;

    #[test]
    fn the_stationary_variance_stays() {
        let (walk, time) = (3e-3_f64, 7.0_f64);
        let stationary = 0.5 * walk * walk * time;
        for dt in [1e-5, 5e-4, 0.3, 20.0, 1e4] {
            let BiasStep { decay, variance } = bias_step(walk, time, dt);
            assert!((decay / (-dt / time).exp() - 1.0).abs() < 1e-12 || decay < 1e-300);
            assert!((variance / (-stationary * (-2.0 * dt / time).exp_m1()) - 1.0).abs() < 1e-14);
            assert!(((decay * decay * stationary + variance) / stationary - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn without_end_it_is_a_random_walk() {
        let [endless, long] = [f64::INFINITY, 1e12].map(|time| bias_step(2.0, time, 0.25));
        assert_eq!((endless.decay, endless.variance), (1.0, 1.0));
        assert!((long.variance - 1.0).abs() < 1e-11);
    }
}
