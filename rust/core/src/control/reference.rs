//! Where a controller is to go.

use crate::check::{expect_at_least, expect_finite, expect_length, expect_rising};
use crate::error::DesignError;

/// A path in time: straight between knots, at rest before the first and after the last.
///
/// Knots are looked for from the one that was used last: a controller asks in the order of time.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Of the knots, rising [s].
    times: Vec<f64>,
    /// Numbers of each knot, knots × width.
    values: Vec<f64>,
    width: usize,
    /// The last knot that is not later than the time asked for last.
    knot: usize,
}

impl Reference {
    /// Knots at `times` [s], one row of `values` (times × width) each.
    ///
    /// # Errors
    /// No knot, times that do not rise, numbers that are not finite, not as many values as knots.
    pub fn new(times: Vec<f64>, values: Vec<f64>, width: usize) -> Result<Self, DesignError> {
        let what = "reference";
        expect_at_least(what, times.len(), 1)?;
        expect_length(what, values.len(), times.len() * width)?;
        expect_finite(what, &times)?;
        expect_finite(what, &values)?;
        expect_rising("time of a knot", &times)?;
        Ok(Self { times, values, width, knot: 0 })
    }

    /// Numbers a knot.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Value and slope of every number at `t` [s], handed to `put`.
    #[inline(always)]
    pub(crate) fn at(&mut self, t: f64, mut put: impl FnMut(usize, f64, f64)) {
        if t < self.times[self.knot] {
            self.knot = 0;
        }
        while self.times.get(self.knot + 1).is_some_and(|&next| next <= t) {
            self.knot += 1;
        }
        let k = self.knot;
        let row = &self.values[k * self.width..][..self.width];
        let Some(&after) = self.times.get(k + 1).filter(|_| t >= self.times[k]) else {
            return row.iter().enumerate().for_each(|(i, &value)| put(i, value, 0.0));
        };
        let next = &self.values[(k + 1) * self.width..][..self.width];
        for (i, (a, b)) in row.iter().zip(next).enumerate() {
            let slope = (b - a) / (after - self.times[k]);
            put(i, a + slope * (t - self.times[k]), slope);
        }
    }
}
