//! Arrays and strings of C.

use std::ffi::{CStr, c_char};
use std::slice;

/// A string; none of null, or of one that is not UTF-8.
///
/// # Safety
/// `pointer` is null or of a string.
pub(crate) unsafe fn text<'a>(pointer: *const c_char) -> Option<&'a str> {
    if pointer.is_null() {
        return None;
    }
    // SAFETY: the caller's promise.
    unsafe { CStr::from_ptr(pointer) }.to_str().ok()
}

/// Bytes; none of null.
///
/// # Safety
/// `pointer` is null or of `length` bytes.
pub(crate) unsafe fn bytes<'a>(pointer: *const u8, length: usize) -> Option<&'a [u8]> {
    // SAFETY: the caller's promise.
    (!pointer.is_null()).then(|| unsafe { slice::from_raw_parts(pointer, length) })
}

/// Numbers to be written; none of null, unless there are to be none.
///
/// # Safety
/// `pointer` is null or of `length` numbers.
pub(crate) unsafe fn numbers<'a>(pointer: *mut f64, length: usize) -> Option<&'a mut [f64]> {
    match (pointer.is_null(), length) {
        (true, 0) => Some(&mut []),
        (true, _) => None,
        // SAFETY: the caller's promise.
        _ => Some(unsafe { slice::from_raw_parts_mut(pointer, length) }),
    }
}
