//! What a model knows of its motors: a load behind a spring, or states of their own.

use super::{Loading, Sensing, Wanted};
use crate::dynamics::{ElasticDynamics, ElasticLayout};
use crate::robot::{Drive, Robot, Wound};
use crate::scalar::Scalar;

/// A model in one state, as channels look at it.
pub(crate) trait View<T: Scalar> {
    /// What moves the sensors on links.
    type Links: Sensing<T>;

    /// See [`Links`](Self::Links).
    fn links(&self) -> &Self::Links;

    /// Position and velocity of link `j`.
    fn link(&self, robot: &Robot, j: usize) -> [T; 2];

    /// Position of motor `j`.
    fn motor(&self, robot: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<T>);

    /// Velocity of motor `j`.
    fn motor_velocity(&self, robot: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<T>);

    /// What the transmission of joint `j` gives its link.
    fn joint_torque(&self, robot: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<T>);

    /// Torque of motor `j`; none of a model that does not read it.
    #[inline(always)]
    fn motor_torque(&self, _j: usize, row: usize, wanted: &mut impl Wanted<T>) {
        wanted.value(row, T::constant(f64::NAN));
    }

    /// A number of the varying wrenches from outside.
    fn wrench(&self, number: usize, row: usize, wanted: &mut impl Wanted<T>);
}

/// Springs and dampers between motors and links, by numbers of their own or by those of the robot's drives.
pub(crate) trait Springs<T> {
    /// Torsion of joint `j` that holds `torque`, and one over the spring's slope there.
    fn twist(&self, drive: &Drive, j: usize, torque: T) -> (T, T);

    /// D of joint `j`.
    fn damping(&self, drive: &Drive, j: usize) -> T;
}

/// As the robot says, friction elements being as they were left (n, or none where no joint has them).
pub(crate) struct OfDrives<'a>(pub(crate) &'a [Wound]);

impl<T: Scalar> Springs<T> for OfDrives<'_> {
    #[inline(always)]
    fn twist(&self, drive: &Drive, j: usize, torque: T) -> (T, T) {
        if let Some(wound) = self.0.get(j).filter(|_| !drive.hysteresis.is_none()) {
            return wound.twist(drive, torque);
        }
        let torsion = drive.torsion(torque);
        (torsion, drive.compliance(torsion))
    }

    #[inline(always)]
    fn damping(&self, drive: &Drive, _: usize) -> T {
        T::constant(drive.damping)
    }
}

/// Where a motor stands while its spring and damper give the link a torque r.
pub(crate) struct MotorStand<T> {
    /// θ [rad].
    pub(crate) theta: T,
    /// δ [rad], and how fast it is taken to change [rad/s].
    pub(crate) torsion: T,
    pub(crate) slip: T,
    /// ∂θ/∂r, 1/φ′ where the gear is true.
    pub(crate) by_torque: T,
    /// ∂θ/∂q, 1 where the gear is true.
    pub(crate) by_link: T,
    /// D, or 0 where the motor's velocity is not known.
    pub(crate) damping: T,
}

impl<T: Scalar> MotorStand<T> {
    /// Of elastic joint `j` with its link at (q, q̇) = `link`, of which `torque` is asked; `dtheta` is the motor's velocity
    /// for the damping torque, NaN to leave it out.
    #[inline(always)]
    pub(crate) fn new<S: Springs<T>>(
        springs: &S,
        drive: &Drive,
        j: usize,
        link: [T; 2],
        torque: T,
        dtheta: f64,
    ) -> Self {
        let [q, dq] = link;
        let (damping, slip) =
            if dtheta.is_nan() { (T::default(), T::default()) } else { (springs.damping(drive, j), -dq + dtheta) };
        let (torsion, compliance) = springs.twist(drive, j, torque - slip * damping);
        let (theta, one) = (q + torsion, T::constant(1.0));
        let stand = Self { theta, torsion, slip, by_torque: compliance, by_link: one, damping };
        if drive.ripple.is_none() { stand } else { stand.behind(springs, drive, j, link, torque, dtheta) }
    }

    /// The same with the gear's error between motor and spring: of θ + ε(θ) = q + φ⁻¹(r − D((1 + ε′) θ̇ − q̇)) by Newton's
    /// method, ε′ there changing with θ, too.
    #[inline(always)]
    fn behind<S: Springs<T>>(
        self,
        springs: &S,
        drive: &Drive,
        j: usize,
        [q, dq]: [T; 2],
        torque: T,
        dtheta: f64,
    ) -> Self {
        let (damping, speed) = (self.damping, if dtheta.is_nan() { 0.0 } else { dtheta });
        let at = |theta: T| {
            let gear = drive.ripple.output(theta);
            let slip = if dtheta.is_nan() { T::default() } else { gear.ratio * speed - dq };
            let (torsion, compliance) = springs.twist(drive, j, torque - slip * damping);
            let by_link = T::constant(1.0) / (gear.ratio + compliance * damping * gear.bend * speed);
            let lacks = q + torsion - gear.angle;
            (lacks, Self { theta, torsion, slip, by_torque: compliance * by_link, by_link, damping })
        };
        let mut theta = drive.ripple.motor(self.theta);
        // From where ε′ is taken for none in the damper's speed it is a thousandth of its effect away; digits double.
        for _ in 0..2 {
            let (lacks, stand) = at(theta);
            theta += lacks * stand.by_link;
        }
        at(theta).1
    }
}

/// Links moved by jerk: a motor stands where the torque that its link needs twists the spring to
/// (Axelsson, Karlsson and Norrlöf 2012, eqs. (12)–(17)).
pub(crate) struct Driven<'a, T, L, S> {
    /// Motion and loads at the state.
    pub(crate) links: &'a L,
    /// (q, q̇, q̈), and what follows them.
    pub(crate) state: &'a [T],
    /// Where wrenches from outside begin in it.
    pub(crate) wrench: usize,
    /// Motor velocities for the damping torque (n), NaN to leave it out.
    pub(crate) dtheta: &'a [f64],
    /// How springs twist: as the robot's drives do, or as parameters under calibration say.
    pub(crate) springs: &'a S,
}

impl<T: Scalar, L: Sensing<T> + Loading<T>, S: Springs<T>> View<T> for Driven<'_, T, L, S> {
    type Links = L;

    #[inline(always)]
    fn links(&self) -> &L {
        self.links
    }

    #[inline(always)]
    fn link(&self, robot: &Robot, j: usize) -> [T; 2] {
        [self.state[j], self.state[robot.len() + j]]
    }

    /// θ + ε(θ) = q + φ⁻¹(M q̈ + C q̇ + g + friction − D δ̇), with the damping that the paper drops.
    #[inline(always)]
    fn motor(&self, robot: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let (link @ [q, dq], drive) = (self.link(robot, j), &robot.drives[j]);
        if !drive.elastic {
            wanted.value(row, q);
            wanted.add(row, j, [T::constant(1.0), T::default()]);
            return;
        }
        let load = self.links.load(j);
        let friction = drive.link_friction_beside(dq, load);
        let motor = MotorStand::new(self.springs, drive, j, link, load + friction.torque, self.dtheta[j]);
        wanted.value(row, motor.theta);
        // ∂θ/∂x = ∂θ/∂q ∂q/∂x + ∂θ/∂r ∂r/∂x, r the torque on the spring; friction and damping add theirs to ∂r/∂q̇.
        let by_load = motor.by_torque * (friction.by_load + 1.0);
        self.links.load_columns(j, by_load, row, wanted);
        wanted.add(row, j, [motor.by_link, motor.by_torque * (friction.by_speed + motor.damping)]);
        wanted.torque(row, j, by_load);
    }

    /// The rate of the motor's position, which numbers that carry a derivative along time have: not a row of its own.
    #[inline(always)]
    fn motor_velocity(&self, _: &Robot, _: usize, row: usize, wanted: &mut impl Wanted<T>) {
        wanted.value(row, T::default());
    }

    #[inline(always)]
    fn joint_torque(&self, robot: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<T>) {
        let load = self.links.load(j);
        let friction = robot.drives[j].link_friction_beside(self.link(robot, j)[1], load);
        let by_load = friction.by_load + 1.0;
        wanted.value(row, load + friction.torque);
        self.links.load_columns(j, by_load, row, wanted);
        wanted.add(row, j, [T::default(), friction.by_speed]);
        wanted.torque(row, j, by_load);
    }

    #[inline(always)]
    fn wrench(&self, number: usize, row: usize, wanted: &mut impl Wanted<T>) {
        wanted.value(row, self.state[self.wrench + number]);
        wanted.entry(row, self.wrench + number, T::constant(1.0));
    }
}

/// Links and motors moved by motor torques (Ulrich and Sasiadek 2011): motors are states, accelerations functions of them.
pub(crate) struct Elastic<'a> {
    /// Where in the state each joint's numbers are.
    pub(crate) layout: &'a ElasticLayout,
    /// After `accelerate` at the state; its kinematics set with the accelerations.
    pub(crate) dynamics: &'a ElasticDynamics,
    /// (q, q̇, θ, θ̇, disturbance torques, wrenches).
    pub(crate) state: &'a [f64],
}

impl Elastic<'_> {
    /// A channel that reads one entry of the state.
    #[inline(always)]
    fn entry(&self, index: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        wanted.value(row, self.state[index]);
        wanted.entry(row, index, 1.0);
    }
}

impl View<f64> for Elastic<'_> {
    type Links = crate::dynamics::Kinematics<f64>;

    #[inline(always)]
    fn links(&self) -> &Self::Links {
        &self.dynamics.kinematics
    }

    #[inline(always)]
    fn link(&self, robot: &Robot, j: usize) -> [f64; 2] {
        [self.state[j], self.state[robot.len() + j]]
    }

    #[inline(always)]
    fn motor(&self, _: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        self.entry(self.layout.theta[j], row, wanted);
    }

    #[inline(always)]
    fn motor_velocity(&self, _: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        self.entry(self.layout.dtheta[j], row, wanted);
    }

    #[inline(always)]
    fn wrench(&self, number: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        self.entry(self.layout.wrench.unwrap_or(0) + number, row, wanted);
    }

    #[inline(always)]
    fn motor_torque(&self, j: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        wanted.value(row, self.dynamics.motor_torques().get(j).copied().unwrap_or(f64::NAN));
        let by = self.dynamics.motor_torques_by().chunks_exact(self.layout.dense).nth(j);
        by.into_iter().flatten().enumerate().for_each(|(k, &by)| wanted.entry(row, k, by));
    }

    /// τ_e, or behind a rigid drive what the motor has left for its link.
    #[inline(always)]
    fn joint_torque(&self, robot: &Robot, j: usize, row: usize, wanted: &mut impl Wanted<f64>) {
        let (drive, n, x, layout) = (&robot.drives[j], robot.len(), self.state, self.layout);
        wanted.value(row, self.dynamics.joint_torque(robot, j));
        if drive.elastic {
            let slopes = drive.transmission_slopes(x[layout.theta[j]], x[layout.dtheta[j]], x[j]);
            wanted.add(row, j, [slopes.by_q, slopes.by_dq]);
            wanted.entry(row, layout.theta[j], slopes.by_theta);
            wanted.entry(row, layout.dtheta[j], slopes.by_dtheta);
            for (i, element) in drive.hysteresis.elements.iter().enumerate() {
                wanted.entry(row, layout.deflections[j] + i, element.stiffness);
            }
            return;
        }
        if let Some(by) = self.dynamics.rigid_torque_by(j) {
            by.iter().enumerate().for_each(|(k, &by)| wanted.entry(row, k, by));
            return;
        }
        wanted.add(row, j, [0.0, -drive.motor_friction(x[n + j]).1]);
        if let Some(first) = layout.disturbance {
            wanted.entry(row, first + j, 1.0);
        }
        for (i, coupling) in self.dynamics.coupling(j) {
            // τ_J = τ − f − B q̈ − (Sᵀ q̈)ⱼ, S perhaps a function of the posture.
            let [by_q, by_dq] = self.dynamics.joint_torque_by(robot, j, i);
            wanted.columns(row, i, [by_q, by_dq, -coupling]);
        }
        wanted.columns(row, j, [0.0, 0.0, -drive.motor_inertia]);
    }
}
