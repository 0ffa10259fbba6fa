//! Exponential and hyperbolic tangent that vectorise: straight-line code, the same bits in a lane as alone.

use core::f64::consts::LOG2_E;

/// ln 2 in a part of 33 significant bits and a rest: `n · part` is exact (Cody and Waite 1980).
pub(super) const LN_2: [f64; 2] = [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10];
/// Adding and subtracting 1.5·2⁵² rounds to the nearest integer, and leaves it in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// Beyond these e^x is 0 or infinite, or no longer of full precision.
const LEAST: f64 = -708.0;
const LARGEST: f64 = 709.0;
/// 1/k! for k = 2 … 13: the series ends below half a unit in the last place on |r| ≤ ½ ln 2.
const FACTORIALS: [f64; 12] = [
    1.0 / 2.0,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
    1.0 / 5_040.0,
    1.0 / 40_320.0,
    1.0 / 362_880.0,
    1.0 / 3_628_800.0,
    1.0 / 39_916_800.0,
    1.0 / 479_001_600.0,
    1.0 / 6_227_020_800.0,
];

/// e^x; zero below −708, e⁷⁰⁹ above 709.
#[inline(always)]
pub(super) fn exp(x: f64) -> f64 {
    let (power, rest) = reduced(x.clamp(LEAST, LARGEST));
    let value = power + power * rest;
    if x < LEAST { 0.0 } else { value }
}

/// tanh x, by e^2x − 1 so that small arguments keep their precision.
#[inline(always)]
pub(super) fn tanh(x: f64) -> f64 {
    let (power, rest) = reduced((2.0 * x).clamp(-40.0, 40.0));
    let e = power * rest + (power - 1.0);
    e / (e + 2.0)
}

/// e^x − 1, to within 2 ulp also near zero; −1 below −708.
pub(crate) fn exp_m1(x: f64) -> f64 {
    let (power, rest) = reduced(x.clamp(LEAST, LARGEST));
    power * rest + (power - 1.0)
}

/// 2ⁿ and e^r − 1 with x = n ln 2 + r.
#[inline(always)]
fn reduced(x: f64) -> (f64, f64) {
    let shifted = x * LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let mut sum = FACTORIALS[11];
    for factor in FACTORIALS[..11].iter().rev() {
        sum = sum * r + *factor;
    }
    let power = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52));
    (power, r + r * r * sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agree_with_the_standard_library_everywhere() {
        let mut x = 1e-12_f64;
        while x < 700.0 {
            for y in [x, -x] {
                assert!((exp(y) / y.exp() - 1.0).abs() < 5e-16, "exp {y}");
                assert!((exp_m1(y) / y.exp_m1() - 1.0).abs() < 5e-16, "exp_m1 {y}");
                assert!((tanh(y) / y.tanh() - 1.0).abs() < 5e-16, "tanh {y}: {} {}", tanh(y), y.tanh());
            }
            x *= 1.000_37;
        }
    }

    #[test]
    fn end_where_numbers_end() {
        assert_eq!((exp(0.0), exp(-1e9), tanh(0.0), tanh(1e9), tanh(-1e9)), (1.0, 0.0, 0.0, 1.0, -1.0));
        assert!(exp(f64::NAN).is_nan() && tanh(f64::NAN).is_nan());
    }
}
