//! What sensors make of the truth.

use super::random::Random;
use crate::dynamics::ElasticDynamics;
use crate::error::DesignError;
use crate::memory::filled;
use crate::robot::{Robot, Sensor};
use crate::spatial::Vec3;
use core::f64::consts::TAU;

/// What a sensor measures. Readings of a robot are in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// θ (n) [rad].
    Motor,
    /// Specific force, one number a channel of the accelerometers [m/s²].
    Acceleration,
    /// θ̇ (n) [rad/s].
    MotorVelocity,
    /// Angular velocity, one number a channel of the gyroscopes [rad/s].
    Rate,
    /// q (n) [rad].
    Link,
    /// What the transmission gives the link (n) [N m].
    Torque,
}

impl Kind {
    /// All, in order.
    pub const ALL: [Self; 6] =
        [Self::Motor, Self::Acceleration, Self::MotorVelocity, Self::Rate, Self::Link, Self::Torque];

    /// Channels of `robot`.
    pub fn width(self, robot: &Robot) -> usize {
        match self {
            Self::Acceleration => robot.acceleration_channels(),
            Self::Rate => robot.gyroscope_channels(),
            _ => robot.len(),
        }
    }
}

/// One channel: low-pass, then delay, bias, noise, steps, and a reading every so many samples.
#[derive(Clone, Copy, Debug)]
pub struct SensorModel {
    /// Standard deviation of white noise, in the channel's unit.
    pub noise: f64,
    /// Added to every reading.
    pub bias: f64,
    /// Readings are multiples of this; 0 for none.
    pub resolution: f64,
    /// Age of what is read [s].
    pub delay: f64,
    /// Corner of a low-pass of first order [Hz]; infinite for none.
    pub corner_frequency: f64,
    /// A reading every so many samples, the others are NaN.
    pub every: usize,
}

impl SensorModel {
    /// # Errors
    /// A number out of its range.
    pub(super) fn check(&self) -> Result<(), DesignError> {
        let refuse = |what, value, expected| Err(DesignError::Range { what, value, expected });
        for (what, value) in [("noise", self.noise), ("resolution", self.resolution), ("delay", self.delay)] {
            if !(value >= 0.0 && value.is_finite()) {
                return refuse(what, value, "a finite number of at least 0");
            }
        }
        if !self.bias.is_finite() {
            return refuse("bias", self.bias, "a finite number");
        }
        if self.corner_frequency.is_nan() || self.corner_frequency <= 0.0 {
            return refuse("corner_frequency", self.corner_frequency, "greater than 0");
        }
        if self.every == 0 {
            return refuse("every", 0.0, "at least 1");
        }
        Ok(())
    }
}

/// A reading is no older than so many samples.
const LONGEST_DELAY: f64 = 1e6;

/// One channel with its past.
#[derive(Clone, Debug)]
struct Channel {
    model: SensorModel,
    /// What the low-pass takes over in a sample.
    share: f64,
    low_pass: f64,
    /// Ring of the low-pass' output, long enough for the delay.
    past: Vec<f64>,
    /// The delay in samples.
    lag: f64,
}

impl Channel {
    fn new(model: SensorModel, period: f64) -> Result<Self, DesignError> {
        let lag = model.delay / period;
        if lag.is_nan() || lag > LONGEST_DELAY {
            return Err(DesignError::Range { what: "delay", value: model.delay, expected: "at most 1000000 samples" });
        }
        let share = -(-TAU * model.corner_frequency * period).exp_m1();
        let past = filled(0.0, lag.ceil() as usize + 1, 1)?;
        Ok(Self { model, share, low_pass: 0.0, past, lag })
    }

    #[inline(always)]
    fn read(&mut self, truth: f64, random: Random, stream: u64, sample: usize) -> f64 {
        if sample == 0 {
            (self.low_pass, self.past) = (truth, core::mem::take(&mut self.past));
            self.past.fill(truth);
        }
        self.low_pass += self.share * (truth - self.low_pass);
        let size = self.past.len();
        self.past[sample % size] = self.low_pass;
        if !sample.is_multiple_of(self.model.every) {
            return f64::NAN;
        }
        let whole = self.lag as usize;
        let back = |samples: usize| self.past[(sample + size - samples.min(size - 1)) % size];
        let (near, far) = (back(whole), back(whole + 1));
        let SensorModel { noise, bias, resolution, .. } = self.model;
        let value = near + (self.lag - whole as f64) * (far - near) + bias;
        let noisy = if noise == 0.0 { value } else { value + noise * random.normal(stream, sample as u64) };
        if resolution == 0.0 { noisy } else { (noisy / resolution).round() * resolution }
    }
}

/// All sensors of a robot.
#[derive(Clone, Debug)]
pub struct Suite {
    channels: Vec<Channel>,
    random: Random,
    truth: Vec<f64>,
    /// The last readings, in the order of [`Kind::ALL`].
    pub readings: Vec<f64>,
}

impl Suite {
    /// One model a channel, in the order of [`Kind::ALL`], read every `period` [s].
    ///
    /// # Errors
    /// A model out of range, or not as many as channels.
    pub fn new(robot: &Robot, models: &[SensorModel], period: f64, seed: u64) -> Result<Self, DesignError> {
        let expected = Kind::ALL.iter().map(|kind| kind.width(robot)).sum();
        if models.len() != expected {
            return Err(DesignError::Length { what: "sensors", found: models.len(), expected });
        }
        for model in models {
            model.check()?;
        }
        let channels = models.iter().map(|&model| Channel::new(model, period)).collect::<Result<_, _>>()?;
        let [truth, readings] = core::array::from_fn(|_| vec![0.0; expected]);
        Ok(Self { channels, random: Random { seed }, truth, readings })
    }

    /// Reads everything: `dynamics` with the accelerations at the state, and the kinematics with them.
    #[inline(always)]
    pub(super) fn read(&mut self, robot: &Robot, motion: Motion<'_>, dynamics: &ElasticDynamics, sample: usize) {
        let (n, kinematics) = (robot.len(), &dynamics.kinematics);
        let (motor, rest) = self.truth.split_at_mut(n);
        let (acceleration, rest) = rest.split_at_mut(robot.acceleration_channels());
        let (velocity, rest) = rest.split_at_mut(n);
        let (rate, rest) = rest.split_at_mut(robot.gyroscope_channels());
        let (link, torque) = rest.split_at_mut(n);
        motor.copy_from_slice(motion.theta);
        velocity.copy_from_slice(motion.dtheta);
        link.copy_from_slice(motion.q);
        axes(&robot.accelerometers, acceleration, |sensor| kinematics.specific_force(&sensor.frame));
        axes(&robot.gyroscopes, rate, |sensor| kinematics.angular_rate(&sensor.frame));
        for (j, torque) in torque.iter_mut().enumerate() {
            *torque = dynamics.joint_torque(robot, j);
        }
        let (random, truth) = (self.random, &self.truth);
        for (stream, (channel, reading)) in self.channels.iter_mut().zip(&mut self.readings).enumerate() {
            *reading = channel.read(truth[stream], random, stream as u64, sample);
        }
    }
}

/// Joint positions and velocities of links and motors, n each.
#[derive(Clone, Copy, Debug)]
pub struct Motion<'a> {
    /// q [rad].
    pub q: &'a [f64],
    /// q̇ [rad/s].
    pub dq: &'a [f64],
    /// θ [rad].
    pub theta: &'a [f64],
    /// θ̇ [rad/s].
    pub dtheta: &'a [f64],
}

#[inline(always)]
fn axes(sensors: &[Sensor], out: &mut [f64], see: impl Fn(&Sensor) -> Vec3<f64>) {
    let recorded = sensors.iter().flat_map(|sensor| {
        let value = see(sensor).0;
        sensor.axes.iter().map(move |&axis| value[axis])
    });
    for (out, value) in out.iter_mut().zip(recorded) {
        *out = value;
    }
}
