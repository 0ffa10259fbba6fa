//! Requests to stop, which long work looks for once a sample.
//!
//! Who starts the work says how to learn of a request; who does it asks [`Watch::stops`], which costs a few
//! instructions. A watch belongs to the thread that it was set on, and [`parallel`](crate::parallel) hands it to others.

use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicBool, Ordering};
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two questions, about.
const EVERY: Duration = Duration::from_millis(20);

thread_local! {
    static CURRENT: RefCell<Watch> = const { RefCell::new(Watch { stop: None, asker: None }) };
}

/// What tells work whether it is to stop; nothing does by default.
#[derive(Clone, Default)]
pub struct Watch {
    /// Shared by all threads of the work.
    stop: Option<Arc<AtomicBool>>,
    /// Of the thread that watches.
    asker: Option<Rc<Asker>>,
}

/// Asks whether to stop, about every [`EVERY`].
struct Asker {
    ask: Box<dyn Fn() -> bool>,
    /// Calls until the clock is looked at, and how many of them take about half of [`EVERY`].
    left: Cell<u32>,
    pace: Cell<u32>,
    last: Cell<Instant>,
}

impl Asker {
    #[inline(always)]
    fn asks(&self) -> bool {
        let left = self.left.get();
        self.left.set(left.saturating_sub(1));
        left == 0 && self.look()
    }

    /// Looks at the clock, and at it again after as many calls as take about half of [`EVERY`].
    #[cold]
    fn look(&self) -> bool {
        let passed = self.last.get().elapsed();
        let pace = self.pace.get();
        if passed < EVERY / 2 {
            self.pace.set(pace.saturating_mul(2));
        } else if passed > EVERY {
            self.pace.set((pace / 2).max(1));
        }
        self.left.set(self.pace.get());
        self.last.set(Instant::now());
        (self.ask)()
    }
}

impl Watch {
    /// The watch of this thread. Work takes it once and asks it often.
    pub fn current() -> Self {
        CURRENT.with_borrow(Self::clone)
    }

    /// Whether to stop now.
    #[inline(always)]
    pub fn stops(&self) -> bool {
        let Some(stop) = &self.stop else { return false };
        if self.asker.as_ref().is_some_and(|asker| asker.asks()) {
            stop.store(true, Ordering::Relaxed);
        }
        stop.load(Ordering::Relaxed)
    }

    /// Whether to stop now, for a thread that has nothing to do but wait.
    pub(crate) fn stops_while_idle(&self) -> bool {
        if let Some(asker) = &self.asker {
            asker.left.set(0);
        }
        self.stops()
    }

    /// What another thread is to look at.
    pub(crate) fn shared(&self) -> Option<Arc<AtomicBool>> {
        self.stop.clone()
    }

    /// Does `work` under a watch that another thread [shares](Self::shared).
    pub(crate) fn follow<T>(stop: Option<Arc<AtomicBool>>, work: impl FnOnce() -> T) -> T {
        Self { stop, asker: None }.over(work)
    }

    fn over<T>(self, work: impl FnOnce() -> T) -> T {
        /// Puts back the watch that was, however `work` ends.
        struct Before(Watch);
        impl Drop for Before {
            fn drop(&mut self) {
                CURRENT.replace(core::mem::take(&mut self.0));
            }
        }
        let _before = Before(CURRENT.replace(self));
        work()
    }
}

/// Does `work`, asking `ask` now and then on this thread whether to stop; once it says so, the work returns early, with an
/// error where it can give one.
///
/// ```
/// use linkside_core::interrupt::{Watch, watched};
/// let work = || (0..u64::MAX).take_while(|_| !Watch::current().stops()).last();
/// assert!(watched(|| true, work).is_none_or(|turns| turns < u64::MAX)); // asked, and told to stop
/// ```
pub fn watched<T>(ask: impl Fn() -> bool + 'static, work: impl FnOnce() -> T) -> T {
    let asker = Asker { ask: Box::new(ask), left: Cell::new(0), pace: Cell::new(1), last: Cell::new(Instant::now()) };
    Watch { stop: Some(Arc::new(AtomicBool::new(false))), asker: Some(Rc::new(asker)) }.over(work)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_stops_soon_after_it_was_asked_to_and_the_watch_ends_with_it() {
        for size in [1_u64, 1000] {
            let since = Instant::now();
            let asked = Rc::new(Cell::new(0));
            let count = Rc::clone(&asked);
            let ask = move || {
                count.set(count.get() + 1);
                since.elapsed() > Duration::from_millis(100)
            };
            let calls = watched(ask, || {
                let (watch, mut calls) = (Watch::current(), 0_u64);
                while !watch.stops() {
                    calls += 1;
                    core::hint::black_box((0..size).fold(calls, |a, b| a ^ core::hint::black_box(b)));
                }
                calls
            });
            assert!(since.elapsed() < Duration::from_millis(250), "{:?} with {size}", since.elapsed());
            assert!(calls > 100 && asked.get() < 200, "{calls} calls, asked {} times", asked.get());
            assert!(!Watch::current().stops());
        }
    }
}
