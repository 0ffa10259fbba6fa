//! Checks of lengths and ranges, once, at the boundary: below it kernels do not fail.

use crate::error::{DesignError, RobotError};

/// Beyond this nothing is an estimate, in whatever unit; below it nothing overflows that is computed from estimates,
/// such as the velocity of a motor from products of three of the link's.
pub(crate) const LARGEST: f64 = 1e100;

/// Whether all of them can be parts of an estimate: numbers, none of them extreme.
#[inline(always)]
pub(crate) fn are_sound<'a>(values: impl IntoIterator<Item = &'a f64>) -> bool {
    values.into_iter().all(|x| x.abs() <= LARGEST)
}

/// # Errors
/// Another number of entries than `expected`.
pub(crate) fn expect_length(what: &'static str, found: usize, expected: usize) -> Result<(), DesignError> {
    if found == expected { Ok(()) } else { Err(DesignError::Length { what, found, expected }) }
}

/// # Errors
/// Fewer entries than `least`.
pub(crate) fn expect_at_least(what: &'static str, found: usize, least: usize) -> Result<(), DesignError> {
    expect_length(what, found, found.max(least))
}

/// Refuses `value` unless `ok`.
pub(crate) fn expect(ok: bool, what: &'static str, value: f64, expected: &'static str) -> Result<(), DesignError> {
    if ok { Ok(()) } else { Err(DesignError::Range { what, value, expected }) }
}

/// # Errors
/// The first of `values` that is not `good`.
pub(crate) fn expect_each(
    what: &'static str,
    values: &[f64],
    good: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Result<(), DesignError> {
    values.iter().try_for_each(|&value| expect(good(value), what, value, expected))
}

/// # Errors
/// A number that is not finite.
pub(crate) fn expect_finite(what: &'static str, values: &[f64]) -> Result<(), DesignError> {
    expect_each(what, values, f64::is_finite, "finite numbers")
}

/// # Errors
/// A value that is infinite; NaN is one that is missing.
pub(crate) fn refuse_infinite(what: &'static str, values: &[f64]) -> Result<(), DesignError> {
    match values.iter().position(|x| x.is_infinite()) {
        Some(index) => Err(DesignError::Infinite { what, index, value: values[index] }),
        None => Ok(()),
    }
}

/// # Errors
/// Another number of standard deviations than `expected`, or one that is negative or not finite.
pub(crate) fn check_deviations(what: &'static str, values: &[f64], expected: usize) -> Result<(), DesignError> {
    expect_length(what, values.len(), expected)?;
    expect_each(what, values, |v| v.is_finite() && v >= 0.0, "a standard deviation of at least 0")?;
    expect_each(what, values, |v| v <= LARGEST, "at most 1e100")
}

/// # Errors
/// Another number of times than `expected`, or one that is not greater than 0.
pub(crate) fn check_times(values: &[f64], expected: usize) -> Result<(), DesignError> {
    expect_length("bias_time", values.len(), expected)?;
    expect_each("bias_time", values, |v| v > 0.0, "a time greater than 0")
}

/// # Errors
/// A step between `times` that is not greater than 0.
pub(crate) fn expect_rising(what: &'static str, times: &[f64]) -> Result<(), DesignError> {
    times.windows(2).try_for_each(|w| expect(w[1] > w[0], what, w[1] - w[0], "a step of time greater than 0"))
}

/// # Errors
/// A reading without noise.
pub(crate) fn check_readings(values: &[f64]) -> Result<(), DesignError> {
    expect_each("reading", values, |v| v != 0.0, "greater than 0")
}

/// # Errors
/// Another number of parts of a robot than `expected`.
pub(crate) fn expect_parts(what: &'static str, found: usize, expected: usize) -> Result<(), RobotError> {
    if found == expected { Ok(()) } else { Err(RobotError::Length { what, found, expected }) }
}

/// Refuses a robot's `value` unless `ok`.
pub(crate) fn expect_of(
    ok: bool,
    what: &'static str,
    owner: impl FnOnce() -> String,
    value: f64,
    expected: &'static str,
) -> Result<(), RobotError> {
    if ok { Ok(()) } else { Err(RobotError::Range { what, owner: owner(), value, expected }) }
}
