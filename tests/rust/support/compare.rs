//! When two arrays count as equal.

use proptest::prelude::*;

/// Equal to 1e-10, relative to the largest expected entry or 1; never with a NaN.
pub(crate) fn check_close(found: &[f64], expected: &[f64]) -> Result<(), TestCaseError> {
    prop_assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1.0_f64, |scale, e| scale.max(e.abs()));
    let close = |(f, e): (&f64, &f64)| (f - e).abs() <= 1e-10 * scale;
    prop_assert!(found.iter().zip(expected).all(close), "found {found:?}\nexpected {expected:?}");
    Ok(())
}

/// Equal to the last bit, the sign of zero included.
pub(crate) fn check_same_bits(found: &[f64], expected: &[f64]) -> Result<(), TestCaseError> {
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    prop_assert!(bits(found) == bits(expected), "found {found:?}\nexpected {expected:?}");
    Ok(())
}
