//! Room for what grows with the input, refused where there is none.

use crate::error::DesignError;

/// An empty vector with room for `count` rows of `width` values.
///
/// # Errors
/// [`DesignError::Memory`]: the system does not have it.
pub fn room<T>(count: usize, width: usize) -> Result<Vec<T>, DesignError> {
    let mut values = Vec::new();
    let size = count.checked_mul(width);
    let bytes = count as f64 * width as f64 * size_of::<T>() as f64;
    size.and_then(|size| values.try_reserve_exact(size).ok()).ok_or(DesignError::Memory { bytes })?;
    Ok(values)
}

/// `count` rows of `width` values, all `value`.
///
/// # Errors
/// As [`room`].
pub fn filled<T: Clone>(value: T, count: usize, width: usize) -> Result<Vec<T>, DesignError> {
    let mut values = room(count, width)?;
    values.resize(count * width, value);
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_refused_with_its_size() {
        assert_eq!(filled(1.5, 2, 3), Ok(vec![1.5; 6]));
        for (count, width) in [(1 << 46, 1), (usize::MAX, 2)] {
            let error = filled(0.0, count, width).unwrap_err();
            assert!(matches!(error, DesignError::Memory { bytes } if bytes >= 5e14), "{error}");
        }
    }
}
