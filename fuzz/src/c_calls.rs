//! The C interface: any order of calls, with pointers that are right or null.
#![allow(unsafe_code)]

use super::bytes::Bytes;
use super::calls::FILES;
use linkside::{
    LinksideEstimator, LinksideResult, LinksideSample, linkside_covariance, linkside_error, linkside_free,
    linkside_from_bytes, linkside_joints, linkside_last_error, linkside_method, linkside_name, linkside_period,
    linkside_read, linkside_reset, linkside_states, linkside_status, linkside_step, linkside_values, linkside_width,
};
use std::ffi::{CStr, c_char};
use std::{ptr, slice};

const NAMES: [&CStr; 9] =
    [c"theta", c"tau", c"acceleration", c"q", c"dq", c"ddq", c"q_std", c"tool_position", c"no such name"];
const MOST: usize = 64;

fn text(pointer: *const c_char) {
    if !pointer.is_null() {
        // SAFETY: the interface gives texts that end.
        assert!(unsafe { CStr::from_ptr(pointer) }.to_str().is_ok());
    }
}

/// Calls, on an estimator or on none.
pub fn c_interface(data: &[u8]) {
    let mut bytes = Bytes(data);
    let mut made: *mut LinksideEstimator = ptr::null_mut();
    let file = match bytes.below(8) {
        0 => bytes.block(),
        index => FILES[index % FILES.len()],
    };
    // SAFETY: bytes with their length, and a place for the pointer.
    unsafe { linkside_from_bytes(file.as_ptr(), file.len(), &raw mut made) };
    while !bytes.is_empty() {
        let held = if bytes.below(24) == 0 { ptr::null_mut() } else { made };
        let name = match bytes.below(NAMES.len() + 1) {
            index if index < NAMES.len() => NAMES[index].as_ptr(),
            _ => ptr::null(),
        };
        call(held, name, &mut bytes);
    }
    // SAFETY: it is not used again.
    unsafe { linkside_free(made) };
}

fn call(held: *mut LinksideEstimator, name: *const c_char, bytes: &mut Bytes<'_>) {
    // SAFETY: an estimator or null, a text or null, arrays with their lengths.
    unsafe {
        match bytes.below(12) {
            0 => assert!(linkside_reset(held) != LinksideResult::LinksideFault),
            1 => {
                let mut length = 0;
                let values = linkside_values(held, name, &raw mut length);
                if !values.is_null() {
                    let _ = slice::from_raw_parts(values, length).iter().sum::<f64>();
                }
            }
            2 => {
                let mut out = vec![0.0; linkside_states(held).pow(2) + usize::from(bytes.flag())];
                assert!(linkside_covariance(held, out.as_mut_ptr(), out.len()) != LinksideResult::LinksideFault);
            }
            3 => {
                text(linkside_name(held, name, bytes.below(20)));
                text(linkside_method(held));
                text(linkside_error(held));
                text(linkside_last_error());
            }
            4 => {
                let _ =
                    (linkside_joints(held), linkside_width(held, name), linkside_period(held), linkside_status(held));
            }
            5 => {
                let mut out = ptr::null_mut();
                let found = linkside_read(name, &raw mut out);
                assert!(found != LinksideResult::LinksideFault && out.is_null());
            }
            _ => {
                let numbers = bytes.numbers(MOST);
                let mut at = || if bytes.below(8) == 0 { ptr::null() } else { numbers.as_ptr() };
                let sample = LinksideSample {
                    dt: 1e-3,
                    theta: at(),
                    dtheta: at(),
                    tau: at(),
                    acceleration: at(),
                    rate: at(),
                    q: at(),
                    dq: at(),
                    ddq: at(),
                    torque: at(),
                    ddqref: at(),
                    wrench: at(),
                    position: at(),
                };
                assert!(linkside_step(held, &raw const sample) != LinksideResult::LinksideFault);
            }
        }
    }
}
