//! The observer, sample by sample.
//!
//! A step at sample k, for each joint on its own but for q̈, which all share:
//!
//! 1. predict (θ, q, θ̇, q̇) over the period by the exact map of the linear model, with the torque and the acceleration of the sample
//!    before ([`Sampled`]);
//! 2. correct them by the innovation θ_k − θ̂: with the gain of the poles where the last sample was there too, with gains that vary
//!    in time at the start and after a gap (`late`, `correction`);
//! 3. q̈ from the accelerometers at the corrected posture, by weighted least squares ([`AccelerationMap`]);
//! 4. what the linear model lacks (nonlinear springs, friction, inertial coupling) as a torque for the next period, at the estimate.

use super::super::acceleration::Observability;
use super::super::deviations::{ObserverDeviations, ObserverView};
use super::super::gains::JointModel;
use super::super::recording::ObserverSample;
use super::super::settings::{AccelerationSource, Start};
use super::{AccelerationObserver, joint_state};
use crate::error::DesignError;
use crate::estimate::Status;
use crate::simd::{self, Kernel};

/// An observer's step, to be compiled for each instruction set.
pub(super) struct ObserverStep<'a, 'b> {
    pub(super) observer: &'a mut AccelerationObserver,
    pub(super) sample: ObserverSample<'b>,
}

impl Kernel for ObserverStep<'_, '_> {
    type Output = Result<(), DesignError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.observer.take_here(self.sample)
    }
}

impl AccelerationObserver {
    /// One period: predict, read accelerations, correct, hold.
    #[inline(always)]
    fn take_here(&mut self, sample: ObserverSample<'_>) -> Result<(), DesignError> {
        self.status = 0;
        let first = !self.started;
        if self.started {
            // 1. The model over the last period, torque and accelerations held at their last values.
            self.predict();
            // 2. Accelerations at the predicted posture, from this sample's readings (eq. (12)).
            self.read_accelerations(sample.acceleration);
            // 3. The prediction again, as if accelerations had run straight from the last sample to this one.
            self.interpolate();
        } else {
            // A first sample: θ as read, links where gravity lets them hang.
            self.start_from_rest(sample.theta)?;
            self.read_accelerations(sample.acceleration);
        }
        // 4. The innovation θ − θ̂ moves all states of its joint.
        self.correct(sample.theta, first);
        // 5. The torque from now on; what the linear model lacks is taken off at the corrected state.
        self.hold_torque(sample.tau);
        self.report();
        // 6. How far off that may be.
        self.deviate(sample, first);
        self.taken += 1;
        Ok(())
    }

    /// Standard deviations, where they are wanted.
    #[inline(always)]
    fn deviate(&mut self, sample: ObserverSample<'_>, first: bool) {
        if self.deviations.is_none() {
            return;
        }
        for j in 0..self.joints.len() {
            self.loaded[j] = self.torque[j] - self.coupling_torque(j, &self.measured);
            self.innovations[j] = self.corrections[j].means();
        }
        let Self { deviations, robot, models, map, state, q, dq, ddq, measured, loaded, innovations, .. } = self;
        let links = [&q[..], &dq[..], &ddq[..]];
        let look = ObserverView { robot, models, map, state, links, measured, torque: loaded, innovations };
        if let Some(deviations) = deviations {
            simd::phase(Deviate { deviations, look: &look, sample, first });
            if deviations.is_stuck() {
                self.status |= Status::CONTRADICTED | Status::FAULTY;
            }
        }
    }

    /// A first sample: at rest, with gains that let the next samples say otherwise where [`Start`] is to be found out.
    fn start_from_rest(&mut self, theta: &[f64]) -> Result<(), DesignError> {
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        let q = self.rest.find(&self.robot, theta)?;
        for (j, (state, model)) in self.state.iter_mut().zip(&self.models).enumerate() {
            *state = joint_state(*model, theta[j], q[j], [0.0; 2]);
        }
        self.begin(self.settings.start);
        if let Some(deviations) = &mut self.deviations {
            let (corrections, start) = (&self.corrections, self.settings.start);
            deviations.begin_hanging(&self.robot, &self.state, |j| match start {
                Start::Auto => corrections[j].first_covariance(),
                Start::Rest => Default::default(),
            });
        }
        Ok(())
    }

    /// One period on, everything held.
    #[inline(always)]
    fn predict(&mut self) {
        for j in 0..self.joints.len() {
            // Joint by joint: given q̈, the motors' equations are not coupled (Theorem 1).
            let torque = self.torque[j] - self.coupling_torque(j, &self.measured);
            self.predicted[j] = self.joints[j].predict(&self.state[j], torque, self.measured[j]);
        }
        self.previous.copy_from_slice(&self.measured);
    }

    /// Sᵀq̈ on motor j for measured accelerations, less their estimated bias.
    #[inline(always)]
    fn coupling_torque(&self, j: usize, measured: &[f64]) -> f64 {
        let n = self.joints.len();
        let mut sum = 0.0;
        // S is strictly upper triangular: the motor of joint j feels the joints before it.
        for i in 0..j {
            let s = self.robot.coupling[i * n + j];
            if s != 0.0 {
                sum += s * (measured[i] - self.state[i][4]);
            }
        }
        sum
    }

    /// Link accelerations at the predicted state.
    #[inline(always)]
    fn read_accelerations(&mut self, reading: &[f64]) {
        if reading.iter().any(|x| x.is_nan()) {
            self.status |= Status::BRIDGED;
        }
        match self.settings.source {
            AccelerationSource::Joints => {
                for (kept, &value) in self.measured.iter_mut().zip(reading) {
                    *kept = if value.is_nan() { *kept } else { value };
                }
            }
            AccelerationSource::Sensors => self.read_sensors(reading),
        }
    }

    /// Link accelerations by least squares from the accelerometers, at the predicted posture and velocity (eq. (12)).
    #[inline(always)]
    fn read_sensors(&mut self, reading: &[f64]) {
        // A prior of zero where the sensors cannot see; of what it last was where they are silent for a moment.
        let silent = self.status & Status::BRIDGED != 0;
        for j in 0..self.joints.len() {
            let x = &self.predicted[j];
            match self.models[j] {
                JointModel::Rigid => {
                    (self.q[j], self.dq[j], self.ddq[j]) = (x[0], x[1], x[2]);
                    self.measured[j] = x[2];
                }
                _ => {
                    (self.q[j], self.dq[j], self.ddq[j]) = (x[1], x[3], 0.0);
                    self.measured[j] = if silent { self.measured[j] } else { 0.0 };
                }
            }
        }
        self.kinematics.set_motion(&self.robot.tree, &self.q, &self.dq, &self.ddq);
        self.status |= match self.map.solve(&self.robot, &self.kinematics, reading, &mut self.measured) {
            Observability::Full => 0,
            Observability::Damped => Status::DAMPED,
            Observability::Unobservable => Status::DAMPED | Status::UNSEEN,
        };
    }

    /// Redoes the prediction with accelerations on a straight line between the samples.
    #[inline(always)]
    fn interpolate(&mut self) {
        for j in 0..self.joints.len() {
            // What was held is replaced by a ramp: only the change enters, through the ramp response.
            let torque = self.coupling_torque(j, &self.previous) - self.coupling_torque(j, &self.measured);
            let change = self.measured[j] - self.previous[j];
            self.joints[j].interpolate(&mut self.predicted[j], torque, change);
        }
    }

    /// Uses the motor positions; those of a `first` sample have made the state.
    #[inline(always)]
    fn correct(&mut self, theta: &[f64], first: bool) {
        for j in 0..self.joints.len() {
            self.state[j] = self.predicted[j];
            // NaN where θ is missing; the correction then remembers the gap, and the next gain is that of a longer one.
            let innovation = theta[j] - self.predicted[j][0];
            if innovation.is_nan() {
                self.status |= Status::BRIDGED;
            }
            if let Some(deviations) = &self.deviations {
                self.corrections[j].expect(deviations.surprise(j));
            }
            let used = self.corrections[j].apply(&self.joints[j], &mut self.state[j], innovation);
            if let Some(deviations) = self.deviations.as_mut().filter(|_| !first) {
                deviations.take(j, &self.joints[j], &used);
            }
            if self.corrections[j].is_contradicted() {
                self.status |= Status::CONTRADICTED;
            }
        }
    }

    /// The torque that acts until the next sample: measured, less dry friction and the spring's nonlinear part.
    #[inline(always)]
    pub(super) fn hold_torque(&mut self, tau: &[f64]) {
        for j in 0..self.joints.len() {
            if self.models[j] == JointModel::Rigid {
                continue;
            }
            let (drive, x) = (&self.robot.drives[j], &self.state[j]);
            if tau[j].is_nan() {
                self.status |= Status::BRIDGED;
            } else {
                // Feedforward of the nonlinear terms at the estimate keeps the error's dynamics linear but for their
                // own error.
                self.torque[j] = tau[j] - drive.dry_friction(x[2]) - drive.nonlinear_torque(x[0] - x[1]);
            }
        }
    }

    /// What the getters give: the corrected or the predicted state, and the tool.
    #[inline(always)]
    fn report(&mut self) {
        for j in 0..self.joints.len() {
            let x = self.reported(j);
            (self.q[j], self.dq[j], self.ddq[j]) = match self.models[j] {
                JointModel::Rigid => (x[0], x[1], x[2]),
                _ => (x[1], x[3], self.measured[j] - x[4]),
            };
        }
        if let Some(tool) = &self.robot.tool {
            self.kinematics.set_position(&self.robot.tree, &self.q);
            self.tool = self.kinematics.position(tool).0;
        }
    }
}

/// Standard deviations after a step, likewise.
struct Deviate<'a, 'b> {
    deviations: &'a mut ObserverDeviations,
    look: &'a ObserverView<'b>,
    sample: ObserverSample<'b>,
    first: bool,
}

impl Kernel for Deviate<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.deviations.look(self.look, self.sample, self.first);
    }
}
