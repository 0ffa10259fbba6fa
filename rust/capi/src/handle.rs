//! What a pointer to an estimator is of.

use crate::LinksideSample;
use crate::message::Message;
use linkside_compiled::{Estimator, Sample, Signal};
use std::ffi::{CString, c_char};
use std::{ptr, slice};

/// An estimator with what C asks it for.
pub(crate) struct Handle {
    pub(crate) estimator: Estimator,
    pub(crate) error: Message,
    /// Whether it has panicked.
    pub(crate) broken: bool,
    pub(crate) method: CString,
    joints: Vec<CString>,
    accelerations: Vec<CString>,
    rates: Vec<CString>,
    /// Numbers of each signal, in the order of [`Signal::ALL`].
    widths: [usize; Signal::ALL.len()],
}

impl Handle {
    pub(crate) fn new(estimator: Estimator) -> Self {
        let description = estimator.description();
        Self {
            method: string(estimator.method()),
            joints: strings(&description.joints),
            accelerations: strings(&description.accelerations),
            rates: strings(&description.rates),
            widths: Signal::ALL.map(|signal| estimator.width(signal)),
            error: Message::EMPTY,
            broken: false,
            estimator,
        }
    }

    /// What an entry of a signal is called.
    pub(crate) fn name(&self, signal: Signal, index: usize) -> *const c_char {
        let names = match signal {
            Signal::Acceleration => &self.accelerations,
            Signal::Rate => &self.rates,
            _ => &self.joints,
        };
        names.get(index).map_or(ptr::null(), |name| name.as_ptr())
    }

    /// A sample of signals that the estimator reads.
    ///
    /// # Safety
    /// Each pointer is null, or for `'a` of as many numbers as the estimator reads of the signal.
    pub(crate) unsafe fn sample<'a>(&self, c: &LinksideSample) -> Sample<'a> {
        let pointers = [
            c.theta,
            c.dtheta,
            c.tau,
            c.acceleration,
            c.rate,
            c.q,
            c.dq,
            c.ddq,
            c.torque,
            c.ddqref,
            c.wrench,
            c.position,
        ];
        let mut signals: [&[f64]; Signal::ALL.len()] = [&[]; _];
        for ((signal, pointer), &width) in signals.iter_mut().zip(pointers).zip(&self.widths) {
            if !pointer.is_null() && width > 0 {
                // SAFETY: the caller's promise.
                *signal = unsafe { slice::from_raw_parts(pointer, width) };
            }
        }
        let [theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position] = signals;
        Sample { dt: c.dt, theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position }
    }
}

fn strings(names: &[String]) -> Vec<CString> {
    names.iter().map(|name| string(name)).collect()
}

/// A name for C, which knows no zeros within.
fn string(name: &str) -> CString {
    CString::new(name.replace('\0', " ")).unwrap_or_default()
}
