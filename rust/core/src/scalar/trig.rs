//! Sine and cosine that vectorise: straight-line code, the same bits in a lane as alone and on every platform.

/// 2/π.
const TWO_OVER_PI: f64 = core::f64::consts::FRAC_2_PI;
/// π/2 in two parts of 33 significant bits and a rest: `k · part` is exact up to [`LIMIT`] (Cody and Waite 1980).
const HALF_PI: [f64; 3] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21];
/// Adding and subtracting 1.5·2⁵² rounds to the nearest integer, and leaves it in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// Beyond 2²⁰ quarter turns the three-part reduction loses its guarantee; the standard library takes over.
const LIMIT: f64 = 1.6e6;

/// Coefficients in r² of the Remez polynomials (sin r − r)/r³ and (cos r − 1 + r²/2)/r⁴ on |r| ≤ π/4.
const SIN: [f64; 6] = [
    -1.666_666_666_666_663_2e-1,
    8.333_333_333_322_49e-3,
    -1.984_126_982_985_795e-4,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];
const COS: [f64; 6] = [
    4.166_666_666_666_66e-2,
    -1.388_888_888_887_411e-3,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];

/// `(sin x, cos x)`.
#[inline(always)]
pub(super) fn sin_cos(x: f64) -> (f64, f64) {
    if is_reducible(x) { reduced(x) } else { x.sin_cos() }
}

/// Whether [`reduced`] may be used; NaN and infinity may not.
#[inline(always)]
pub(super) fn is_reducible(x: f64) -> bool {
    x.abs() <= LIMIT
}

/// Reduction to |r| ≤ π/4, two polynomials, and a choice by quadrant, without a branch.
#[inline(always)]
pub(super) fn reduced(x: f64) -> (f64, f64) {
    let shifted = x * TWO_OVER_PI + ROUND;
    let quadrant = shifted.to_bits();
    let k = shifted - ROUND;
    let r = ((x - k * HALF_PI[0]) - k * HALF_PI[1]) - k * HALF_PI[2];
    let s = r * r;
    let sin = r + r * s * horner(&SIN, s);
    let cos = 1.0 - (0.5 * s - s * s * horner(&COS, s));
    let (a, b) = if quadrant & 1 == 0 { (sin, cos) } else { (cos, sin) };
    (with_sign(a, quadrant & 2), with_sign(b, quadrant.wrapping_add(1) & 2))
}

/// Σ cₖ sᵏ.
#[inline(always)]
fn horner(c: &[f64; 6], s: f64) -> f64 {
    c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
}

/// Flips the sign when `two` is 2, keeps it when it is 0.
#[inline(always)]
fn with_sign(x: f64, two: u64) -> f64 {
    f64::from_bits(x.to_bits() ^ (two << 62))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library_everywhere() {
        let mut x = 1e-9_f64;
        while x < 1e8 {
            for y in [x, -x, x.rem_euclid(7.0), (x / HALF_PI[0]).round() * core::f64::consts::FRAC_PI_2] {
                let (s, c) = sin_cos(y);
                assert!((s - y.sin()).abs() < 2.3e-16 && (c - y.cos()).abs() < 2.3e-16, "{y}");
            }
            x *= 1.000_37;
        }
    }

    #[test]
    fn keeps_zero_and_rejects_nothing() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert!(sin_cos(f64::NAN).0.is_nan() && sin_cos(f64::INFINITY).1.is_nan());
    }
}
