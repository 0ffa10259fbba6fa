//! What the links' masses say of an observer that does not use them: whether motors carry the load, and how far rigid joints give way.

use super::deviations::ObserverView;
use super::gains::JointModel;
use super::joint_error::JointError;
use super::uncertainty::{Columns, Uncertainty};
use crate::dynamics::{Kinematics, Loads};
use crate::estimate::kalman::{Uncertain, shares_of_link};
use crate::linear;
use crate::robot::Robot;

/// Time over which the torques of springs and of loads are compared [s].
const WINDOW: f64 = 0.05;

/// Torques of links by their masses.
///
/// A spring holds its link, so that its torque as the observer has it, which is the motor's less friction and inertia, is that of inverse
/// dynamics. Where the two differ by more than tolerances account for, either a mass is not as robot.yaml says, which the observer does
/// not mind, or the motor's torque is not, and then the link is off by the difference over the stiffness.
#[derive(Clone, Debug)]
pub(super) struct LinkLoad {
    loads: Loads<f64>,
    /// Inverse dynamics (n) and M(q) (n × n).
    torque: Vec<f64>,
    mass: Vec<f64>,
    /// Tolerances of what a joint that is taken as rigid yields [s²], of masses and of link friction (n).
    yielding: Vec<f64>,
    masses: Vec<f64>,
    frictions: Vec<f64>,
    /// Share of a new comparison in the means: of differences [N m], and of the variances that tolerances account for (n).
    share: f64,
    differences: Vec<f64>,
    allowed: Vec<f64>,
    /// Scratch: a link's share of each torque, and variances of accelerations (n).
    shares: Vec<f64>,
    shaken: Vec<f64>,
    /// Variance of each link by what was found (n) [rad²].
    pub(super) variances: Vec<f64>,
}

impl LinkLoad {
    /// Where masses have tolerances; they are compared every `interval` [s].
    pub(super) fn new(robot: &Robot, uncertainty: &Uncertainty, interval: f64) -> Option<Self> {
        let n = robot.len();
        let of = |kind: fn(usize) -> Uncertain| -> Vec<f64> { (0..n).map(|j| uncertainty.of(kind(j))).collect() };
        let (masses, yielding) = (of(Uncertain::Mass), of(Uncertain::Yielding));
        let any = masses.iter().chain(&yielding).any(|std| *std > 0.0);
        let zeros = vec![0.0; n];
        any.then(|| Self {
            loads: Loads::new(&robot.tree),
            mass: vec![0.0; n * n],
            yielding,
            masses,
            frictions: of(Uncertain::LinkFriction),
            share: (interval / WINDOW).min(1.0),
            torque: zeros.clone(),
            differences: zeros.clone(),
            allowed: zeros.clone(),
            shares: zeros.clone(),
            shaken: zeros.clone(),
            variances: zeros,
        })
    }

    /// Compares anew, where `kinematics` has the robot and `joints` what drives their errors; `first`: with nothing before.
    #[inline(always)]
    pub(super) fn compare(
        &mut self,
        look: &ObserverView<'_>,
        kinematics: &Kinematics<f64>,
        (columns, joints): (&Columns, &[JointError]),
        first: bool,
    ) {
        let robot = look.robot;
        let share = if first { 1.0 } else { self.share };
        self.loads.inverse_dynamics_into(&robot.tree, kinematics, &mut self.torque);
        self.loads.mass_matrix_into(&robot.tree, kinematics, &mut self.mass);
        self.weigh(robot, kinematics, columns, joints);
        let n = joints.len();
        for (j, joint) in joints.iter().enumerate() {
            let inertia = self.mass[j * n + j];
            // Links without moments of mass do not say what they load.
            if inertia <= 0.0 {
                continue;
            }
            let drive = &robot.drives[j];
            if look.models[j] == JointModel::Rigid {
                self.variances[j] = (self.yielding[j] * self.torque[j] / inertia).powi(2);
                continue;
            }
            let [theta, q, dtheta, dq, _] = look.state[j];
            let friction = drive.link_friction(look.links[1][j]).0;
            let held = drive.spring_torque(theta - q) + drive.damping * (dtheta - dq);
            let own: f64 = columns.carried(j).map(|column| joint.next[column].powi(2)).sum();
            let allowed = self.shares[j] + own + (friction * self.frictions[j]).powi(2);
            self.differences[j] += share * (held - self.torque[j] - friction - self.differences[j]);
            self.allowed[j] += share * (allowed - self.allowed[j]);
            let more = (self.differences[j].powi(2) - self.allowed[j]).max(0.0);
            self.variances[j] = more / (drive.stiffness * drive.stiffness);
        }
    }

    /// Variances of the links' torques by masses and by accelerations, into `shares`.
    #[inline(always)]
    fn weigh(&mut self, robot: &Robot, kinematics: &Kinematics<f64>, columns: &Columns, joints: &[JointError]) {
        let Self { shares, shaken, masses, mass, .. } = self;
        let n = joints.len();
        for (shaken, joint) in shaken.iter_mut().zip(joints) {
            let by = &joint.next[columns.accelerations.clone()];
            *shaken = linear::dot(by, by) + joint.shaking;
        }
        for (j, variance) in shares.iter_mut().enumerate() {
            let row = &mass[j * n..][..n];
            *variance = row.iter().zip(shaken.iter()).map(|(m, variance)| m * m * variance).sum();
        }
        for (link, std) in masses.iter().enumerate() {
            // In turn for each link: `shaken` has done its work.
            shaken.fill(0.0);
            shares_of_link(kinematics, &robot.tree, link, |j, share| shaken[j] += share);
            for (variance, share) in shares.iter_mut().zip(shaken.iter()) {
                *variance += (share * std).powi(2);
            }
        }
    }
}
