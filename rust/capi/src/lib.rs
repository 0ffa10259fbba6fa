//! The C interface of linkside's estimators: `linkside.h` describes it, which cbindgen writes of what is here.
//!
//! Each function checks its pointers, lets no panic through, and is otherwise a call of
//! [`linkside_compiled::Estimator`].
// Nothing a user gives makes a panic: what cannot fail says why where it is.
#![deny(
    clippy::expect_used,
    clippy::panic,
    clippy::todo,
    clippy::unimplemented,
    clippy::unreachable,
    clippy::unwrap_used
)]
#![allow(unsafe_code)] // pointers from C

mod guard;
mod handle;
mod message;
mod pointers;

use guard::{guarded, outcome};
use handle::Handle;
use linkside_compiled::{Estimator, FileError, Signal};
use message::Message;
use pointers::{bytes, numbers, text};
use std::cell::RefCell;
use std::ffi::{c_char, c_int};
use std::ptr;

/// An estimator, made by `linkside_read` or `linkside_from_bytes`.
pub struct LinksideEstimator(Handle);

/// The result of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(clippy::enum_variant_names)] // C has no names within names
pub enum LinksideResult {
    /// It is done.
    LinksideOk = 0,
    /// The sample, or an argument, cannot be used; everything is as it was before the call.
    LinksideRefused = 1,
    /// The sample's readings are so extreme that no estimate is left; the next sample starts again.
    LinksideLost = 2,
    /// A pointer is null that must not be.
    LinksideNull = 3,
    /// The file cannot be used: read `linkside_last_error`.
    LinksideFile = 4,
    /// A fault of this library: every later call of the estimator returns the same. Please report it.
    LinksideFault = 5,
}

/// Some combination of accelerations was damped near a singular posture.
pub const LINKSIDE_DAMPED: u8 = 1;
/// A reading was missing and bridged.
pub const LINKSIDE_BRIDGED: u8 = 2;
/// Some combination of accelerations was not observed at all.
pub const LINKSIDE_UNSEEN: u8 = 4;
/// A reading was left out as an outlier.
pub const LINKSIDE_GATED: u8 = 8;
/// No reading was used: the estimate is a prediction.
pub const LINKSIDE_PREDICTED: u8 = 16;
/// An encoder wrapped, and its jump was removed.
pub const LINKSIDE_UNWRAPPED: u8 = 32;
/// Readings contradict the model: do not use the estimate and its standard deviations.
pub const LINKSIDE_CONTRADICTED: u8 = 64;
/// One channel contradicts the model and all others.
pub const LINKSIDE_FAULTY: u8 = 128;

/// One sample of a robot's signals, on the link side of gears, in SI units; NaN where a reading is missing.
///
/// Each signal is an array of as many numbers as `linkside_width` says, or null where it is missing. A signal that the
/// estimator does not read is ignored. Begin with `{0}`, so that fields you do not set are null.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct LinksideSample {
    /// Time since the sample before [s]; filters need it, observers have the period that they were designed for.
    pub dt: f64,
    /// Motor positions [rad].
    pub theta: *const f64,
    /// Motor velocities [rad/s].
    pub dtheta: *const f64,
    /// Motor torques [N m].
    pub tau: *const f64,
    /// Accelerometer channels [m/s²].
    pub acceleration: *const f64,
    /// Gyroscope channels [rad/s].
    pub rate: *const f64,
    /// Link positions [rad].
    pub q: *const f64,
    /// Link velocities [rad/s].
    pub dq: *const f64,
    /// Link accelerations [rad/s²].
    pub ddq: *const f64,
    /// Torques of joint torque sensors [N m].
    pub torque: *const f64,
    /// Commanded link accelerations [rad/s²].
    pub ddqref: *const f64,
    /// Forces and moments from outside that sensors measure, six numbers each [N, N m].
    pub wrench: *const f64,
    /// Channels of trackers [m].
    pub position: *const f64,
}

thread_local! {
    /// Why the last call that makes estimators failed on this thread.
    static LAST: RefCell<Message> = const { RefCell::new(Message::EMPTY) };
}

fn made(build: impl FnOnce() -> Result<Estimator, FileError>, out: *mut *mut LinksideEstimator) -> LinksideResult {
    if out.is_null() {
        return LinksideResult::LinksideNull;
    }
    // SAFETY: not null, and the caller's to be written.
    unsafe { out.write(ptr::null_mut()) };
    let say = |text: &dyn std::fmt::Display| LAST.with_borrow_mut(|last| last.set(text));
    match guarded(build) {
        Some(Ok(estimator)) => {
            let handle = Box::new(LinksideEstimator(Handle::new(estimator)));
            // SAFETY: as above.
            unsafe { out.write(Box::into_raw(handle)) };
            LinksideResult::LinksideOk
        }
        Some(Err(error)) => {
            say(&error);
            LinksideResult::LinksideFile
        }
        None => {
            say(&"a fault of linkside: please report it");
            LinksideResult::LinksideFault
        }
    }
}

/// Reads the file at `path`, which `linkside compile` has written, and makes its estimator; `*out` is null where it fails.
///
/// # Safety
/// `path` is a string, `out` may be written. Free the estimator with `linkside_free`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_read(path: *const c_char, out: *mut *mut LinksideEstimator) -> LinksideResult {
    // SAFETY: the caller's promise.
    match unsafe { text(path) } {
        Some(path) => made(|| Estimator::read(path), out),
        None => LinksideResult::LinksideNull,
    }
}

/// Like `linkside_read`, from the `length` bytes of a file in memory.
///
/// # Safety
/// `content` has `length` bytes, `out` may be written. Free the estimator with `linkside_free`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_from_bytes(
    content: *const u8,
    length: usize,
    out: *mut *mut LinksideEstimator,
) -> LinksideResult {
    // SAFETY: the caller's promise.
    match unsafe { bytes(content, length) } {
        Some(content) => made(|| Estimator::from_bytes(content), out),
        None => LinksideResult::LinksideNull,
    }
}

/// Frees an estimator; null is ignored.
///
/// # Safety
/// `estimator` came from this library, and is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_free(estimator: *mut LinksideEstimator) {
    if !estimator.is_null() {
        // SAFETY: the caller's promise.
        drop(unsafe { Box::from_raw(estimator) });
    }
}

/// Why the last `linkside_read` or `linkside_from_bytes` of this thread failed; valid until its next one.
#[unsafe(no_mangle)]
pub extern "C" fn linkside_last_error() -> *const c_char {
    LAST.with_borrow(Message::as_ptr)
}

/// Why the last call on this estimator failed; empty where none has. Valid until its next call.
///
/// # Safety
/// `estimator` is one, or null, which gives null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_error(estimator: *const LinksideEstimator) -> *const c_char {
    // SAFETY: the caller's promise.
    unsafe { estimator.as_ref() }.map_or(ptr::null(), |estimator| estimator.0.error.as_ptr())
}

/// Takes one sample; afterwards what `linkside_values` points to is the estimate at its time.
///
/// # Safety
/// `estimator` is one, `sample` a sample with as many numbers a signal as `linkside_width` says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_step(
    estimator: *mut LinksideEstimator,
    sample: *const LinksideSample,
) -> LinksideResult {
    // SAFETY: the caller's promise.
    let (Some(estimator), Some(sample)) = (unsafe { estimator.as_mut() }, unsafe { sample.as_ref() }) else {
        return LinksideResult::LinksideNull;
    };
    outcome(&mut estimator.0, |handle| {
        // SAFETY: the caller's promise.
        let sample = unsafe { handle.sample(sample) };
        handle.estimator.step(&sample)
    })
}

/// Forgets all samples: the next one starts again.
///
/// # Safety
/// `estimator` is one, or null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_reset(estimator: *mut LinksideEstimator) -> LinksideResult {
    // SAFETY: the caller's promise.
    let Some(estimator) = (unsafe { estimator.as_mut() }) else { return LinksideResult::LinksideNull };
    outcome(&mut estimator.0, |handle| {
        handle.estimator.reset();
        Ok(())
    })
}

/// A part of the estimate by name: `t`, `q`, `dq`, `ddq`, `theta`, `dtheta`, `tool_position`; of filters and of the
/// acceleration-driven observer also `q_std`, `tool_std`; of filters `disturbance`, `disturbance_std`, `wrench`, `wrench_std`,
/// `nis`, `log_likelihood`, `used`, `state`; of velocity observers `level`.
///
/// Null of a name that the estimator does not have. The pointer, and `*length`, stay valid until `linkside_free`: ask once,
/// before the loop. NaN before there is an estimate.
///
/// # Safety
/// `estimator` is one or null, `name` a string, `length` may be written or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_values(
    estimator: *const LinksideEstimator,
    name: *const c_char,
    length: *mut usize,
) -> *const f64 {
    // SAFETY: the caller's promise.
    let found = match (unsafe { estimator.as_ref() }, unsafe { text(name) }) {
        (Some(estimator), Some(name)) => estimator.0.estimator.get(name),
        _ => None,
    };
    if !length.is_null() {
        // SAFETY: the caller's promise.
        unsafe { length.write(found.map_or(0, <[f64]>::len)) };
    }
    found.map_or(ptr::null(), <[f64]>::as_ptr)
}

/// Status of the last sample, a sum of `LINKSIDE_DAMPED` and the other flags; 0 is good.
///
/// # Safety
/// `estimator` is one, or null, which gives 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_status(estimator: *const LinksideEstimator) -> u8 {
    // SAFETY: the caller's promise.
    unsafe { estimator.as_ref() }.map_or(0, |estimator| estimator.0.estimator.status())
}

/// Writes the covariance of a filter's `state`, by rows, into `out` of `length` numbers: the square of `linkside_states`.
///
/// # Safety
/// `estimator` is one, `out` has `length` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_covariance(
    estimator: *mut LinksideEstimator,
    out: *mut f64,
    length: usize,
) -> LinksideResult {
    // SAFETY: the caller's promise.
    let (Some(estimator), Some(out)) = (unsafe { estimator.as_mut() }, unsafe { numbers(out, length) }) else {
        return LinksideResult::LinksideNull;
    };
    outcome(&mut estimator.0, |handle| Ok(handle.estimator.covariance_into(out)?))
}

/// Number of states of a filter; 0 of an observer, which has no covariance.
///
/// # Safety
/// `estimator` is one, or null, which gives 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_states(estimator: *const LinksideEstimator) -> usize {
    // SAFETY: the caller's promise.
    unsafe { estimator.as_ref() }.map_or(0, |estimator| estimator.0.estimator.states())
}

/// Number of joints.
///
/// # Safety
/// `estimator` is one, or null, which gives 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_joints(estimator: *const LinksideEstimator) -> usize {
    // SAFETY: the caller's promise.
    unsafe { estimator.as_ref() }.map_or(0, |estimator| estimator.0.estimator.robot().len())
}

/// How many numbers the signal `name` of a sample has, called as the fields of `LinksideSample`; 0 where it is not read.
///
/// # Safety
/// `estimator` is one, or null, `name` a string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_width(estimator: *const LinksideEstimator, name: *const c_char) -> usize {
    // SAFETY: the caller's promise.
    match (unsafe { estimator.as_ref() }, unsafe { text(name) }.and_then(Signal::named)) {
        (Some(estimator), Some(signal)) => estimator.0.estimator.width(signal),
        _ => 0,
    }
}

/// Name of entry `index` of the signal `name`: a joint, or a channel of a sensor; null where there is none.
///
/// # Safety
/// `estimator` is one, or null, `name` a string. The answer is valid until `linkside_free`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_name(
    estimator: *const LinksideEstimator,
    name: *const c_char,
    index: usize,
) -> *const c_char {
    // SAFETY: the caller's promise.
    match (unsafe { estimator.as_ref() }, unsafe { text(name) }.and_then(Signal::named)) {
        (Some(estimator), Some(signal)) => estimator.0.name(signal, index),
        _ => ptr::null(),
    }
}

/// The method: `observer`, `ekf`, `elastic-ekf` or `velocity`; null of null.
///
/// # Safety
/// `estimator` is one, or null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_method(estimator: *const LinksideEstimator) -> *const c_char {
    // SAFETY: the caller's promise.
    unsafe { estimator.as_ref() }.map_or(ptr::null(), |estimator| estimator.0.method.as_ptr())
}

/// The sampling period that an observer was designed for [s]; 0 of filters, which take any.
///
/// # Safety
/// `estimator` is one, or null, which gives 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkside_period(estimator: *const LinksideEstimator) -> f64 {
    // SAFETY: the caller's promise.
    unsafe { estimator.as_ref() }.and_then(|estimator| estimator.0.estimator.period()).unwrap_or(0.0)
}

/// Version of this library, 1000 000 major + 1000 minor + patch.
#[unsafe(no_mangle)]
pub extern "C" fn linkside_version() -> c_int {
    let part = |text: &str| text.parse().unwrap_or(0);
    let minor = 1000 * part(env!("CARGO_PKG_VERSION_MINOR"));
    1_000_000 * part(env!("CARGO_PKG_VERSION_MAJOR")) + minor + part(env!("CARGO_PKG_VERSION_PATCH"))
}
