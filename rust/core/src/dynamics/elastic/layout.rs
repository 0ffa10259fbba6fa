//! Where in a state each joint's numbers are.

use crate::robot::Robot;

/// Where in the state each joint's numbers are: (q, q̇, θ, θ̇ of the elastic joints, disturbance torques of motors, of links).
#[derive(Clone, Debug)]
pub struct ElasticLayout {
    /// Number of joints.
    pub joints: usize,
    /// θ of each joint; q where the joint is rigid.
    pub theta: Vec<usize>,
    /// θ̇ of each joint; q̇ where the joint is rigid.
    pub dtheta: Vec<usize>,
    /// The first disturbance torque of a motor.
    pub disturbance: Option<usize>,
    /// The first disturbance torque of a link.
    pub link_disturbance: Option<usize>,
    /// How fast the links' disturbance torques fade [1/s].
    pub forgetting: f64,
    /// Length of the whole.
    pub dense: usize,
}

impl ElasticLayout {
    /// That of `robot`; with a disturbance torque of every motor if `disturbances`.
    pub fn new(robot: &Robot, disturbances: bool) -> Self {
        let n = robot.len();
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
        let first = 2 * (n + elastic);
        Self {
            joints: n,
            theta,
            dtheta,
            disturbance: disturbances.then_some(first),
            link_disturbance: None,
            forgetting: 0.0,
            dense: first + if disturbances { n } else { 0 },
        }
    }

    /// The same with a disturbance torque of each link, which forgets over `time` [s].
    pub fn with_link_disturbances(self, time: f64) -> Self {
        let dense = self.dense + self.joints;
        Self { link_disturbance: Some(self.dense), forgetting: 1.0 / time, dense, ..self }
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
