//! How far off an observer's links and tool may be.
//!
//! Each joint's error has dynamics of its own ([`JointError`]). What drives them is computed where the robot is estimated to be,
//! every few samples, as it changes no faster than the robot moves; so are the standard deviations.

use super::acceleration::AccelerationMap;
use super::gains::JointModel;
use super::joint_error::{JointError, Used};
use super::late::{JointCovariance, READING};
use super::sampled::{JointState, Sampled};
use super::sensor_errors::SensorErrors;
use super::settings::AccelerationSource;
use super::uncertainty::{Columns, Place, Uncertainty};
use crate::dynamics::{Kinematics, Loads};
use crate::estimate::kalman::Uncertain;
use crate::linear;
use crate::robot::{Drive, Robot};

/// For how long it is remembered how fast torques change [s].
const MEMORY: f64 = 0.2;
/// Samples that are taken at once span at most this share of the time of the fastest pole, and are at most so many.
const SHARE: f64 = 1.0;
const MOST: f64 = 8.0;

/// An observer at a sample, for who judges it.
#[derive(Clone, Copy)]
pub(super) struct ObserverView<'a> {
    pub(super) robot: &'a Robot,
    pub(super) models: &'a [JointModel],
    pub(super) map: &'a AccelerationMap,
    /// Corrected states (n), and what is reported: q, q̇ and q̈ (n).
    pub(super) state: &'a [JointState],
    pub(super) links: [&'a [f64]; 3],
    /// Measured accelerations of links (n), and what they were solved from.
    pub(super) measured: &'a [f64],
    pub(super) acceleration: &'a [f64],
    /// Torque on each motor's row of the linear model (n), coupling included.
    pub(super) torque: &'a [f64],
    /// Mean squares of the innovations (n).
    pub(super) innovations: &'a [f64],
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub(super) struct ObserverDeviations {
    columns: Columns,
    source: AccelerationSource,
    joints: Vec<JointError>,
    sensors: SensorErrors,
    kinematics: Kinematics<f64>,
    yielding: Option<Yielding>,
    /// Variance of a constant between motor and link (n) [rad²].
    offsets: Vec<f64>,
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
    /// By how much numbers may change the innovations (n), and what steps of lost motion do to them at most [rad²].
    surprises: Vec<f64>,
    shocks: Vec<f64>,
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
        let shock = |j: usize| {
            let torque = of(Uncertain::LostMotion(j)) * robot.drives[j].stiffness;
            if models[j] == JointModel::Rigid { 0.0 } else { (torque * joints[j].shock()).powi(2) }
        };
        let heaviest = (0..n).map(|j| of(Uncertain::Mass(j))).fold(0.0, f64::max);
        Self {
            shocks: (0..n).map(shock).collect(),
            offsets: (0..n).map(offset).collect(),
            loads: vec![heaviest; n],
            sensors: SensorErrors::new(robot, &uncertainty.tolerances, uncertainty.bias),
            kinematics: Kinematics::new(&robot.tree),
            yielding: Yielding::new(robot, uncertainty),
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
            columns,
            source,
            joints,
        }
    }

    fn reset(&mut self) {
        (self.since, self.uneven, self.apart) = (0, false, false);
        for last in &mut self.torques {
            *last = LastTorque { value: 0.0, pace: 0.0, missing: NEVER, ..*last };
        }
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
    pub(super) fn look(&mut self, look: &ObserverView<'_>, tau: &[f64], first: bool) {
        let mut uneven = look.acceleration.iter().any(|a| a.is_nan());
        for ((last, &tau), model) in self.torques.iter_mut().zip(tau).zip(look.models) {
            last.take(tau);
            uneven |= tau.is_nan() && *model != JointModel::Rigid;
        }
        self.since += 1;
        if self.since >= self.every || first || uneven || self.uneven {
            self.since = 0;
            self.drive(look);
            self.joints.iter_mut().for_each(|joint| if first { joint.hold() } else { joint.close() });
            self.sum_up(look);
        } else if self.apart {
            self.sum_up(look);
        }
        (self.uneven, self.apart) = (uneven, false);
    }

    /// By how much a joint's innovation may be off, its variance [rad²].
    #[inline(always)]
    pub(super) fn surprise(&self, j: usize) -> f64 {
        self.surprises[j] + self.shocks[j]
    }

    /// What a standard deviation of each number does, where the robot is.
    #[inline(always)]
    fn drive(&mut self, look: &ObserverView<'_>) {
        let Self { columns, joints, sensors, kinematics, torques, measured, .. } = self;
        let [q, dq, ddq] = look.links;
        kinematics.set_motion(&look.robot.tree, q, dq, ddq);
        if self.source == AccelerationSource::Sensors {
            sensors.set(look.robot, kinematics, look.map, look.acceleration);
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
            let shared = &mut joint.next[columns.accelerations.clone()];
            match (self.source, look.map.column(j)) {
                (AccelerationSource::Sensors, Some(unknown)) => {
                    sensors.drive_into(unknown, shared);
                    joint.shaking = sensors.noise(unknown);
                }
                _ => (shared[2 * j], shared[2 * j + 1]) = (measured[0], measured[1] * look.measured[j]),
            }
        }
        if let Some(yielding) = &mut self.yielding {
            yielding.set(look.robot, kinematics);
        }
    }

    /// Variances of links and tool, and of innovations.
    #[inline(always)]
    fn sum_up(&mut self, look: &ObserverView<'_>) {
        let Self { columns, joints, offsets, variances, q_std, surprises, .. } = self;
        let own = ..columns.accelerations.start;
        for (j, joint) in joints.iter().enumerate() {
            let by = joint.of_link();
            // What joints do not share, which the tool needs apart.
            variances[j] = linear::dot(&by[own], &by[own]) + joint.noise() + offsets[j];
            if look.models[j] == JointModel::Rigid {
                // Its link is where its motor is, which is read: no further off than the innovations.
                variances[j] += look.innovations[j] + self.yielding.as_ref().map_or(0.0, |y| y.variance(j));
            }
            let shared = &by[columns.accelerations.clone()];
            let mut variance = variances[j] + linear::dot(shared, shared);
            for &(a, b, value) in &columns.correlations {
                let of = |(joint, column): Place| if joint.is_none_or(|i| i == j) { by[column] } else { 0.0 };
                variance += 2.0 * value * of(a) * of(b);
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
        let Self { columns, joints, kinematics, variances, jacobian, along, tool_std, .. } = self;
        let n = joints.len();
        jacobian.fill(0.0);
        kinematics.position_jacobian(&robot.tree, tool, |j, by| {
            (0..3).for_each(|axis| jacobian[axis * n + j] = by.0[axis]);
        });
        for (std, row) in tool_std.iter_mut().zip(jacobian.chunks_exact(n)) {
            along.fill(0.0);
            let mut variance = 0.0;
            for ((by, joint), apart) in row.iter().zip(joints.iter()).zip(variances.iter()) {
                linear::add_scaled(along, *by, &joint.of_link()[columns.accelerations.clone()]);
                variance += by * by * apart;
            }
            variance += linear::dot(along, along);
            for &(a, b, value) in &columns.correlations {
                let of = |(joint, column): Place| match joint {
                    Some(j) => row[j] * joints[j].of_link()[column],
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

/// Samples since a reading that there was none of: the first one is no change of the torque.
const NEVER: f64 = 1e12;

/// A motor's torque as it was last read, and how far it may be from that.
#[derive(Clone, Copy, Debug)]
struct LastTorque {
    value: f64,
    /// Noise of a reading [N m].
    std: f64,
    /// By how much it lately changed at most in a sample [N m], and the part of that which is left a sample later.
    pace: f64,
    fading: f64,
    /// Samples without a reading.
    missing: f64,
}

impl LastTorque {
    fn new(std: f64, period: f64) -> Self {
        Self { value: 0.0, std, pace: 0.0, fading: 1.0 - (period / MEMORY).min(1.0), missing: NEVER }
    }

    #[inline(always)]
    fn take(&mut self, tau: f64) {
        if tau.is_nan() {
            self.missing += 1.0;
            return;
        }
        let change = ((tau - self.value) / (self.missing + 1.0)).abs();
        self.pace = change.max(self.pace * self.fading);
        (self.value, self.missing) = (tau, 0.0);
    }

    /// How far off it may be while it is not read: it goes on as it went [N m].
    #[inline(always)]
    fn doubt(&self) -> f64 {
        let gone = self.missing * self.pace;
        if self.missing > 0.0 { (self.std * self.std + gone * gone).sqrt() } else { 0.0 }
    }
}

/// How far joints that are taken as rigid give way under their loads.
#[derive(Clone, Debug)]
struct Yielding {
    /// Of each joint; 0 of an elastic one [s²].
    stds: Vec<f64>,
    loads: Loads<f64>,
    torque: Vec<f64>,
    mass: Vec<f64>,
}

impl Yielding {
    fn new(robot: &Robot, uncertainty: &Uncertainty) -> Option<Self> {
        let n = robot.len();
        let stds: Vec<f64> = (0..n).map(|j| uncertainty.of(Uncertain::Yielding(j))).collect();
        let any = stds.iter().any(|std| *std > 0.0);
        any.then(|| Self { stds, loads: Loads::new(&robot.tree), torque: vec![0.0; n], mass: vec![0.0; n * n] })
    }

    #[inline(always)]
    fn set(&mut self, robot: &Robot, kinematics: &Kinematics<f64>) {
        self.loads.inverse_dynamics_into(&robot.tree, kinematics, &mut self.torque);
        self.loads.mass_matrix_into(&robot.tree, kinematics, &mut self.mass);
    }

    /// The torque over the inertia that turns on the joint; links without inertia do not load it.
    #[inline(always)]
    fn variance(&self, j: usize) -> f64 {
        let inertia = self.mass[j * self.stds.len() + j];
        if inertia > 0.0 { (self.stds[j] * self.torque[j] / inertia).powi(2) } else { 0.0 }
    }
}
