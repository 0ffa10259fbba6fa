//! The instants at which readings were true, in order of time.

use super::parameters::SensorParameters;
use crate::estimate::measurement::low_pass;

/// A instant of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Instant {
    /// The sample whose readings these are.
    pub(super) row: usize,
    /// The accelerometer that is late; none for the sample's other readings.
    pub(super) late: Option<usize>,
    /// The first sample that is not before the instant.
    pub(super) interval: usize,
}

/// Instants from the first sample on, for accelerometers that are each so late [s], or not (none).
pub(super) fn instants(t: &[f64], lags: &[Option<f64>]) -> Vec<Instant> {
    let sensors = lags.iter().enumerate().filter_map(|(s, lag)| lag.map(|lag| (Some(s), lag)));
    let mut timed: Vec<(f64, Instant)> = Vec::new();
    for (late, lag) in core::iter::once((None, 0.0)).chain(sensors) {
        for (row, &stamp) in t.iter().enumerate() {
            let time = stamp - lag;
            let interval = t.partition_point(|&x| x < time).min(t.len() - 1);
            timed.push((time, Instant { row, late, interval }));
        }
    }
    timed.sort_by(|a, b| a.0.total_cmp(&b.0));
    let first = timed.iter().position(|(_, m)| m.row == 0 && m.late.is_none()).unwrap_or(0);
    timed.drain(first..).map(|(_, instant)| instant).collect()
}

/// A first-order filter inside an accelerometer, and its delay.
///
/// The two inputs of [`low_pass`], one sample apart, are taken as one at their mean moment, which is the same to second
/// order: y = α y₋ + (1 − α) f, with f the specific force at that moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct SampledLag {
    /// How long before its time stamp a reading was true [s].
    pub(super) lag: f64,
    /// α, where there is a filter.
    pub(super) memory: Option<f64>,
}

impl SampledLag {
    /// Of an accelerometer sampled every `period` [s].
    pub(super) fn of(sensor: &SensorParameters<f64>, period: f64, filtered: bool) -> Self {
        if !filtered {
            return Self { lag: sensor.delay, memory: None };
        }
        let [memory, before, now] = low_pass(sensor.time_constant, period);
        Self { lag: before * period / (before + now) + sensor.delay, memory: Some(memory) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_in_order_and_start_with_the_first_sample() {
        let found = instants(&[0.0, 1.0, 2.0], &[Some(0.25), None]);
        let expected = [(0, None, 0), (1, Some(0), 1), (1, None, 1), (2, Some(0), 2), (2, None, 2)];
        assert_eq!(found, expected.map(|(row, late, interval)| Instant { row, late, interval }));
    }
}
