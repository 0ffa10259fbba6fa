//! Where in a state each joint's numbers are.

use crate::robot::{FrictionElement, Robot};

/// Where in the state each joint's numbers are: (q, q̇, θ, θ̇ of the elastic joints, deflections of friction elements,
/// disturbance torques or accelerations of motors, disturbance torques of links, varying wrenches from outside).
#[derive(Clone, Debug)]
pub struct ElasticLayout {
    /// Number of joints.
    pub joints: usize,
    /// θ of each joint; q where the joint is rigid.
    pub theta: Vec<usize>,
    /// θ̇ of each joint; q̇ where the joint is rigid.
    pub dtheta: Vec<usize>,
    /// The first deflection of each joint's friction elements.
    pub deflections: Vec<usize>,
    /// The first disturbance torque of a motor.
    pub disturbance: Option<usize>,
    /// The first acceleration of a motor, where jerk moves motors and not torque: springs, links and friction do not reach
    /// them then, and a rigid joint's link moves as its motor.
    pub motor_acceleration: Option<usize>,
    /// The first disturbance torque of a link.
    pub link_disturbance: Option<usize>,
    /// The first number of a varying wrench.
    pub wrench: Option<usize>,
    /// How fast the links' disturbance torques fade [1/s].
    pub forgetting: f64,
    /// Length of the whole.
    pub dense: usize,
}

impl ElasticLayout {
    /// That of `robot`; with a disturbance torque of every motor if `disturbances`.
    pub fn new(robot: &Robot, disturbances: bool) -> Self {
        let (n, wrenches) = (robot.len(), robot.wrench_states());
        let elastic = robot.drives.iter().filter(|d| d.elastic).count();
        let mut next = 2 * n;
        let mut theta: Vec<_> = (0..n).collect();
        for (j, slot) in theta.iter_mut().enumerate() {
            if robot.drives[j].elastic {
                *slot = next;
                next += 1;
            }
        }
        let dtheta = (0..n).map(|j| if theta[j] < n { n + j } else { theta[j] + elastic }).collect();
        let mut first = 2 * (n + elastic);
        let mut number = |count: usize| {
            first += count;
            first - count
        };
        let deflections = robot.drives.iter().map(|d| number(d.hysteresis.elements.len())).collect();
        let wrench = first + if disturbances { n } else { 0 };
        Self {
            joints: n,
            theta,
            dtheta,
            deflections,
            disturbance: disturbances.then_some(first),
            motor_acceleration: None,
            link_disturbance: None,
            wrench: (wrenches > 0).then_some(wrench),
            forgetting: 0.0,
            dense: wrench + wrenches,
        }
    }

    /// That of `robot` with motors moved by jerk: the acceleration of each is a state, in place of a disturbance torque.
    pub fn moved_by_jerk(robot: &Robot) -> Self {
        let layout = Self::new(robot, true);
        Self { motor_acceleration: layout.disturbance, disturbance: None, ..layout }
    }

    /// The same with a disturbance torque of each link, which forgets over `time` [s].
    pub fn with_link_disturbances(self, time: f64) -> Self {
        let (first, dense) = (self.wrench.unwrap_or(self.dense), self.dense + self.joints);
        let wrench = self.wrench.map(|wrench| wrench + self.joints);
        Self { link_disturbance: Some(first), wrench, forgetting: 1.0 / time, dense, ..self }
    }

    /// Every friction element with its joint and its state.
    #[inline(always)]
    pub(crate) fn elements<'a>(
        &'a self,
        robot: &'a Robot,
    ) -> impl Iterator<Item = (usize, usize, &'a FrictionElement)> {
        let of = |(j, first): (usize, &usize)| {
            let first = *first;
            robot.drives[j].hysteresis.elements.iter().enumerate().map(move |(i, element)| (j, first + i, element))
        };
        self.deflections.iter().enumerate().flat_map(of)
    }

    /// Keeps deflections within their limits, which a step of time or a correction may overshoot.
    #[inline(always)]
    pub(crate) fn confine(&self, robot: &Robot, x: &mut [f64]) {
        for (_, k, element) in self.elements(robot) {
            x[k] = x[k].clamp(-element.reach(), element.reach());
        }
    }

    /// Puts q, q̇, θ and θ̇ (n each) where they belong in `x`; of a rigid joint θ and θ̇ are not looked at.
    pub fn gather<T: Copy>(&self, [q, dq, theta, dtheta]: [&[T]; 4], x: &mut [T]) {
        for j in 0..self.joints {
            (x[self.theta[j]], x[self.dtheta[j]]) = (theta[j], dtheta[j]);
        }
        x[..self.joints].copy_from_slice(q);
        x[self.joints..2 * self.joints].copy_from_slice(dq);
    }
}
