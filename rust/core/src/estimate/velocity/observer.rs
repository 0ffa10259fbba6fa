//! The observer: its design, its state, and what it reports.

mod step;

use super::encoder::Encoder;
use super::map::Mapped;
use super::rigid::RigidDynamics;
use super::settings::{Gains, VelocitySettings};
use crate::check::{are_sound, expect_length, refuse_infinite};
use crate::error::{DesignError, RunError};
use crate::estimate::observer::LONGEST;
use crate::robot::Robot;
use crate::scalar::exp_m1;
use crate::simd;
use std::sync::Arc;
use step::VelocityStep;

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

    /// Weights of innovations from the gains in use.
    fn weigh(&mut self) {
        let period = self.settings.period;
        for (weight, gain) in self.weights.iter_mut().zip(&self.gains) {
            *weight = -exp_m1(-gain * period) / period;
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

    /// See [`Status`](crate::estimate::Status).
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
