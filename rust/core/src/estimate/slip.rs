//! An encoder that slips or drifts against the measured velocity of its motor.
//!
//! Without a sensor on the links an estimator takes a slow drift of an encoder for a motion. A velocity that is measured
//! apart from it, by a resolver or a tachometer, shows it: its integral stays beside the position, but for its own zero
//! error z, scale s and lag τ,
//!
//! θ − ∫ω dt = c + z t + s ∫ω dt + τ ω.
//!
//! A Kalman filter learns the four numbers window by window, and what it foretells worse than it used to is a slip, at once
//! or bit by bit. A velocity that lags is filtered, most often the derivative of the same position: it testifies to
//! nothing and is not heard.

/// Time that a window takes at least [s], and readings in it.
const WINDOW: f64 = 0.03;
const READINGS: u32 = 2;
/// What is known of a velocity beforehand, one standard deviation: its zero [rad/s], scale and lag [s].
const ZERO: f64 = 0.02;
const SCALE: f64 = 0.02;
const LAG: f64 = 0.04;
/// By how much the zero wanders in one second [rad/s/√s].
const WALK: f64 = 2e-4;
/// A velocity that may be later than this is not heard [s].
const PROMPT: f64 = 3e-3;
/// What the four numbers leave of a change of velocity, at first [s]; it falls by this factor a window to what is seen.
const LEFT: f64 = 0.03;
const FALL: f64 = 0.8;
/// A slip within a window: in multiples of what is foretold wrongly as a rule, and at least so large [rad].
const JUMPS: f64 = 16.0;
const LEAST_JUMP: f64 = 3e-4;
/// The same of a drift, over this many windows.
const DRIFTS: f64 = 10.0;
const LEAST_DRIFT: f64 = 5e-4;
const MEMORY: f64 = 24.0;
/// Mean square of what is foretold wrongly, at least, in the variances that the filter states.
const LEAST: f64 = 0.06;
/// Changes of velocity from which its noise is known.
const KNOWN: f64 = 64.0;

/// A position that has gone off from where its velocity has brought it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slip {
    /// By how much, and the same in what the check is wrong by as a rule.
    pub(crate) size: f64,
    pub(crate) deviations: f64,
    /// Within this many samples before this one.
    pub(crate) samples: u32,
}

/// A motor's position beside the integral of its velocity.
#[derive(Clone, Debug)]
pub(crate) struct SlipCheck {
    /// c, z, s, τ and their covariance.
    mean: [f64; 4],
    covariance: [[f64; 4]; 4],
    /// ∫ω dt since the first position, and the velocity last read and the one before.
    integral: f64,
    velocity: [f64; 2],
    /// Variance of a velocity's noise, changes that it was found of, and the least change: a digital velocity has steps.
    noise: f64,
    changes: f64,
    step: f64,
    /// Where the present window began; none before the first position.
    window: Option<SlipWindow>,
    /// Largest change of velocity of the window before, and what is left of one.
    shaken: f64,
    left: f64,
    /// Mean square of what was foretold wrongly, and its sum with a memory, as a share of its deviation and as it is.
    squares: f64,
    sums: [f64; 2],
}

/// Since a window began.
#[derive(Clone, Copy, Debug)]
struct SlipWindow {
    time: f64,
    integral: f64,
    velocity: f64,
    /// Positions since, samples since, and the largest change of velocity.
    readings: u32,
    samples: u32,
    shaken: f64,
    /// How far off its last position was, if that was far; else 0.
    doubt: f64,
}

impl SlipCheck {
    pub(crate) fn new() -> Self {
        let mut covariance = [[0.0; 4]; 4];
        for (i, std) in [0.0, ZERO, SCALE, LAG].into_iter().enumerate() {
            covariance[i][i] = std * std;
        }
        Self {
            mean: [0.0; 4],
            covariance,
            integral: 0.0,
            velocity: [f64::NAN; 2],
            noise: 0.0,
            changes: 0.0,
            step: f64::INFINITY,
            window: None,
            shaken: 0.0,
            left: LEFT,
            squares: 1.0,
            sums: [0.0; 2],
        }
    }

    /// Takes a sample `dt` after the one before: a position with its variance, and a velocity; NaN where missing.
    #[inline(always)]
    pub(crate) fn take(&mut self, dt: f64, position: f64, variance: f64, velocity: f64) -> Option<Slip> {
        if velocity.is_nan() {
            (self.window, self.velocity) = (None, [f64::NAN; 2]); // nothing to integrate: begin anew
            return None;
        }
        if dt > WINDOW {
            (self.window, self.velocity) = (None, [f64::NAN; 2]); // velocities at both ends of a gap do not tell its integral
        }
        let [before, earlier] = self.velocity;
        self.velocity = [velocity, before];
        if !before.is_nan() {
            self.integral += 0.5 * (velocity + before) * dt;
            let change = (velocity - before).abs();
            if change > 0.0 {
                self.step = self.step.min(change);
            }
        }
        if !earlier.is_nan() {
            let bend = velocity - 2.0 * before + earlier;
            self.changes = (self.changes + 1.0).min(KNOWN);
            self.noise += (bend * bend / 6.0 - self.noise) / self.changes;
        }
        let seen = !position.is_nan();
        let Some(window) = &mut self.window else {
            if seen {
                self.begin(position - self.integral, variance);
            }
            return None;
        };
        window.time += dt;
        window.samples += 1;
        window.readings += u32::from(seen);
        window.shaken = window.shaken.max((velocity - window.velocity).abs());
        if !seen || window.time < WINDOW || window.readings < READINGS {
            return None;
        }
        let window = *window;
        self.close(window, position - self.integral, variance)
    }

    /// From now on c is what is read, of this variance.
    fn begin(&mut self, offset: f64, variance: f64) {
        self.mean[0] = offset;
        self.covariance[0] = [0.0; 4];
        self.covariance.iter_mut().for_each(|row| row[0] = 0.0);
        self.covariance[0][0] = variance;
        self.open();
    }

    /// The next window begins.
    fn open(&mut self) {
        let (integral, velocity) = (self.integral, self.velocity[0]);
        self.window =
            Some(SlipWindow { time: 0.0, integral, velocity, readings: 0, samples: 0, shaken: 0.0, doubt: 0.0 });
    }

    /// A window ends with `offset` = θ − ∫ω dt.
    #[inline(never)]
    fn close(&mut self, mut window: SlipWindow, offset: f64, variance: f64) -> Option<Slip> {
        if window.shaken == 0.0 {
            self.begin(offset, variance); // at rest without noise, or a velocity that is dead: it says nothing
            return None;
        }
        // 1. What is foretold wrongly, and how wrong it may be.
        let step = if self.step.is_finite() { self.step } else { 0.0 };
        let (foretold, row) = self.foretell(&window, step);
        let shaken = window.shaken.max(self.shaken);
        let own = row[0] + variance;
        let total = own + (self.left * shaken).powi(2);
        let wrong = offset - foretold;
        let ratio = wrong / total.sqrt();
        let usual = self.squares.max(LEAST).sqrt();
        let prompt = self.mean[3].abs() + 2.0 * self.covariance[3][3].sqrt() < PROMPT;
        // 2. A slip at once. A single reading may be an outlier: the next must say the same.
        let jumps = prompt && wrong.abs() > LEAST_JUMP + step * WINDOW && ratio.abs() > JUMPS * usual;
        if jumps && (window.doubt / wrong - 1.0).abs() > 0.5 {
            window.doubt = wrong;
            self.window = Some(window);
            return None;
        }
        self.shaken = window.shaken;
        if jumps {
            self.sums = [0.0; 2];
            self.begin(offset, variance);
            return Some(Slip { size: wrong, deviations: (ratio / usual).abs(), samples: window.samples });
        }
        // 3. A slip bit by bit.
        self.sums = [self.sums[0] * (1.0 - 1.0 / MEMORY) + ratio, self.sums[1] * (1.0 - 1.0 / MEMORY) + wrong];
        let ([ratios, drift], whole) = (self.sums, usual * (MEMORY / 2.0).sqrt());
        let least = LEAST_DRIFT + 0.25 * step * MEMORY * WINDOW;
        let drifts = prompt && drift.abs() > least && ratios * drift.signum() > DRIFTS * whole;
        let slip = drifts.then(|| {
            self.sums = [0.0; 2];
            let samples = window.samples * MEMORY as u32;
            Slip { size: drift, deviations: (ratios / whole).abs(), samples }
        });
        // 4. What there is to learn of the four numbers, and of what they leave.
        self.learn(&window, (foretold, row), wrong, total);
        let square = (ratio * ratio).min(4.0 * self.squares);
        self.squares += (square - self.squares) / if square < self.squares { 8.0 } else { 32.0 };
        if self.left * shaken > own.sqrt() {
            self.left = (self.left * FALL).max((wrong.abs() / shaken).min(self.left));
        }
        self.open();
        slip
    }

    /// c + z T + s Δ∫ω dt + τ Δω, and its covariance with the four numbers after the window.
    fn foretell(&self, window: &SlipWindow, step: f64) -> (f64, [f64; 4]) {
        let by = [1.0, window.time, self.integral - window.integral, self.velocity[0] - window.velocity];
        let dot = |a: &[f64; 4]| a.iter().zip(&by).map(|(a, b)| a * b).sum::<f64>();
        let mut row = self.covariance.each_ref().map(dot);
        let noise = self.noise / f64::from(window.samples) + step * step / 12.0;
        row[0] = dot(&row) + window.time * window.time * noise;
        (dot(&self.mean), row)
    }

    /// The update of what was foretold.
    fn learn(&mut self, window: &SlipWindow, (foretold, row): (f64, [f64; 4]), wrong: f64, total: f64) {
        self.mean[0] = foretold;
        for (i, &value) in row.iter().enumerate() {
            (self.covariance[0][i], self.covariance[i][0]) = (value, value);
        }
        for (i, &a) in row.iter().enumerate() {
            self.mean[i] += a / total * wrong;
            for (j, &b) in row.iter().enumerate() {
                self.covariance[i][j] -= a * b / total;
            }
        }
        self.covariance[1][1] += WALK * WALK * window.time;
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods)] // what a test moves may depend on the platform
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RATE: f64 = 500.0;

    /// A motor that moves by three waves: positions with steps of an encoder, and velocities with noise.
    #[derive(Clone, Debug)]
    struct Waving {
        waves: [(f64, f64); 3],
        zero: f64,
        scale: f64,
        lag: f64,
    }

    impl Waving {
        fn run(&self, seconds: f64, fault: impl Fn(f64, f64) -> f64) -> Vec<(f64, Slip)> {
            self.rows(seconds, fault, |_| false)
        }

        /// The same without the samples at some times.
        fn rows(
            &self,
            seconds: f64,
            fault: impl Fn(f64, f64) -> f64,
            missing: impl Fn(f64) -> bool,
        ) -> Vec<(f64, Slip)> {
            let mut last = 0.0;
            let mut check = SlipCheck::new();
            let noise = |k: usize, s: f64| ((k as f64 * s).sin() * 43758.5453).fract() * 3.46e-3 * 0.5; // 1 mrad/s
            let wave = |t: f64, f: fn(f64, f64, f64) -> f64| self.waves.iter().map(|&(a, w)| f(a, w, t)).sum::<f64>();
            let position = |t: f64| wave(t, |a, w, t| a * (1.0 - (w * t).cos()));
            let speed = |t: f64| wave(t, |a, w, t| a * w * (w * t).sin());
            let samples = (seconds * RATE) as usize;
            let steps = 2e-5;
            (0..samples)
                .filter_map(|k| {
                    let t = k as f64 / RATE;
                    if missing(t) {
                        return None;
                    }
                    let dt = t - last;
                    last = t;
                    let theta = (fault(t, position(t)) / steps).round() * steps;
                    let velocity = self.zero + (1.0 + self.scale) * speed(t - self.lag) + noise(k, 12.9898);
                    Some((t, check.take(dt, theta, steps * steps / 12.0, velocity)?))
                })
                .collect()
        }
    }

    prop_compose! {
        fn motor()(
            waves in prop::array::uniform3((0.02..0.3, 1.0..8.0)),
            zero in -0.01..0.01,
            scale in -0.02..0.02,
            lag in -1e-3..1e-3,
        ) -> Waving {
            Waving { waves, zero, scale, lag }
        }
    }

    proptest! {
        #[test]
        fn a_position_that_follows_its_velocity_never_slips(motor in motor()) {
            prop_assert!(motor.run(6.0, |_, theta| theta).is_empty());
        }

        #[test]
        fn a_jump_and_a_drift_are_found_with_their_size(motor in motor(), by in prop_oneof![-1.0..-0.3_f64, 0.3..1.0_f64]) {
            let jumps = motor.run(6.0, |t, theta| if t < 3.0 { theta } else { theta + 0.01 * by });
            prop_assert!(jumps.len() == 1 && jumps[0].0 < 3.0 + 0.05, "{jumps:?}");
            prop_assert!((jumps[0].1.size / (0.01 * by) - 1.0).abs() < 0.2);
            let drifts = motor.run(6.0, |t, theta| theta + 0.02 * by * (t - 3.0).max(0.0));
            prop_assert!(drifts.first().is_some_and(|drift| (3.0..4.0).contains(&drift.0)), "{drifts:?}");
            prop_assert!(drifts[0].1.size * by > 0.0);
        }

        #[test]
        fn an_outlier_is_no_slip(motor in motor(), at in 1000_usize..2500) {
            let only = |t: f64, theta: f64| if (t * RATE).round() as usize == at { theta + 0.1 } else { theta };
            prop_assert!(motor.run(6.0, only).is_empty());
        }

        #[test]
        fn a_gap_makes_no_slip(motor in motor(), at in 1.0..5.0) {
            let gap = |t: f64| (at..at + 0.3).contains(&t);
            prop_assert!(motor.rows(6.0, |_, theta| theta, gap).is_empty());
        }

        #[test]
        fn a_velocity_that_lags_makes_no_slip_of_a_sound_position(motor in motor(), lag in 3e-3..0.05) {
            let late = Waving { lag, ..motor };
            prop_assert!(late.run(6.0, |_, theta| theta).is_empty());
        }
    }
}
