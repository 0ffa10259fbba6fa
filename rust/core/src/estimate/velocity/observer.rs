//! One sample after the other.

use super::encoder::Encoder;
use super::map::Mapped;
use super::rigid::RigidDynamics;
use super::schedule::Logic;
use super::settings::{Gains, VelocitySettings};
use crate::check::{are_sound, expect_length, refuse_infinite};
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::estimate::observer::{LONGEST, Start};
use crate::linear::add_scaled;
use crate::robot::Robot;
use crate::scalar::exp_m1;
use crate::simd::{self, Kernel};
use std::sync::Arc;

/// Velocity observer of one robot with rigid joints.
///
/// Between samples the model's acceleration is integrated by Heun's method, torques held. At a sample the velocity takes
/// (1 − e^(−kT))/T of the position's innovation, so that under constant acceleration the error falls by exactly e^(−kT)
/// a sample. A spring K_P is integrated by the trapezoidal rule: with one gain for all joints the sampled error is stable for
/// λmax(M⁻¹K_P) T² < x (4 − 2c)/(c (1 − c/3)), where x = kT and c = 1 − e^(−x), and so below 4 at any gain. That is checked where
/// the robot starts.
///
/// ```
/// use linkside_core::estimate::observer::Start;
/// use linkside_core::estimate::velocity::{Gains, VelocityObserver, VelocitySettings};
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let mut observer = VelocityObserver::new(robot, VelocitySettings {
///     period: 1e-3,
///     gains: Gains::Constant(vec![100.0]),
///     spring: vec![0.0], // none: the reduced-order observer
///     motors: true,
///     start: Start::Rest,
///     wrap: vec![std::f64::consts::TAU],
/// })?;
/// // From rest to 0.5 rad/s by positions alone: what is left of the error after 0.2 s is e⁻²⁰ of it.
/// for i in 0..=200 {
///     observer.step(&[0.5e-3 * f64::from(i)], &[0.0])?;
/// }
/// assert!((observer.dq()[0] - 0.5).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct VelocityObserver {
    /// What it was made with.
    settings: VelocitySettings,
    /// Accelerations of the rigid robot.
    dynamics: RigidDynamics,
    /// (1 − e^(−kT))/T of each joint [1/s], and the gain k behind it; zeros beside a map.
    weights: Vec<f64>,
    gains: Vec<f64>,
    /// The gain that depends on the posture.
    map: Option<Mapped>,
    /// Level r of a hybrid gain, and samples since it last changed.
    level: usize,
    since_jump: usize,
    /// Share of each innovation in the velocity since the start (n): what a mean velocity takes of its last part.
    share: Vec<f64>,
    /// Whether the velocity was given at the start.
    given: bool,
    /// Samples taken since the start.
    samples: usize,
    /// Flags of the last sample.
    status: u8,
    /// Turns that encoders have lost, and samples that they have missed (n).
    encoders: Vec<Encoder>,
    /// y, without wraps.
    position: Vec<f64>,
    /// Reading less prediction, per period since the last reading (n) [rad].
    innovation: Vec<f64>,
    /// x̂₂.
    velocity: Vec<f64>,
    /// ỹ = y − x̂₁.
    lag: Vec<f64>,
    /// M⁻¹ K_P ỹ.
    spring: Vec<f64>,
    /// Without the spring.
    acceleration: Vec<f64>,
    /// The acceleration at the end of a period, Heun's second slope.
    corrected: Vec<f64>,
    /// Held until the next sample (n) [N m].
    torque: Vec<f64>,
}

impl VelocityObserver {
    /// Designs an observer for `robot`.
    ///
    /// # Errors
    /// A setting out of its range, or gains that are too fast for the period.
    pub fn new(robot: Arc<Robot>, settings: VelocitySettings) -> Result<Self, DesignError> {
        let n = robot.len();
        settings.check(n)?;
        let (level, gains) = match &settings.gains {
            Gains::Constant(gains) => (1, gains.clone()),
            Gains::Scheduled(schedule) => (schedule.start, vec![schedule.gains[schedule.start - 1]; n]),
            Gains::Mapped(_) => (1, vec![0.0; n]),
        };
        let map = match &settings.gains {
            Gains::Mapped(map) => Some(Mapped::new(map.clone(), settings.period)),
            _ => None,
        };
        let zero = || vec![0.0; n];
        let mut observer = Self {
            dynamics: RigidDynamics::new(robot, settings.motors, settings.period),
            settings,
            weights: zero(),
            gains,
            map,
            level,
            since_jump: 0,
            share: zero(),
            given: false,
            samples: 0,
            status: 0,
            encoders: vec![Encoder::default(); n],
            position: zero(),
            innovation: zero(),
            velocity: zero(),
            lag: zero(),
            spring: zero(),
            acceleration: zero(),
            corrected: zero(),
            torque: zero(),
        };
        observer.weigh();
        Ok(observer)
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.position.len()
    }

    /// Sets the velocity estimate (n) [rad/s] that the next, first sample starts from, and how far the position estimate
    /// x̂₁ is behind the first reading (n) [rad].
    ///
    /// # Errors
    /// Wrong lengths.
    pub fn start(&mut self, dq: &[f64], lag: &[f64]) -> Result<(), DesignError> {
        let expected = self.joints();
        for (what, given) in [("dq", dq), ("lag", lag)] {
            expect_length(what, given.len(), expected)?;
        }
        self.given = true;
        self.velocity.copy_from_slice(dq);
        self.lag.copy_from_slice(lag);
        self.samples = 0;
        Ok(())
    }

    /// Takes positions (n) [rad] and torques (n) [N m], the latter held until the next sample; NaN where one is missing.
    ///
    /// # Errors
    /// A first sample that lacks a position, a spring too stiff for the period there, an inertia that is singular; wrong
    /// lengths, an infinite reading, a position that has been missing for more than [`LONGEST`], which leave the state as
    /// it was. [`RunError::NotFinite`]: readings so extreme that the state is not finite; it then restarts.
    pub fn step(&mut self, q: &[f64], torque: &[f64]) -> Result<(), RunError> {
        self.check(q, torque)?;
        self.take(q, torque)?;
        if self.is_finite() {
            return Ok(());
        }
        let sample = self.samples - 1;
        self.reset();
        Err(RunError::NotFinite { sample })
    }

    /// Resets the observer: the next sample starts from the beginning.
    pub fn reset(&mut self) {
        (self.samples, self.given) = (0, false);
        self.velocity.fill(0.0);
        self.lag.fill(0.0);
        self.spring.fill(0.0);
        self.torque.fill(0.0);
        if let Gains::Scheduled(schedule) = &self.settings.gains {
            (self.level, self.since_jump) = (schedule.start, 0);
            self.gains.fill(schedule.gains[schedule.start - 1]);
            self.weigh();
        }
    }

    /// Refuses a sample before anything has changed.
    fn check(&self, q: &[f64], torque: &[f64]) -> Result<(), DesignError> {
        for (what, values) in [("q", q), ("tau", torque)] {
            expect_length(what, values.len(), self.joints())?;
            refuse_infinite(what, values)?;
        }
        let longest = (LONGEST / self.settings.period).round().max(1.0);
        let late = |(q, encoder): (&f64, &Encoder)| q.is_nan() && f64::from(encoder.missing()) >= longest;
        match q.iter().zip(&self.encoders).position(late) {
            Some(joint) if self.samples > 0 => Err(DesignError::Late { joint, longest: LONGEST }),
            _ => Ok(()),
        }
    }

    /// [`step`](Self::step) with a sample that has been checked.
    pub(super) fn take(&mut self, q: &[f64], torque: &[f64]) -> Result<(), RunError> {
        simd::phase(VelocityStep { observer: self, q, torque })
    }

    /// One period: predict and correct, let the gain jump, hold the torque, and the acceleration that it gives.
    #[inline(always)]
    fn take_here(&mut self, q: &[f64], torque: &[f64]) -> Result<(), RunError> {
        self.status = 0;
        let regular = if self.samples == 0 { self.begin(q)? } else { self.advance(q) };
        if !regular {
            return Err(RunError::SingularInertia { sample: self.samples });
        }
        // After the correction, as the gain follows the estimated speed; before the torque, which the next period
        // needs.
        self.jump();
        self.hold(torque);
        let Self { dynamics, velocity, torque, acceleration, .. } = self;
        dynamics.acceleration_into(velocity, torque, acceleration);
        self.samples += 1;
        Ok(())
    }

    /// A first sample: no innovation yet; a spring is checked against the period at the posture where it is to work.
    #[cold]
    fn begin(&mut self, q: &[f64]) -> Result<bool, DesignError> {
        if let Some(joint) = q.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        self.position.copy_from_slice(q);
        self.encoders.fill(Encoder::default());
        let regular = self.dynamics.set_position(&self.position, &self.velocity);
        if regular && self.has_spring() {
            let stiffness = self.dynamics.stiffest(&self.settings.spring);
            let limit =
                self.gains.iter().map(|&k| stiffest_stable(k, self.settings.period)).fold(f64::INFINITY, f64::min);
            if stiffness >= limit {
                return Err(DesignError::StiffSpring { stiffness, limit });
            }
            self.pull();
        }
        Ok(regular)
    }

    /// One period on, and corrected; false when the inertia is singular there.
    #[inline(always)]
    fn advance(&mut self, q: &[f64]) -> bool {
        let period = self.settings.period;
        let starts = self.settings.start == Start::Auto && !self.given;
        for j in 0..q.len() {
            let slope = self.acceleration[j] + self.spring[j];
            // The first of Heun's slopes; y itself is predicted, as x̂₁ has no part in the reduced-order observer.
            let predicted = self.position[j] + period * (self.velocity[j] + 0.5 * period * slope);
            let reading = self.encoders[j].read(q[j], predicted, self.settings.wrap[j]);
            self.status |= if reading.wrapped { Status::UNWRAPPED } else { 0 };
            self.status |= if reading.missing { Status::BRIDGED } else { 0 };
            self.position[j] = reading.position;
            self.innovation[j] = reading.innovation;
            self.share[j] = if starts { f64::from(reading.periods) / self.samples as f64 } else { 0.0 };
            self.velocity[j] += period * slope;
        }
        self.correct();
        let regular = self.dynamics.set_position(&self.position, &self.velocity);
        if regular {
            self.refine();
        }
        regular
    }

    /// Lets the innovation change velocity and lag.
    #[inline(always)]
    fn correct(&mut self) {
        if let Some(map) = &mut self.map {
            let most = map.share();
            let changes = map.weigh(&self.position, &self.innovation);
            for (j, (velocity, &change)) in self.velocity.iter_mut().zip(changes).enumerate() {
                let mean = self.share[j] / self.settings.period * self.innovation[j];
                *velocity += if self.share[j] > most { mean } else { change };
            }
            return;
        }
        for j in 0..self.innovation.len() {
            let change = self.weights[j] * self.innovation[j];
            // At a start the mean velocity since then, until the gain follows it faster.
            let mean = self.share[j] / self.settings.period * self.innovation[j];
            self.velocity[j] += if mean.abs() > change.abs() { mean } else { change };
            self.lag[j] += change / self.gains[j];
        }
    }

    /// Heun's second slope: acceleration changes linearly over the period, and the position that was predicted likewise.
    ///
    /// The lag is there already, so that of the spring this is the trapezoidal rule.
    #[inline(always)]
    fn refine(&mut self) {
        let period = self.settings.period;
        self.dynamics.acceleration_into(&self.velocity, &self.torque, &mut self.corrected);
        if self.has_spring() {
            add_scaled(&mut self.acceleration, 1.0, &self.spring);
            self.pull();
            add_scaled(&mut self.corrected, 1.0, &self.spring);
        }
        for j in 0..self.velocity.len() {
            let change = self.corrected[j] - self.acceleration[j];
            // ½ of the change, of which the innovation, had it been known, would have taken off its share of T²/6.
            self.velocity[j] += change * period * (0.5 - self.weights[j] * period / 6.0);
        }
    }

    /// Whether it is the observer of Nicosia and Tomei.
    fn has_spring(&self) -> bool {
        self.settings.spring.iter().any(|&k| k > 0.0)
    }

    /// What the spring adds to the acceleration.
    #[inline(always)]
    fn pull(&mut self) {
        for j in 0..self.spring.len() {
            self.spring[j] = self.settings.spring[j] * self.lag[j];
        }
        self.dynamics.solve(&mut self.spring);
    }

    /// Lets the gain follow the estimated speed.
    #[inline(always)]
    fn jump(&mut self) {
        let Gains::Scheduled(schedule) = &self.settings.gains else { return };
        let speed = self.velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
        let level = schedule.next(self.level, speed, self.since_jump);
        self.since_jump += 1;
        if level == self.level {
            return;
        }
        let (old, new) = (self.gains[0], schedule.gains[level - 1]);
        // The paper's map keeps the inner state z = x̂₂ − k y, so that the estimate jumps by (k₊ − k) y.
        if schedule.logic == Logic::PrintedMap {
            for (velocity, position) in self.velocity.iter_mut().zip(&self.position) {
                *velocity += (new - old) * position;
            }
        }
        (self.level, self.since_jump) = (level, 0);
        self.gains.fill(new);
        self.weigh();
    }

    /// Weights of innovations from the gains in use.
    fn weigh(&mut self) {
        let period = self.settings.period;
        for (weight, gain) in self.weights.iter_mut().zip(&self.gains) {
            *weight = -exp_m1(-gain * period) / period;
        }
    }

    /// Holds torques; one that is missing stays what it was.
    #[inline(always)]
    fn hold(&mut self, torque: &[f64]) {
        for (held, &new) in self.torque.iter_mut().zip(torque) {
            if new.is_nan() {
                self.status |= Status::BRIDGED;
            } else {
                *held = new;
            }
        }
    }

    /// Positions, without wraps [rad].
    pub fn q(&self) -> &[f64] {
        &self.position
    }

    /// Velocities [rad/s].
    pub fn dq(&self) -> &[f64] {
        &self.velocity
    }

    /// Accelerations by the model [rad/s²].
    pub fn ddq(&self) -> &[f64] {
        &self.acceleration
    }

    /// Level r of the gain, from 1.
    pub fn level(&self) -> usize {
        self.level
    }

    /// Samples since the start.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// See [`Status`].
    pub fn status(&self) -> u8 {
        self.status
    }

    /// Whether positions and torques are those of the motors.
    pub fn is_of_motors(&self) -> bool {
        self.settings.motors
    }

    /// Time since the first sample [s].
    pub fn time(&self) -> f64 {
        self.samples.saturating_sub(1) as f64 * self.settings.period
    }

    pub(super) fn has_tool(&self) -> bool {
        self.dynamics.robot.tool.is_some()
    }

    /// Whether the estimate is still one.
    #[inline(always)]
    pub fn is_finite(&self) -> bool {
        are_sound(self.velocity.iter().chain(&self.acceleration))
    }

    /// Tool centre point [m]; NaN when the robot has none.
    pub fn tool(&self) -> [f64; 3] {
        self.dynamics.tool().map_or([f64::NAN; 3], |tool| tool.0)
    }
}

/// An observer's step, to be compiled for each instruction set.
struct VelocityStep<'a> {
    observer: &'a mut VelocityObserver,
    q: &'a [f64],
    torque: &'a [f64],
}

impl Kernel for VelocityStep<'_> {
    type Output = Result<(), RunError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.observer.take_here(self.q, self.torque)
    }
}

/// Largest λ(M⁻¹K_P) at which the error is stable, sampled with a gain of `gain` [1/s²]: Jury's condition on its two equations.
fn stiffest_stable(gain: f64, period: f64) -> f64 {
    let taken = -exp_m1(-gain * period);
    gain / (period * taken) * (4.0 - 2.0 * taken) / (1.0 - taken / 3.0)
}
