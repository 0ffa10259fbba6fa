//! What innovations say of the tolerances: where they are larger than these explain, the joint is further off than they say.

use super::correction::WINDOW;
use super::late::READING;

/// What innovations may have beside noise and tolerances, a standard deviation: gears have teeth [rad].
const FLOOR: f64 = READING / 3.0;
/// A number that is off stays so, and shows where the robot moves: time over which that is remembered [s].
const MEMORY: f64 = 10.0;
/// Beyond three standard deviations it is a contradiction, and no question of size.
const MOST: f64 = 9.0;

/// The mean square of a joint's innovations in multiples of what it is to be, as large as it lately was.
#[derive(Clone, Copy, Debug)]
pub(super) struct Excess {
    /// Time between two looks, and that since the first [s].
    interval: f64,
    time: f64,
    ratio: f64,
}

impl Excess {
    pub(super) fn new(interval: f64) -> Self {
        Self { interval, time: 0.0, ratio: 1.0 }
    }

    /// Before the first sample.
    pub(super) fn reset(&mut self) {
        (self.time, self.ratio) = (0.0, 1.0);
    }

    /// Looks at the mean square of innovations, and what it is to be [rad²].
    #[inline(always)]
    pub(super) fn take(&mut self, [found, expected]: [f64; 2]) {
        self.time += self.interval;
        // A mean over few samples is one of chance.
        if self.time > 2.0 * WINDOW {
            let faded = 1.0 + (self.ratio - 1.0) * (1.0 - (self.interval / MEMORY).min(1.0));
            self.ratio = (found / (expected + FLOOR * FLOOR)).clamp(faded, MOST);
        }
    }

    /// By how much variances are to be larger than tolerances say; at least 1.
    #[inline(always)]
    pub(super) fn factor(&self) -> f64 {
        self.ratio
    }
}
