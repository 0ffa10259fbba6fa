//! How far off an observer's links and tool may be.
//!
//! Each joint's error has dynamics of its own ([`JointError`]). What drives them is computed where the robot is estimated to be,
//! every few samples, as it changes no faster than the robot moves; so are the standard deviations.

use super::acceleration::AccelerationMap;
use super::correction::WINDOW;
use super::excess::Excess;
use super::gains::JointModel;
use super::joint_error::{JointError, Used};
use super::last_torque::LastTorque;
use super::late::{JointCovariance, READING};
use super::link_load::LinkLoad;
use super::recording::ObserverSample;
use super::repeats::Repeats;
use super::sampled::{JointState, Sampled};
use super::sensor_errors::SensorErrors;
use super::settings::AccelerationSource;
use super::uncertainty::{Columns, Place, Uncertainty};
use crate::dynamics::Kinematics;
use crate::estimate::kalman::Uncertain;
use crate::linear;
use crate::robot::{Drive, Robot};

/// Samples that are taken at once span at most this share of the time of the fastest pole, and are at most so many.
const SHARE: f64 = 1.0;
const MOST: f64 = 8.0;

/// Dry friction has either sign at standstill: off by twice its size at most, which is three standard deviations.
const STICKING: f64 = 2.0 / 3.0;
/// Speed below which its sign is hardly known [rad/s].
const CREEP: f64 = 1e-2;

/// An observer at a sample, for who judges it.
#[derive(Clone, Copy)]
pub(super) struct ObserverView<'a> {
    pub(super) robot: &'a Robot,
    pub(super) models: &'a [JointModel],
    pub(super) map: &'a AccelerationMap,
    /// Corrected states (n), and what is reported: q, q̇ and q̈ (n).
    pub(super) state: &'a [JointState],
    pub(super) links: [&'a [f64]; 3],
    /// Measured accelerations of links (n).
    pub(super) measured: &'a [f64],
    /// Torque on each motor's row of the linear model (n), coupling included.
    pub(super) torque: &'a [f64],
    /// Mean squares of the innovations, and what they are to be (n).
    pub(super) innovations: &'a [[f64; 2]],
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub(super) struct ObserverDeviations {
    columns: Columns,
    source: AccelerationSource,
    joints: Vec<JointError>,
    sensors: SensorErrors,
    kinematics: Kinematics<f64>,
    load: Option<LinkLoad>,
    /// Readings that repeat themselves.
    repeats: Repeats,
    /// Variance of a constant between motor and link (n) [rad²].
    offsets: Vec<f64>,
    /// What dry friction may be off by at standstill, a standard deviation (n) [N m].
    sticking: Vec<f64>,
    /// By how much a joint's load may be off at the start, as a share of it (n).
    loads: Vec<f64>,
    /// Bias and scale of measured joint accelerations.
    measured: [f64; 2],
    torques: Vec<LastTorque>,
    /// Samples at once, and those since the last.
    every: u32,
    since: u32,
    /// Whether a torque or an acceleration was missing at the last sample, and whether a joint's sample was not corrected by the
    /// poles.
    uneven: bool,
    apart: bool,
    /// Variances of links (n) [rad²].
    variances: Vec<f64>,
    /// ∂tool/∂q, a row of n each, and scratch (acceleration columns).
    jacobian: Vec<f64>,
    along: Vec<f64>,
    pub(super) q_std: Vec<f64>,
    pub(super) tool_std: [f64; 3],
    /// What the variances of innovations are to be (n), and what a step of lost motion makes of them [rad²].
    surprises: Vec<f64>,
    shocks: Vec<f64>,
    excess: Vec<Excess>,
}

impl ObserverDeviations {
    pub(super) fn new(
        robot: &Robot,
        models: &[JointModel],
        joints: &[Sampled],
        [speed, period]: [f64; 2],
        source: AccelerationSource,
        uncertainty: &Uncertainty,
    ) -> Self {
        let n = robot.len();
        let columns = Columns::new(robot, uncertainty, source);
        let every = (SHARE / (speed * period)).clamp(1.0, MOST) as u32;
        let (stride, of) = (columns.accelerations.end, |parameter| uncertainty.of(parameter));
        let error = |(j, joint): (usize, &Sampled)| {
            let rigid = models[j] == JointModel::Rigid;
            let layout = if rigid {
                [columns.readings.clone(), 0..0, 0..0]
            } else {
                [columns.readings.clone(), columns.torques.clone(), columns.accelerations.clone()]
            };
            let variances = [uncertainty.encoder[j], uncertainty.torque[j]].map(|std| std * std);
            JointError::new(joint, [models[j].order(), link_of(models[j])], (layout, stride), every, variances)
        };
        let joints: Vec<_> = joints.iter().enumerate().map(error).collect();
        let offset = |j: usize| {
            let each = [of(Uncertain::EncoderZero(j)), of(Uncertain::LostMotion(j)), uncertainty.encoder[j], READING];
            each.iter().map(|std| std * std).sum()
        };
        let samples = (WINDOW / period).max(1.0) as usize;
        let shock = |j: usize| {
            let torque = of(Uncertain::LostMotion(j)) * robot.drives[j].stiffness;
            if models[j] == JointModel::Rigid { 0.0 } else { torque * torque * joints[j].shock(samples) }
        };
        let sticking = |j: usize| {
            let friction = &robot.drives[j].motor_friction;
            let known = of(Uncertain::MotorFriction(j)) == 0.0;
            if known { 0.0 } else { STICKING * (friction.coulomb + friction.stribeck) }
        };
        let heaviest = (0..n).map(|j| of(Uncertain::Mass(j))).fold(0.0, f64::max);
        Self {
            shocks: (0..n).map(shock).collect(),
            offsets: (0..n).map(offset).collect(),
            loads: vec![heaviest; n],
            sensors: SensorErrors::new(robot, &uncertainty.tolerances, uncertainty.bias),
            kinematics: Kinematics::new(&robot.tree),
            load: LinkLoad::new(robot, uncertainty, f64::from(every) * period),
            repeats: Repeats::new(robot, uncertainty, source, period),
            sticking: (0..n).map(sticking).collect(),
            measured: [uncertainty.bias, uncertainty.scale],
            torques: uncertainty.torque.iter().map(|&std| LastTorque::new(std, period)).collect(),
            uneven: false,
            apart: false,
            every,
            since: 0,
            variances: vec![0.0; n],
            jacobian: vec![0.0; 3 * n],
            along: vec![0.0; columns.accelerations.len()],
            q_std: vec![0.0; n],
            tool_std: [f64::NAN; 3],
            surprises: vec![0.0; n],
            excess: vec![Excess::new(f64::from(every) * period); n],
            columns,
            source,
            joints,
        }
    }

    fn reset(&mut self) {
        (self.since, self.uneven, self.apart) = (0, false, false);
        self.torques.iter_mut().for_each(LastTorque::reset);
        self.repeats.reset();
        self.excess.iter_mut().for_each(Excess::reset);
    }

    /// From a state that is known.
    pub(super) fn begin_known(&mut self) {
        self.reset();
        self.joints.iter_mut().for_each(|joint| joint.begin(JointCovariance::default(), |_| 0.0));
    }

    /// From where links hang on their springs at the corrected states, and what is not known of joint `j` beside.
    pub(super) fn begin_hanging(
        &mut self,
        robot: &Robot,
        state: &[JointState],
        spread: impl Fn(usize) -> JointCovariance,
    ) {
        self.reset();
        let Self { joints, columns, loads, .. } = self;
        for (j, joint) in joints.iter_mut().enumerate() {
            let (drive, [theta, q, ..]) = (&robot.drives[j], state[j]);
            let mut known = spread(j);
            if !drive.elastic {
                joint.begin(known, |_| 0.0);
                continue;
            }
            // A spring that is harder twists less, and a load that is heavier more.
            let torsion = theta - q;
            let twist = drive.spring_torque(torsion) * drive.compliance(torsion);
            known[1][1] += (loads[j] * twist).powi(2);
            let shift = |parameter| match parameter {
                Uncertain::Stiffness(_) => twist,
                Uncertain::CubicStiffness(_) => drive.hardening(torsion) * drive.compliance(torsion),
                _ => 0.0,
            };
            let own = &columns.own[j];
            joint.begin(known, |column| {
                own.iter().find(|one| one.column == column).map_or(0.0, |one| shift(one.parameter) * one.std)
            });
        }
    }

    /// A joint's sample.
    #[inline(always)]
    pub(super) fn take(&mut self, j: usize, joint: &Sampled, used: &Used) {
        self.joints[j].take(joint, used);
        self.apart |= !matches!(used, Used::Poles);
    }

    /// After a sample: standard deviations anew where it is time for it.
    #[inline(always)]
    pub(super) fn look(&mut self, look: &ObserverView<'_>, sample: ObserverSample<'_>, first: bool) {
        let ObserverSample { tau, .. } = sample;
        let mut uneven = sample.acceleration.iter().any(|a| a.is_nan());
        for ((last, &tau), model) in self.torques.iter_mut().zip(tau).zip(look.models) {
            last.take(tau);
            uneven |= tau.is_nan() && *model != JointModel::Rigid;
        }
        self.since += 1;
        if self.since >= self.every || first || uneven || self.uneven {
            self.since = 0;
            self.drive(look, sample.acceleration, first);
            self.joints.iter_mut().for_each(|joint| if first { joint.hold() } else { joint.close() });
            self.excess.iter_mut().zip(look.innovations).for_each(|(excess, means)| excess.take(*means));
            self.sum_up(look);
        } else if self.apart {
            self.sum_up(look);
        }
        (self.uneven, self.apart) = (uneven, false);
        let doubts = (&self.columns, &self.joints[..]);
        self.repeats.take(sample, look, doubts);
    }

    /// Whether a channel repeats a reading that it cannot have.
    #[inline(always)]
    pub(super) fn is_stuck(&self) -> bool {
        self.repeats.is_stuck()
    }

    /// What the variance of a joint's innovation is to be [rad²].
    #[inline(always)]
    pub(super) fn surprise(&self, j: usize) -> f64 {
        self.surprises[j] + self.shocks[j]
    }

    /// What a standard deviation of each number does, where the robot is.
    #[inline(always)]
    fn drive(&mut self, look: &ObserverView<'_>, acceleration: &[f64], first: bool) {
        let Self { columns, joints, sensors, kinematics, torques, measured, sticking, .. } = self;
        let [q, dq, ddq] = look.links;
        kinematics.set_motion(&look.robot.tree, q, dq, ddq);
        if self.source == AccelerationSource::Sensors {
            sensors.set(look.robot, kinematics, look.map, acceleration);
        }
        for (j, joint) in joints.iter_mut().enumerate() {
            let (drive, x) = (&look.robot.drives[j], &look.state[j]);
            for own in &columns.own[j] {
                joint.next[own.column] = own.std * error_of(drive, own.parameter, x, torques[j].value, look.torque[j]);
            }
            if look.models[j] == JointModel::Rigid {
                continue;
            }
            joint.next[columns.missing] = torques[j].doubt();
            joint.next[columns.sticking] = sticking[j] / (1.0 + (x[2] / CREEP).powi(2));
            let shared = &mut joint.next[columns.accelerations.clone()];
            match (self.source, look.map.column(j)) {
                (AccelerationSource::Sensors, Some(unknown)) => {
                    sensors.drive_into(unknown, shared);
                    joint.shaking = sensors.noise(unknown);
                }
                _ => (shared[2 * j], shared[2 * j + 1]) = (measured[0], measured[1] * look.measured[j]),
            }
        }
        if let Some(load) = &mut self.load {
            load.compare(look, kinematics, (columns, joints), first);
        }
    }

    /// Variances of links and tool, and of innovations.
    #[inline(always)]
    fn sum_up(&mut self, look: &ObserverView<'_>) {
        let Self { columns, joints, offsets, variances, q_std, surprises, excess, .. } = self;
        let own = ..columns.accelerations.start;
        for (j, joint) in joints.iter().enumerate() {
            let by = joint.of_link();
            // What joints do not share, which the tool needs apart.
            let load = self.load.as_ref().map_or(0.0, |load| load.variances[j]);
            let factor = excess[j].factor();
            variances[j] = factor * linear::dot(&by[own], &by[own]) + joint.noise() + offsets[j] + load;
            if look.models[j] == JointModel::Rigid {
                // Its link is where its motor is, which is read: no further off than the innovations.
                variances[j] += look.innovations[j][0];
            }
            let shared = &by[columns.accelerations.clone()];
            let mut variance = variances[j] + factor * linear::dot(shared, shared);
            for &(a, b, value) in &columns.correlations {
                let of = |(joint, column): Place| if joint.is_none_or(|i| i == j) { by[column] } else { 0.0 };
                variance += 2.0 * value * factor * of(a) * of(b);
            }
            q_std[j] = variance.max(0.0).sqrt();
            surprises[j] = joint.surprise();
        }
        self.sum_up_tool(look.robot);
    }

    /// σ² = J P Jᵀ of each coordinate of the tool.
    #[inline(always)]
    fn sum_up_tool(&mut self, robot: &Robot) {
        let Some(tool) = &robot.tool else { return };
        let Self { columns, joints, kinematics, variances, jacobian, along, tool_std, excess, .. } = self;
        let n = joints.len();
        jacobian.fill(0.0);
        kinematics.position_jacobian(&robot.tree, tool, |j, by| {
            (0..3).for_each(|axis| jacobian[axis * n + j] = by.0[axis]);
        });
        for (std, row) in tool_std.iter_mut().zip(jacobian.chunks_exact(n)) {
            along.fill(0.0);
            let mut variance = 0.0;
            for (j, joint) in joints.iter().enumerate() {
                let shared = &joint.of_link()[columns.accelerations.clone()];
                linear::add_scaled(along, row[j] * excess[j].factor().sqrt(), shared);
                variance += row[j] * row[j] * variances[j];
            }
            variance += linear::dot(along, along);
            for &(a, b, value) in &columns.correlations {
                let of = |(joint, column): Place| match joint {
                    Some(j) => row[j] * excess[j].factor().sqrt() * joints[j].of_link()[column],
                    None => along[column - columns.accelerations.start],
                };
                variance += 2.0 * value * of(a) * of(b);
            }
            *std = variance.max(0.0).sqrt();
        }
    }
}

/// Which state is the position of the link.
pub(super) fn link_of(model: JointModel) -> usize {
    usize::from(model != JointModel::Rigid)
}

/// What a unit error of a drive's number gives the motor more than the model has it [N m], or its encoder [rad].
///
/// `torque` is that on the row of the linear model.
#[inline(always)]
fn error_of(drive: &Drive, parameter: Uncertain, x: &JointState, tau: f64, torque: f64) -> f64 {
    let [theta, q, dtheta, dq, _] = *x;
    match parameter {
        Uncertain::EncoderLine(_, line) => drive.encoder_line(line, theta),
        Uncertain::Stiffness(_) => -drive.spring_torque(theta - q),
        Uncertain::CubicStiffness(_) => -drive.hardening(theta - q),
        Uncertain::Damping(_) => -drive.damping * (dtheta - dq),
        Uncertain::TorqueConstant(_) => tau,
        Uncertain::MotorFriction(_) => -drive.motor_friction.torque(dtheta).0,
        // −B θ̈ by the equation of motion.
        Uncertain::MotorInertia(_) => {
            let drag = drive.motor_friction.viscous * dtheta + drive.damping * (dtheta - dq);
            drive.stiffness * (theta - q) + drag - torque
        }
        _ => 0.0,
    }
}
