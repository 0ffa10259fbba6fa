//! The first-order filter inside a sensor, sampled.

use crate::scalar::Scalar;

/// What a filter's output becomes over a step of `dt` [s]: weights of the output before, the input before and the input.
///
/// T ẇ = f − w, exactly for an f that runs straight over the step: w = α w₋ + (T/h (1 − α) − α) f₋ + (1 − T/h (1 − α)) f with
/// α = e^(−h/T). They add up to one. With tanh(h/2T) no digit of 1 − α is lost however short the step.
#[inline(always)]
pub(crate) fn low_pass<T: Scalar>(time_constant: T, dt: T) -> [T; 3] {
    let one = T::constant(1.0);
    let steps = dt / time_constant;
    let t = (steps * 0.5).tanh();
    let taken = t * 2.0 / (t + 1.0);
    let (left, mean) = (one - taken, taken / steps);
    [left, mean - left, one - mean]
}

/// [`low_pass`] of a sensor that may have no filter: its output is then its input.
#[inline(always)]
pub(crate) fn low_pass_or_none(time_constant: f64, dt: f64) -> [f64; 3] {
    if time_constant > 0.0 && dt > 0.0 { low_pass(time_constant, dt) } else { [0.0, 0.0, 1.0] }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods)] // the oracle is the platform's
mod tests {
    use super::*;

    /// From rest on a ramp f = b t: w = b (t − T (1 − e^(−t/T))).
    #[test]
    fn a_ramp_comes_out_as_the_differential_equation_says() {
        for (time_constant, dt) in [(2.95e-3, 4e-3), (1.0, 1e-4), (1e-4, 0.1)] {
            let (mut output, slope) = (0.0, 3.0);
            let weights: [f64; 3] = low_pass(time_constant, dt);
            for k in 1..200 {
                let t = f64::from(k) * dt;
                output = weights[0] * output + weights[1] * slope * (t - dt) + weights[2] * slope * t;
                let expected = slope * (t + time_constant * (-t / time_constant).exp_m1());
                assert!((output - expected).abs() < 1e-11 * slope * t, "{output} {expected}");
            }
        }
    }

    #[test]
    fn no_filter_passes_its_input() {
        assert_eq!(low_pass_or_none(0.0, 1e-3), [0.0, 0.0, 1.0]);
    }
}
