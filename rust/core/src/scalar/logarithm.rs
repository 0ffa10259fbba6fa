//! Natural logarithm that vectorises: straight-line code, the same bits in a lane as alone and on every platform.

use super::exponential::LN_2;
use core::f64::consts::SQRT_2;

/// Odd coefficients of the Remez series of ln((1 + s)/(1 − s)) − 2s, as in FreeBSD's e_log.c.
const SERIES: [f64; 7] = [
    6.666_666_666_666_735e-1,
    3.999_999_999_940_942e-1,
    2.857_142_874_366_239e-1,
    2.222_219_843_214_978_4e-1,
    1.818_357_216_161_805e-1,
    1.531_383_769_920_937_3e-1,
    1.479_819_860_511_658_6e-1,
];
/// Bits of 1 and of √½: adding their difference makes the mantissa that of a number from √½ to √2.
const ONE: u64 = 1.0_f64.to_bits();
const HALF_ROOT: u64 = (0.5 * SQRT_2).to_bits();
/// Brings the smallest numbers into the normal range.
const TWO_POW_54: f64 = 18_014_398_509_481_984.0;
/// The fraction's bits.
const MANTISSA: u64 = (1 << 52) - 1;

/// ln x for a positive, finite, normal x, to within 1 ulp or so.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    let shifted = x.to_bits().wrapping_add(ONE - HALF_ROOT);
    // An integer below 2⁵² in the low bits of 2⁵² is that number added to it.
    let k = f64::from_bits((shifted >> 52) | (1075 << 52)) - (4_503_599_627_370_496.0 + 1023.0);
    let f = f64::from_bits((shifted & MANTISSA) + HALF_ROOT) - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let mut sum = SERIES[6];
    for c in SERIES[..6].iter().rev() {
        sum = sum * z + *c;
    }
    let half = 0.5 * f * f;
    k * LN_2[0] - ((half - (s * (half + z * sum) + k * LN_2[1])) - f)
}

/// ln x of any number: −∞ of zero, NaN of what is negative or not a number.
#[inline(always)]
pub(crate) fn log(x: f64) -> f64 {
    if (f64::MIN_POSITIVE..f64::INFINITY).contains(&x) {
        ln(x)
    } else if x == f64::INFINITY {
        x
    } else if x > 0.0 {
        ln(x * TWO_POW_54) - 54.0 * (LN_2[0] + LN_2[1])
    } else if x == 0.0 {
        f64::NEG_INFINITY
    } else {
        f64::NAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library_everywhere() {
        let mut x = 1e-300_f64;
        while x < 1e300 {
            let error = (ln(x) - x.ln()).abs();
            assert!(error <= 4e-16 * x.ln().abs().max(1e-3), "{x}: {error}");
            x *= 1.013;
        }
        for x in [5e-324, 1e-310, 0.0, f64::INFINITY] {
            assert!(log(x) == x.ln() || (log(x) / x.ln() - 1.0).abs() < 4e-16, "{x}");
        }
        assert!(log(-1.0).is_nan() && log(f64::NAN).is_nan());
        assert_eq!(ln(1.0), 0.0);
        assert!((ln(1.0 + 1e-9) / (1.0_f64 + 1e-9).ln() - 1.0).abs() < 1e-15);
    }
}
