//! How accelerations change with the state, with motor torques and with further torques.

//!
//! With r(x, τ, q̈, θ̈) = 0 for both rows of the model, ∂q̈/∂x = −(∂r/∂q̈)⁻¹ ∂r/∂x once θ̈ is eliminated: the matrix is
//! the one that gave the accelerations, and its factors are still there. What depends on the posture inside M, C, g and
//! S is differentiated in one call of the inverse dynamics' derivatives at the accelerations (Singh, Russell and
//! Wensing 2022); springs, dampers and frictions add a few entries each.
use super::elements::element_row;
use super::{ElasticDynamics, ElasticLayout};
use crate::linear;
use crate::robot::Robot;
use crate::scalar::Scalar;
use crate::simd::{self, Kernel};

impl<T: Scalar> ElasticDynamics<T> {
    /// Derivatives of the accelerations, after [`accelerate`](Self::accelerate) at the same state.
    pub fn differentiate(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T]) {
        simd::phase(Differentiate { dynamics: self, robot, layout, x });
    }

    /// ∂(right-hand side − left-hand side)/∂x with accelerations held, solved with the factors that `accelerate` left.
    #[inline(always)]
    fn differentiate_here(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T]) {
        let (n, d) = (layout.joints, layout.dense);
        self.differentiate_loads(robot, layout, x);
        for j in 0..n {
            self.differentiate_motor(robot, layout, x, j);
        }
        self.differentiate_shared_friction(robot, layout, x);
        for (row, of) in self.elements.iter_mut().zip(layout.elements(robot)) {
            *row = element_row(robot, layout, x, of).1;
        }
        if layout.motor_acceleration.is_some() {
            return self.differentiate_prescribed(robot, layout);
        }
        let system = n * n;
        // All columns at once.
        linear::solve(&self.mass[..system], n, &mut self.ddq_by, d);
        linear::solve(&self.mass[..system], n, &mut self.ddq_by_tau, n);
        for (j, drive) in robot.drives.iter().enumerate() {
            let own = &mut self.ddtheta_by[j * d..][..d];
            if !drive.elastic {
                own.copy_from_slice(&self.ddq_by[j * d..][..d]);
                continue;
            }
            self.coupling.subtract_pull(j, &self.ddq_by, own);
            let inertia = T::constant(drive.motor_inertia);
            for value in own {
                *value = *value / inertia;
            }
        }
        if let Some(gearing) = &robot.gearing {
            (0..d).for_each(|k| gearing.share(&mut self.ddtheta_by, |j| j * d + k));
        }
    }

    /// Minus the slopes of the friction of motors that several joints share.
    #[inline(always)]
    fn differentiate_shared_friction(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T]) {
        let Some(gearing) = &robot.gearing else { return };
        for motor in gearing.motors() {
            let slope = robot.drives[motor.drive].motor_friction(motor.speed(|j| x[layout.dtheta[j]])).1;
            for (a, by_a) in motor.joints() {
                for (b, by_b) in motor.joints() {
                    self.ddtheta_by[a * layout.dense + layout.dtheta[b]] -= slope * (by_a * by_b);
                }
            }
        }
    }

    /// Minus the derivatives of M q̈ + S θ̈ + C q̇ + g and of the links' friction, on links and on rotors' motors.
    #[inline(always)]
    fn differentiate_loads(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T]) {
        let (n, d) = (layout.joints, layout.dense);
        let Self { kinematics, loads, by_q, by_dq, ignored, moved, coupling, ddq, ddtheta, ddq_by, .. } = self;
        let (mut tree, mut q, mut dq, mut acceleration) = (&robot.tree, &x[..n], &x[n..2 * n], &ddq[..]);
        if let Some(rotors) = &mut coupling.rotors {
            rotors.acceleration[..n].copy_from_slice(ddq);
            for (acceleration, rotor) in rotors.acceleration[n..].iter_mut().zip(&robot.rotors) {
                *acceleration = ddtheta[rotor.motor] * rotor.ratio;
            }
            (tree, q, dq, acceleration) = (&rotors.tree, &rotors.position, &rotors.velocity, &rotors.acceleration);
        }
        // M and S depend on q: at the accelerations just found their derivatives are inside those of the inverse
        // dynamics.
        if let Some(first) = layout.wrench {
            kinematics.apply_wrenches(tree, &x[first..]);
        }
        kinematics.set(tree, q, dq, acceleration);
        loads.inverse_dynamics_derivatives_into(tree, kinematics, moved, by_q, by_dq, ignored);
        let bodies = tree.len();
        self.ddtheta_by.fill(T::default());
        self.ddq_by_tau.fill(T::default());
        for (i, row) in ddq_by.chunks_exact_mut(d).enumerate() {
            row.fill(T::default());
            for k in 0..n {
                row[k] = -by_q[i * bodies + k];
                row[n + k] = -by_dq[i * bodies + k];
            }
            row[n + i] -= robot.drives[i].link_friction(x[n + i]).1;
            if let Some(first) = layout.link_disturbance {
                row[first + i] = T::constant(1.0);
            }
            for (k, rotor) in (n..).zip(&robot.rotors) {
                row[layout.dtheta[rotor.motor]] -= by_dq[i * bodies + k] * rotor.ratio;
            }
        }
        if let Some(first) = layout.wrench {
            kinematics.wrench_map(&robot.tree, |number, joint, by| ddq_by[joint * d + first + number] += by);
        }
        for (k, rotor) in robot.rotors.iter().enumerate() {
            self.differentiate_rotor(robot, layout, k, rotor.motor);
        }
    }

    /// Minus the derivatives of what motor `j`, rotor `k`, takes, in its own row, which is eliminated or joins its link's.
    #[inline(always)]
    fn differentiate_rotor(&mut self, robot: &Robot, layout: &ElasticLayout, k: usize, j: usize) {
        let (n, d, drive) = (layout.joints, layout.dense, &robot.drives[j]);
        let Self { by_q, by_dq, coupling, ddq_by, ddtheta_by, .. } = self;
        let (bodies, ratio) = (n + robot.rotors.len(), robot.rotors[k].ratio);
        let row = (n + k) * bodies..(n + k) * bodies + n;
        let by = || by_q[row.clone()].iter().zip(&by_dq[row.clone()]).map(|(q, dq)| (*q * ratio, *dq * ratio));
        let subtract = |out: &mut [T], share: T| {
            for (i, (q, dq)) in by().enumerate() {
                out[i] -= share * q;
                out[n + i] -= share * dq;
            }
        };
        let one = T::constant(1.0);
        if !drive.elastic && layout.motor_acceleration.is_none() {
            return subtract(&mut ddq_by[j * d..][..d], one);
        }
        subtract(&mut ddtheta_by[j * d..][..d], one);
        if layout.motor_acceleration.is_some() {
            return;
        }
        for (i, s) in coupling.coupled(j) {
            subtract(&mut ddq_by[i * d..][..d], -(s / T::constant(drive.motor_inertia)));
        }
    }

    /// What motor j's spring, friction, torque and disturbance do to the torques on links and on itself.
    #[inline(always)]
    fn differentiate_motor(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T], j: usize) {
        let (n, d, drive) = (layout.joints, layout.dense, &robot.drives[j]);
        let (theta, dtheta, one) = (layout.theta[j], layout.dtheta[j], T::constant(1.0));
        let shared = robot.gearing.as_ref().is_some_and(|gearing| gearing.has(j));
        let mut slip = if shared { T::default() } else { drive.motor_friction(x[dtheta]).1 };
        let disturbance = layout.disturbance.map(|first| first + j);
        let Self { coupling, ddq_by, ddq_by_tau, ddtheta_by, ratio, felt, left, spring, .. } = self;
        if !drive.elastic && layout.motor_acceleration.is_some() {
            ddtheta_by[j * d + dtheta] -= slip;
            return;
        }
        if !drive.elastic {
            ddq_by[j * d + dtheta] -= slip;
            ddq_by_tau[j * n + j] = one;
            if let Some(k) = disturbance {
                ddq_by[j * d + k] = one;
            }
            return;
        }
        let slopes = drive.transmission_slopes(x[theta], x[dtheta], x[j]);
        let link = [(theta, slopes.by_theta), (j, slopes.by_q), (dtheta, slopes.by_dtheta), (n + j, slopes.by_dq)];
        // The motor feels (1 + ε′) τ_e, with an ε′ that turns with it.
        let mut motor = link.map(|(k, slope)| (k, slope * felt[j]));
        let mut bend = drive.ripple.output(x[theta]).bend * spring[j];
        if !drive.gear_loss.is_none() {
            let loss = drive.gear_loss.loss(x[dtheta], ratio[j] * spring[j]);
            slip += loss.by_speed;
            bend += bend * loss.by_load;
        }
        motor[0].1 += bend;
        // What a motor feels does not reach links where its acceleration is a state.
        let reach = if layout.motor_acceleration.is_some() { 0 } else { n };
        for (i, s) in coupling.coupled(j).take(reach) {
            let share = s / T::constant(drive.motor_inertia);
            for (k, slope) in motor {
                ddq_by[i * d + k] += share * slope;
            }
            ddq_by[i * d + dtheta] += share * slip;
            ddq_by_tau[i * n + j] = -share;
            if let Some(k) = disturbance {
                ddq_by[i * d + k] = -share;
            }
        }
        let own = &mut ddtheta_by[j * d..][..d];
        if !drive.bearing_loss.is_none() {
            ddq_by[j * d + n + j] -= drive.bearing_loss.loss(x[n + j], spring[j]).by_speed;
        }
        for ((k, slope), (_, reaction)) in link.into_iter().zip(motor) {
            ddq_by[j * d + k] += slope * left[j];
            own[k] -= reaction;
        }
        own[dtheta] -= slip;
        if let Some(k) = disturbance {
            own[k] = one;
        }
        for (i, element) in drive.hysteresis.elements.iter().enumerate() {
            let (k, felt) = (layout.deflections[j] + i, felt[j] * element.stiffness);
            ddq_by[j * d + k] = left[j] * element.stiffness;
            own[k] = -felt;
            for (i, s) in coupling.coupled(j).take(reach) {
                ddq_by[i * d + k] += s / T::constant(drive.motor_inertia) * felt;
            }
        }
    }

    /// What the transmission of joint `j`, rigid, gives its link, by positions and velocities of link `i`, where
    /// accelerations stay; after [`differentiate`](Self::differentiate). Zero but behind a rotor.
    #[inline(always)]
    pub(crate) fn joint_torque_by(&self, robot: &Robot, j: usize, i: usize) -> [T; 2] {
        let bodies = robot.len() + robot.rotors.len();
        let Some(k) = robot.rotors.iter().position(|rotor| rotor.motor == j) else {
            return [T::default(); 2];
        };
        let at = (robot.len() + k) * bodies + i;
        [self.by_q[at], self.by_dq[at]].map(|slope| -(slope * robot.rotors[k].ratio))
    }

    /// ∂ẋ/∂τ_j, or by the jerk of a motor that jerk moves, into `rate` (dense), whose other entries stay; after [`differentiate`](Self::differentiate).
    #[inline(always)]
    pub(crate) fn rate_by_torque_into(&self, robot: &Robot, layout: &ElasticLayout, j: usize, rate: &mut [T]) {
        let n = layout.joints;
        if let Some(first) = layout.motor_acceleration {
            rate[first + j] = T::constant(1.0);
            return;
        }
        for i in 0..n {
            rate[n + i] = self.ddq_by_tau[i * n + j];
        }
        for (i, drive) in robot.drives.iter().enumerate().filter(|(_, drive)| drive.elastic) {
            let pull = self.coupling.links(i).fold(T::default(), |sum, (k, s)| sum + s * self.ddq_by_tau[k * n + j]);
            let own = T::constant(f64::from(i == j));
            rate[layout.dtheta[i]] = (own - pull) / T::constant(drive.motor_inertia);
        }
        if let Some(gearing) = &robot.gearing {
            gearing.share(rate, |i| layout.dtheta[i]);
        }
    }

    /// Accelerations by further torques on links and motors and in transmissions, in place of them (n × `width` each),
    /// after [`accelerate`](Self::accelerate); of a rigid joint what its transmission gives the link. Where motors' accelerations
    /// are states, what motors need more is in place of their accelerations.
    #[inline(always)]
    pub(crate) fn respond(
        &self,
        robot: &Robot,
        links: &mut [T],
        motors: &mut [T],
        transmitted: &mut [T],
        width: usize,
    ) {
        let (n, one) = (robot.len(), T::constant(1.0));
        let row = |j: usize| j * width..(j + 1) * width;
        for (j, drive) in robot.drives.iter().enumerate() {
            if drive.elastic {
                linear::add_scaled(&mut links[row(j)], self.left[j], &transmitted[row(j)]);
                linear::add_scaled(&mut motors[row(j)], -self.felt[j], &transmitted[row(j)]);
                if self.prescribed.is_some() {
                    continue;
                }
                for (i, s) in self.coupling.coupled(j) {
                    let share = s / T::constant(drive.motor_inertia);
                    linear::add_scaled(&mut links[row(i)], -share, &motors[row(j)]);
                }
            } else if self.prescribed.is_none() {
                linear::add_scaled(&mut links[row(j)], one, &motors[row(j)]);
                transmitted[row(j)].copy_from_slice(&motors[row(j)]);
            }
        }
        if self.prescribed.is_some() {
            return self.respond_prescribed(robot, [links, motors, transmitted], width);
        }
        linear::solve(&self.mass[..n * n], n, links, width);
        for (j, drive) in robot.drives.iter().enumerate() {
            let own = if drive.elastic { &mut motors[row(j)] } else { &mut transmitted[row(j)] };
            let inertia = T::constant(drive.motor_inertia);
            self.coupling.subtract_pull(j, links, own);
            if drive.elastic {
                own.iter_mut().for_each(|x| *x = *x / inertia);
            } else {
                linear::add_scaled(own, -inertia, &links[row(j)]);
            }
        }
        if let Some(gearing) = &robot.gearing {
            (0..width).for_each(|k| gearing.share(motors, |j| j * width + k));
        }
    }

    /// ẋ = A x near `x` under `tau`: A, row-major dense × dense. Allocates.
    pub fn linearise(&mut self, robot: &Robot, layout: &ElasticLayout, x: &[T], tau: &[T]) -> Vec<T> {
        let (n, d) = (layout.joints, layout.dense);
        self.accelerate(robot, layout, x, tau);
        self.differentiate(robot, layout, x);
        let mut a = vec![T::default(); d * d];
        for j in 0..n {
            a[layout.theta[j] * d + layout.dtheta[j]] = T::constant(1.0);
            a[layout.dtheta[j] * d..][..d].copy_from_slice(&self.ddtheta_by[j * d..][..d]);
            a[j * d + n + j] = T::constant(1.0);
            a[(n + j) * d..][..d].copy_from_slice(&self.ddq_by[j * d..][..d]);
            if let Some(first) = layout.link_disturbance {
                a[(first + j) * (d + 1)] = T::constant(-layout.forgetting);
            }
        }
        for row in &self.elements {
            for (k, by) in row.entries {
                a[row.state * d + k] += by;
            }
        }
        a
    }
}

/// [`ElasticDynamics::differentiate`], likewise.
struct Differentiate<'a, T> {
    dynamics: &'a mut ElasticDynamics<T>,
    robot: &'a Robot,
    layout: &'a ElasticLayout,
    x: &'a [T],
}

impl<T: Scalar> Kernel for Differentiate<'_, T> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        self.dynamics.differentiate_here(self.robot, self.layout, self.x);
    }
}
