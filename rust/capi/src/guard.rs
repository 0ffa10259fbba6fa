//! No panic passes into C.

use crate::LinksideResult;
use crate::handle::Handle;
use linkside_core::error::RunError;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What `work` gives, or nothing if it panics.
pub(crate) fn guarded<T>(work: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(work)).ok()
}

/// Works on an estimator, and keeps why it fails. One that has panicked is of no use any more, and is not touched again.
pub(crate) fn outcome(handle: &mut Handle, work: impl FnOnce(&mut Handle) -> Result<(), RunError>) -> LinksideResult {
    if handle.broken {
        return LinksideResult::LinksideFault;
    }
    handle.error.clear();
    match guarded(|| work(handle)) {
        Some(Ok(())) => LinksideResult::LinksideOk,
        Some(Err(error)) => {
            handle.error.set(&error);
            match error {
                RunError::Design(_) => LinksideResult::LinksideRefused,
                _ => LinksideResult::LinksideLost,
            }
        }
        None => {
            handle.broken = true;
            handle.error.set(&"a fault of linkside: please report it");
            LinksideResult::LinksideFault
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkside_compiled::{Estimator, demo};

    #[test]
    fn a_panic_is_a_fault_and_the_estimator_is_left_alone_from_then_on() {
        let mut handle = Handle::new(Estimator::new(demo::observer()).unwrap());
        assert_eq!(outcome(&mut handle, |_| Ok(())), LinksideResult::LinksideOk);
        assert_eq!(outcome(&mut handle, |_| panic!("a test's")), LinksideResult::LinksideFault);
        assert_eq!(outcome(&mut handle, |_| panic!("not called")), LinksideResult::LinksideFault);
        assert!(guarded(|| panic!("another")).is_none());
    }
}
