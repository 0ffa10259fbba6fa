//! Whatever a program calls in whatever order, with whatever numbers: no panic, and no estimate that is not a number.
//!
//! This is what stands for the bounds of the indices in a step: the lengths of all arrays are set when an estimator is
//! made, and of a sample they are checked, so that no number in a sample changes which entries are touched.
#![allow(unsafe_code)] // the C interface

use linkside::{
    LinksideEstimator, LinksideResult, LinksideSample, linkside_covariance, linkside_free, linkside_from_bytes,
    linkside_reset, linkside_states, linkside_step, linkside_values, linkside_width,
};
use proptest::prelude::*;
use std::ffi::CStr;
use std::{ptr, slice};

const FILES: [&[u8]; 4] = [
    include_bytes!("../data/compiled/observer.lsr"),
    include_bytes!("../data/compiled/ekf.lsr"),
    include_bytes!("../data/compiled/elastic-ekf.lsr"),
    include_bytes!("../data/compiled/velocity.lsr"),
];

const SIGNALS: usize = 12;

/// Numbers of a sample: eleven signals of at most eight each.
const NUMBERS: usize = 8 * SIGNALS;

#[derive(Clone, Debug)]
enum Call {
    Step { dt: f64, there: [bool; SIGNALS], numbers: Vec<f64> },
    Reset,
    Covariance { short: bool },
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        20 => -2.0..2.0f64,
        2 => Just(f64::NAN),
        1 => prop_oneof![Just(f64::INFINITY), Just(f64::NEG_INFINITY)],
        1 => prop_oneof![Just(1e308), Just(-1e308), Just(1e160), Just(-1e20), Just(5e-324), Just(-0.0)],
    ]
}

fn call() -> impl Strategy<Value = Call> {
    let dt = prop_oneof![10 => Just(1e-3), 1 => number(), 1 => Just(0.0), 1 => Just(1e-300), 1 => Just(1e300)];
    // Either plain numbers, so that runs of good samples come about, or any.
    let numbers = prop_oneof![prop::collection::vec(-2.0..2.0f64, NUMBERS), prop::collection::vec(number(), NUMBERS),];
    let there = prop::array::uniform12(prop::bool::weighted(0.9));
    prop_oneof![
        20 => (dt, there, numbers).prop_map(|(dt, there, numbers)| Call::Step { dt, there, numbers }),
        1 => Just(Call::Reset),
        1 => any::<bool>().prop_map(|short| Call::Covariance { short }),
    ]
}

/// An estimator as a C program holds it.
struct Held(*mut LinksideEstimator);

impl Held {
    fn new(file: &[u8]) -> Self {
        let mut made = ptr::null_mut();
        // SAFETY: a file in memory, and a place for the pointer.
        assert_eq!(
            unsafe { linkside_from_bytes(file.as_ptr(), file.len(), &raw mut made) },
            LinksideResult::LinksideOk
        );
        Self(made)
    }

    fn step(&self, dt: f64, there: &[bool; SIGNALS], numbers: &[f64]) -> LinksideResult {
        for name in [c"theta", c"tau", c"acceleration", c"ddqref"] {
            // SAFETY: an estimator and a name.
            assert!(unsafe { linkside_width(self.0, name.as_ptr()) } <= 8);
        }
        let at = |i: usize| if there[i] { numbers[8 * i..].as_ptr() } else { ptr::null() };
        let sample = LinksideSample {
            dt,
            theta: at(0),
            dtheta: at(1),
            tau: at(2),
            acceleration: at(3),
            rate: at(4),
            q: at(5),
            dq: at(6),
            ddq: at(7),
            torque: at(8),
            ddqref: at(9),
            wrench: at(10),
            position: at(11),
        };
        // SAFETY: each signal has as many numbers as any is wide.
        unsafe { linkside_step(self.0, &raw const sample) }
    }

    fn values(&self, name: &CStr) -> &[f64] {
        let mut length = 0;
        // SAFETY: an estimator, a name, and a place for the length.
        let values = unsafe { linkside_values(self.0, name.as_ptr(), &raw mut length) };
        // SAFETY: as many as it says.
        if values.is_null() { &[] } else { unsafe { slice::from_raw_parts(values, length) } }
    }

    fn call(&self, call: &Call) -> LinksideResult {
        match call {
            Call::Step { dt, there, numbers } => self.step(*dt, there, numbers),
            // SAFETY: an estimator.
            Call::Reset => unsafe { linkside_reset(self.0) },
            Call::Covariance { short } => {
                // SAFETY: an estimator.
                let states = unsafe { linkside_states(self.0) };
                let mut out = vec![0.0; (states * states).saturating_sub(usize::from(*short))];
                // SAFETY: an estimator and an array.
                unsafe { linkside_covariance(self.0, out.as_mut_ptr(), out.len()) }
            }
        }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        // SAFETY: made by `new`, and not used again.
        unsafe { linkside_free(self.0) };
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_order_of_calls_and_no_numbers_make_a_panic(which in 0..FILES.len(), calls in prop::collection::vec(call(), 1..60)) {
        let estimator = Held::new(FILES[which]);
        for call in &calls {
            let result = estimator.call(call);
            prop_assert_ne!(result, LinksideResult::LinksideFault);
            prop_assert_ne!(result, LinksideResult::LinksideNull);
            if matches!(call, Call::Step { .. }) && result == LinksideResult::LinksideOk {
                for name in [c"t", c"q", c"dq", c"ddq"] {
                    prop_assert!(estimator.values(name).iter().all(|x| x.is_finite()), "{:?} {:?}", name, estimator.values(name));
                }
            }
        }
        prop_assert_eq!(estimator.call(&Call::Reset), LinksideResult::LinksideOk);
        let rest = vec![0.1; NUMBERS];
        for _ in 0..20 {
            prop_assert_eq!(estimator.step(1e-3, &[true; SIGNALS], &rest), LinksideResult::LinksideOk);
        }
    }
}

#[test]
fn an_acceleration_beyond_all_numbers_loses_the_estimate_of_an_observer() {
    let estimator = Held::new(FILES[0]);
    let mut numbers = vec![0.0; NUMBERS];
    numbers[8 * 3 + 2] = 1e308;
    assert_eq!(estimator.step(1e-3, &[true; SIGNALS], &numbers), LinksideResult::LinksideLost);
    numbers[8 * 3 + 2] = 9.81;
    assert_eq!(estimator.step(1e-3, &[true; SIGNALS], &numbers), LinksideResult::LinksideOk);
}
