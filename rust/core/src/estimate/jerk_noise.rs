//! What white jerk does to position, velocity and acceleration over a step of time.

use crate::scalar::Scalar;

/// Covariance of (q, q̇, q̈) after `dt` [s] of white jerk with a density of one: ∫ (s²/2, s, 1)(s²/2, s, 1)ᵀ ds over the step.
///
/// Exact for every step: two steps, one after the other, are the long step, so a density holds at any rate.
#[inline(always)]
pub(crate) fn covariance<T: Scalar>(dt: T) -> [[T; 3]; 3] {
    let (second, third) = (dt * dt, dt * dt * dt);
    let (q_dq, q_ddq, dq_ddq) = (second * second * (1.0 / 8.0), third * (1.0 / 6.0), second * 0.5);
    [[second * third * (1.0 / 20.0), q_dq, q_ddq], [q_dq, third * (1.0 / 3.0), dq_ddq], [q_ddq, dq_ddq, dt]]
}

/// The factor L with L Lᵀ = `density`² [`covariance`] + `dt` diag(walks², 0), for draws: L times three independent standard
/// normal numbers moves (q, q̇, q̈), where `walks` is how position and velocity wander beside their acceleration.
///
/// The first number moves all three, as the acceleration is moved; the second what velocity has of its own, the third
/// what only position has: L is zero above the diagonal when its rows are read from the acceleration up. Without a
/// difference of numbers that are nearly alike, so that every step and every walk keeps its digits.
#[inline(always)]
pub(crate) fn factor(density: f64, walks: [f64; 2], dt: f64) -> [[f64; 3]; 3] {
    let [position, velocity] = walks.map(|walk| walk * walk * dt);
    let ddq = density * dt.sqrt();
    let (dq, q) = (ddq * dt, ddq * dt * dt);
    // What velocity and position have beside the first number, and how these go together.
    let (own_dq, with_dq, own_q) = (dq * dq / 12.0, dq * q / 24.0, q * q / 45.0);
    let variance = own_dq + velocity;
    let std = variance.sqrt();
    let (slope, wandered) = if variance > 0.0 { (with_dq / std, velocity / variance) } else { (0.0, 0.0) };
    // q²/45 less slope², which is q²/48 but for the part of the velocity that wandered.
    let rest = own_q / 16.0 + q * q / 48.0 * wandered + position;
    [[q / 6.0, slope, rest.sqrt()], [dq / 2.0, std, 0.0], [ddq, 0.0, 0.0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64, scale: f64) {
        assert!((a - b).abs() <= 1e-14 * scale, "{a} {b}");
    }

    #[test]
    fn factor_times_its_transpose_is_the_covariance() {
        for (dt, density, walks) in [
            (2e-4, 1.0, [0.0; 2]),
            (5e-4, 3e3, [1e-4, 1e-2]),
            (1e-2, 20.0, [0.0, 0.3]),
            (0.7, 0.5, [2.0, 0.0]),
            (0.1, 0.0, [0.2, 0.3]),
            (0.1, 0.0, [0.2, 0.0]),
            (0.0, 5.0, [1.0; 2]),
        ] {
            let (white_jerk, l) = (covariance(dt), factor(density, walks, dt));
            let q = |a: usize, b: usize| {
                let walk = if a == b && a < 2 { walks[a] * walks[a] * dt } else { 0.0 };
                density * density * white_jerk[a][b] + walk
            };
            for a in 0..3 {
                for b in 0..3 {
                    let product: f64 = (0..3).map(|k| l[a][k] * l[b][k]).sum();
                    close(product, q(a, b), (q(a, a) * q(b, b)).sqrt());
                }
            }
        }
    }

    /// Q(s + t) = F(t) Q(s) F(t)ᵀ + Q(t).
    #[test]
    fn two_steps_are_the_long_one() {
        let (s, t) = (5e-4, 3e-3);
        let f = [[1.0, t, t * t / 2.0], [0.0, 1.0, t], [0.0, 0.0, 1.0]];
        let (first, second, whole) = (covariance(s), covariance(t), covariance(s + t));
        for a in 0..3 {
            for b in 0..3 {
                let moved: f64 = (0..9).map(|k| f[a][k / 3] * first[k / 3][k % 3] * f[b][k % 3]).sum();
                close(moved + second[a][b], whole[a][b], (whole[a][a] * whole[b][b]).sqrt());
            }
        }
    }
}
