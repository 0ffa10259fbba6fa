//! How a controller comes to know the robot's state.

use super::sensors::JointMotion;
use crate::check::expect_length;
use crate::control::RobotState;
use crate::dynamics::ElasticLayout;
use crate::error::{DesignError, RunError};
use crate::estimate::kalman::{ElasticModel, ExtendedKalmanFilter, Inputs, KalmanSample};
use crate::estimate::observer::{AccelerationObserver, ObserverSample};
use crate::robot::Robot;

/// What is known at a sample.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// The truth.
    pub truth: JointMotion<'a>,
    /// Readings of all sensors, in the order of [`Kind::SENSORS`](crate::estimate::measurement::Kind::SENSORS).
    pub readings: &'a [f64],
    /// Motor torques until now (n) [N m].
    pub tau: &'a [f64],
    /// Time since the sample before [s].
    pub dt: f64,
}

/// Turns what is known into what the controller knows.
///
/// [`TrueState`] for a controller without sensors, [`SensorFeedback`] for one that takes links to be where their motors
/// are, and an estimator in the loop: [`ObserverFeedback`], [`FilterFeedback`].
pub trait Feedback {
    /// Writes the state at a sample, asked for once a sample, in order.
    ///
    /// # Errors
    /// Readings that an estimator cannot start from.
    fn state_into(&mut self, known: Known<'_>, out: &mut RobotState) -> Result<(), DesignError>;
}

/// The truth.
#[derive(Clone, Copy, Debug)]
pub struct TrueState;

impl Feedback for TrueState {
    fn state_into(&mut self, known: Known<'_>, out: &mut RobotState) -> Result<(), DesignError> {
        out.q.copy_from_slice(known.truth.q);
        out.dq.copy_from_slice(known.truth.dq);
        out.theta.copy_from_slice(known.truth.theta);
        out.dtheta.copy_from_slice(known.truth.dtheta);
        Ok(())
    }
}

/// Readings of motor positions and velocities, the last ones where missing; links taken to be where their motors are.
#[derive(Clone, Copy, Debug)]
pub struct SensorFeedback {
    /// Where motor velocities begin among the readings.
    pub velocities: usize,
}

impl Feedback for SensorFeedback {
    fn state_into(&mut self, known: Known<'_>, out: &mut RobotState) -> Result<(), DesignError> {
        let RobotState { q, dq, theta, dtheta } = out;
        for (from, motor, link) in [(0, theta, q), (self.velocities, dtheta, dq)] {
            for (value, reading) in motor.iter_mut().zip(&known.readings[from..]).filter(|(_, r)| r.is_finite()) {
                *value = *reading;
            }
            link.copy_from_slice(motor);
        }
        Ok(())
    }
}

/// Of a step, what is wrong with its sample. An estimator that is lost tells no number, which ends the simulation with the
/// time at which it was.
fn usable(outcome: Result<(), RunError>) -> Result<(), DesignError> {
    match outcome {
        Err(RunError::Design(error)) => Err(error),
        _ => Ok(()),
    }
}

/// The elastic-joint filter's estimate from some of the readings.
#[derive(Clone)]
pub struct FilterFeedback {
    filter: ExtendedKalmanFilter<ElasticModel>,
    layout: ElasticLayout,
    /// Which readings it takes, in its own order.
    channels: Vec<usize>,
    readings: Vec<f64>,
}

impl FilterFeedback {
    /// A filter that takes the readings of index `channels`.
    ///
    /// # Errors
    /// Not as many as the filter has channels.
    pub fn new(filter: ExtendedKalmanFilter<ElasticModel>, channels: Vec<usize>) -> Result<Self, DesignError> {
        use crate::estimate::kalman::Model;
        let found = channels.len();
        expect_length("channels of the filter", found, filter.model().channels())?;
        let layout = ElasticLayout::new(filter.model().robot(), false);
        Ok(Self { filter, layout, readings: vec![0.0; found], channels })
    }
}

impl Feedback for FilterFeedback {
    fn state_into(&mut self, known: Known<'_>, out: &mut RobotState) -> Result<(), DesignError> {
        for (reading, &channel) in self.readings.iter_mut().zip(&self.channels) {
            *reading = known.readings[channel];
        }
        let inputs = Inputs { tau: known.tau, ..Inputs::default() };
        usable(self.filter.step(KalmanSample { dt: known.dt, readings: &self.readings, inputs }))?;
        let (n, mean) = (self.layout.joints, &self.filter.belief().mean);
        out.q.copy_from_slice(&mean[..n]);
        out.dq.copy_from_slice(&mean[n..2 * n]);
        for j in 0..n {
            out.theta[j] = mean[self.layout.theta[j]];
            out.dtheta[j] = mean[self.layout.dtheta[j]];
        }
        Ok(())
    }
}

/// The acceleration-driven observer's estimate from motor positions, accelerometers and the torque of the controller.
#[derive(Clone, Debug)]
pub struct ObserverFeedback {
    observer: AccelerationObserver,
}

impl ObserverFeedback {
    /// An observer by the accelerometers of a robot like `robot`, designed for the period of the simulation.
    ///
    /// # Errors
    /// Another number of joints or of accelerometers' channels.
    pub fn new(observer: AccelerationObserver, robot: &Robot) -> Result<Self, DesignError> {
        for (what, found, expected) in [
            ("joints of the observer", observer.joints(), robot.len()),
            ("accelerations of the observer", observer.channels(), robot.acceleration_channels()),
        ] {
            expect_length(what, found, expected)?;
        }
        Ok(Self { observer })
    }
}

impl Feedback for ObserverFeedback {
    fn state_into(&mut self, known: Known<'_>, out: &mut RobotState) -> Result<(), DesignError> {
        let Self { observer } = self;
        let (theta, others) = known.readings.split_at(observer.joints());
        // The torque was chosen after the last sample, from its estimate.
        observer.hold(known.tau)?;
        usable(observer.step(ObserverSample { theta, tau: known.tau, acceleration: &others[..observer.channels()] }))?;
        out.q.copy_from_slice(observer.q());
        out.dq.copy_from_slice(observer.dq());
        for j in 0..observer.joints() {
            (out.theta[j], out.dtheta[j]) = observer.motor(j);
        }
        Ok(())
    }
}
