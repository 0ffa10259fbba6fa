//! Readings that repeat themselves where they cannot: a cable that is broken, a recorder that holds an old value.

use super::deviations::ObserverView;
use super::joint_error::JointError;
use super::recording::ObserverSample;
use super::settings::AccelerationSource;
use super::uncertainty::{Columns, Uncertainty};
use crate::estimate::kalman::Signal;
use crate::linear;
use crate::robot::Robot;

/// A torque that stays the same to the last bit for so long is not one that is measured [s], where its motor meanwhile goes so far
/// [rad] and becomes so much faster or slower [rad/s]. That of a motor at rest, or at constant speed, may be commanded.
const HELD: f64 = 0.05;
const MOVED: [f64; 2] = [1e-3, 1e-2];
/// A motor whose link has turned by so much has turned as well [rad]: no spring twists that far.
const TURNED: f64 = 0.01;
/// Time over which accelerations tell how far a link has turned [s].
const TIME: f64 = 0.5;
/// Standard deviations of that.
const SURE: f64 = 3.0;

/// Every channel of an observer by itself, without a model but that noise does not repeat and that motors turn with their links.
#[derive(Clone, Debug)]
pub(super) struct Repeats {
    period: f64,
    torques: Vec<Signal>,
    /// Position and velocity of each motor when its torque became what it is, and whether they have changed since.
    since: Vec<([f64; 2], bool)>,
    accelerations: Vec<Signal>,
    /// Variances of the noise of these.
    torque: Vec<f64>,
    acceleration: Vec<f64>,
    positions: Vec<Still>,
    stuck: bool,
}

/// A motor position that stays the same, and how its link moves by its acceleration meanwhile.
#[derive(Clone, Copy, Debug, Default)]
struct Still {
    position: f64,
    time: f64,
    speed: f64,
    turned: f64,
    /// Whether that was too much; it is for as long as the position stays.
    stuck: bool,
}

impl Repeats {
    pub(super) fn new(robot: &Robot, uncertainty: &Uncertainty, source: AccelerationSource, period: f64) -> Self {
        let noise = robot.accelerometers.iter().flat_map(|s| vec![s.noise_std * s.noise_std; s.axes.len()]);
        // Of joint accelerations nobody says what their noise is.
        let acceleration: Vec<f64> = if source == AccelerationSource::Sensors { noise.collect() } else { Vec::new() };
        Self {
            period,
            torques: vec![Signal::NEW; robot.len()],
            since: vec![([0.0; 2], false); robot.len()],
            accelerations: vec![Signal::NEW; acceleration.len()],
            torque: uncertainty.torque.iter().map(|std| std * std).collect(),
            acceleration,
            positions: vec![Still::default(); robot.len()],
            stuck: false,
        }
    }

    /// Before the first sample.
    pub(super) fn reset(&mut self) {
        self.torques.fill(Signal::NEW);
        self.accelerations.fill(Signal::NEW);
        self.positions.fill(Still::default());
        self.stuck = false;
    }

    /// Whether some channel repeats itself where it cannot.
    #[inline(always)]
    pub(super) fn is_stuck(&self) -> bool {
        self.stuck
    }

    /// A sample; `joints` say how well accelerations are known.
    #[inline(always)]
    pub(super) fn take(
        &mut self,
        sample: ObserverSample<'_>,
        look: &ObserverView<'_>,
        (columns, joints): (&Columns, &[JointError]),
    ) {
        let long = HELD / self.period;
        let mut stuck = false;
        for ((signal, &reading), &variance) in
            self.accelerations.iter_mut().zip(sample.acceleration).zip(&self.acceleration)
        {
            if !reading.is_nan() {
                signal.take(reading, 0.0);
                stuck |= signal.is_stuck(variance);
            }
        }
        for (j, &tau) in sample.tau.iter().enumerate() {
            if look.robot.drives[j].elastic && !tau.is_nan() {
                let (signal, [theta, _, dtheta, ..]) = (&mut self.torques[j], look.state[j]);
                signal.take(tau, 0.0);
                if signal.run == 1 {
                    self.since[j] = ([theta, dtheta], false);
                }
                let ([from, speed], moved) = &mut self.since[j];
                *moved |= (theta - *from).abs() > MOVED[0] && (dtheta - *speed).abs() > MOVED[1];
                stuck |= *moved && f64::from(signal.run) > long && signal.is_stuck(self.torque[j]);
            }
        }
        for (j, still) in self.positions.iter_mut().enumerate() {
            if look.robot.drives[j].elastic {
                still.take(sample.theta[j], look.links[2][j], self.period);
                // A position that is only late has not been the same again.
                if still.turned.abs() > TURNED && !sample.theta[j].is_nan() {
                    let by = &joints[j].next[columns.accelerations.clone()];
                    still.stuck |= still.is_stuck(linear::dot(by, by), joints[j].shaking * self.period);
                }
                stuck |= still.stuck;
            }
        }
        self.stuck = stuck;
    }
}

impl Still {
    /// A position, NaN where it is missing, and the link's acceleration.
    #[inline(always)]
    fn take(&mut self, position: f64, acceleration: f64, period: f64) {
        let changed = position != self.position && !position.is_nan();
        if changed || (self.time > TIME && !self.stuck) {
            *self = Self { position: if changed { position } else { self.position }, ..Self::default() };
        } else {
            self.time += period;
            self.speed += acceleration * period;
            self.turned += self.speed * period;
        }
    }

    /// Whether the link has turned, by accelerations of this variance that lasts and this density of noise.
    ///
    /// The first makes t²/2 of itself, the second t³/3.
    #[inline(always)]
    fn is_stuck(&self, lasting: f64, density: f64) -> bool {
        let (square, variance) = (self.time * self.time, self.turned * self.turned);
        let doubt = lasting * square * square / 4.0 + density * square * self.time / 3.0;
        lasting > 0.0 && variance > TURNED * TURNED + SURE * SURE * doubt
    }
}
