//! The gain that jumps with the estimated speed.

use crate::check::{expect, expect_at_least};
use crate::error::DesignError;

/// When the gain jumps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Logic {
    /// Up at ‖x̂₂‖ ≥ r v̄ − η, down at ‖x̂₂‖ ≤ (r − 1) v̄ − η − h: thresholds apart by h, so that r never chatters and
    /// ‖x̂₂ − q̇‖ ≤ η implies ‖q̇‖ ≤ r v̄. The estimate does not jump.
    Repaired,
    /// Down at ‖x̂₂‖ ≤ (r − 1) v̄ + η, as printed in eq. (14), at most one jump a sample: r chatters.
    PrintedSets,
    /// The repaired sets, and the printed jump map, eq. (16): z is kept, so that the estimate jumps with the gain.
    PrintedMap,
}

/// Gains by level: at level r the speed is taken to be at most r v̄ (Cristofaro and De Luca 2023, eqs. (14)–(16)).
///
/// ```
/// use linkside_core::estimate::velocity::{Gains, Logic, Schedule};
/// let schedule = Schedule {
///     gains: vec![40.0, 80.0, 160.0], // up to 1, 2 and 3 rad/s
///     bound: 1.0,
///     margin: 0.2,
///     hysteresis: 0.1,
///     start: 1,
///     dwell: 0,
///     logic: Logic::Repaired,
/// };
/// let gains = Gains::Scheduled(schedule);
/// # drop(gains);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// k₁, k₂, …: levels beyond the last use the last [1/s].
    pub gains: Vec<f64>,
    /// v̄, width of a level [rad/s].
    pub bound: f64,
    /// η, largest error of the estimate that the gains are made for [rad/s].
    pub margin: f64,
    /// h, between jumps up and down [rad/s].
    pub hysteresis: f64,
    /// r(0), from 1.
    pub start: usize,
    /// Samples between a jump and a jump down.
    pub dwell: usize,
    /// When to jump.
    pub logic: Logic,
}

impl Schedule {
    /// # Errors
    /// No gains, η or v̄ not positive, h not between 0 and v̄, a start that is no level or at which the gain would jump at once.
    pub(super) fn check(&self) -> Result<(), DesignError> {
        let Self { bound, margin, hysteresis, start, .. } = *self;
        for (what, value) in [("the bound of a level", bound), ("the margin", margin)] {
            expect(value > 0.0 && value.is_finite(), what, value, "a positive number")?;
        }
        expect(hysteresis > 0.0 && hysteresis < bound, "the hysteresis", hysteresis, "between 0 and the bound")?;
        expect_at_least("gains", self.gains.len(), 1)?;
        let first = start as f64;
        expect((1..=self.gains.len()).contains(&start), "the start level", first, "from 1 to the number of gains")?;
        expect(first * bound > margin, "the start level", first, "one whose bound is above the margin")
    }

    /// The level after `level` at the estimated speed [rad/s], with `since` samples gone since the last jump.
    pub(super) fn next(&self, level: usize, speed: f64, since: usize) -> usize {
        let top = |level: usize| level as f64 * self.bound - self.margin;
        let mut up = level;
        while up < self.gains.len() && speed >= top(up) {
            up += 1;
            if self.logic == Logic::PrintedSets {
                break;
            }
        }
        let below = level > 1 && since >= self.dwell && speed <= self.floor(level);
        if up == level && below { level - 1 } else { up }
    }

    /// The speed at or below which the gain jumps down from `level` [rad/s].
    fn floor(&self, level: usize) -> f64 {
        let below = (level - 1) as f64 * self.bound;
        match self.logic {
            Logic::PrintedSets => below + self.margin,
            Logic::Repaired | Logic::PrintedMap => below - self.margin - self.hysteresis,
        }
    }
}
