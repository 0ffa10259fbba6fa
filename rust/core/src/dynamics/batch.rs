//! Whole arrays at once: one row a sample, `count` rows, row-major.

use super::{ElasticDynamics, ElasticLayout, Kinematics, Loads, NewtonEuler};
use crate::interrupt::Watch;
use crate::robot::{Drive, Robot, Sensor};
use crate::spatial::Vec3;

/// Dynamics and sensor models of a robot over many samples; each output row is that sample's, flattened row-major.
#[derive(Debug)]
pub struct Batch<'a> {
    robot: &'a Robot,
    /// For what needs derivatives or matrices…
    kinematics: Kinematics<f64>,
    loads: Loads<f64>,
    /// …and for torques alone.
    newton_euler: NewtonEuler<f64>,
}

/// A state of the links, one row a sample, n columns.
#[derive(Clone, Copy, Debug)]
pub struct States<'a> {
    /// q.
    pub q: &'a [f64],
    /// q̇.
    pub dq: &'a [f64],
    /// q̈.
    pub ddq: &'a [f64],
}

/// A state of links and motors with the motors' torque, one row a sample, n columns.
#[derive(Clone, Copy, Debug)]
pub struct DrivenStates<'a> {
    /// q.
    pub q: &'a [f64],
    /// q̇.
    pub dq: &'a [f64],
    /// θ.
    pub theta: &'a [f64],
    /// θ̇.
    pub dtheta: &'a [f64],
    /// τ.
    pub tau: &'a [f64],
}

impl<'a> Batch<'a> {
    /// Scratch for `robot`.
    pub fn new(robot: &'a Robot) -> Self {
        let tree = &robot.tree;
        Self { robot, kinematics: Kinematics::new(tree), loads: Loads::new(tree), newton_euler: NewtonEuler::new(tree) }
    }

    /// Calls `f` with every sample's state and its slice of `out`; `width` entries a sample. Velocities and accelerations
    /// of a single sample are those of all.
    fn rows(
        &mut self,
        s: States<'_>,
        out: &mut [f64],
        width: usize,
        mut f: impl FnMut(&mut Self, [&[f64]; 3], &mut [f64]),
    ) {
        let n = self.robot.len();
        let rates = s.dq.chunks_exact(n).cycle().zip(s.ddq.chunks_exact(n).cycle());
        let rows = s.q.chunks_exact(n).zip(rates);
        let watch = Watch::current();
        for ((q, (dq, ddq)), out) in rows.zip(out.chunks_exact_mut(width.max(1))).take_while(|_| !watch.stops()) {
            f(self, [q, dq, ddq], out);
        }
    }

    /// As [`rows`](Self::rows), with the sample's kinematics set.
    fn each(&mut self, s: States<'_>, out: &mut [f64], width: usize, mut f: impl FnMut(&mut Self, &mut [f64])) {
        self.rows(s, out, width, |b, [q, dq, ddq], out| {
            b.kinematics.set(&b.robot.tree, q, dq, ddq);
            f(b, out);
        });
    }

    /// As [`rows`](Self::rows), with the sample's loads and readings alone set.
    fn each_motion(&mut self, s: States<'_>, out: &mut [f64], width: usize, mut f: impl FnMut(&mut Self, &mut [f64])) {
        self.rows(s, out, width, |b, [q, dq, ddq], out| {
            b.newton_euler.set(&b.robot.tree, q, dq, ddq);
            f(b, out);
        });
    }

    /// As [`each`](Self::each), at rest.
    fn each_position(&mut self, q: &[f64], out: &mut [f64], width: usize, f: impl FnMut(&mut Self, &mut [f64])) {
        let zero = vec![0.0; self.robot.len()];
        self.each(States { q, dq: &zero, ddq: &zero }, out, width, f);
    }

    /// τ: n a sample.
    pub fn inverse_dynamics(&mut self, s: States<'_>, out: &mut [f64]) {
        self.each_motion(s, out, self.robot.len(), |b, tau| b.newton_euler.inverse_dynamics_into(&b.robot.tree, tau));
    }

    /// q̈ and θ̈ one after the other: 2 n a sample.
    pub fn forward_dynamics(&mut self, s: DrivenStates<'_>, out: &mut [f64]) {
        let n = self.robot.len();
        let layout = ElasticLayout::new(self.robot, false);
        let (mut dynamics, mut x) = (ElasticDynamics::new(self.robot, &layout), vec![0.0; layout.dense]);
        let watch = Watch::current();
        let mut rows = [s.q, s.dq, s.theta, s.dtheta, s.tau].map(|signal| signal.chunks_exact(n));
        for out in out.chunks_exact_mut(2 * n).take_while(|_| !watch.stops()) {
            let [Some(q), Some(dq), Some(theta), Some(dtheta), Some(tau)] = rows.each_mut().map(Iterator::next) else {
                return;
            };
            layout.gather([q, dq, theta, dtheta], &mut x);
            dynamics.accelerate(self.robot, &layout, &x, tau);
            out[..n].copy_from_slice(&dynamics.ddq);
            out[n..].copy_from_slice(&dynamics.ddtheta);
        }
    }

    /// Friction of the links at velocities `dq`, where their motion takes the torques `load` without it: n a sample.
    pub fn link_friction(&mut self, dq: &[f64], load: &[f64], out: &mut [f64]) {
        self.each_drive(dq, load, out, |drive, v, load| drive.link_friction_beside(v, load).torque);
    }

    /// Friction of the motors at velocities `dtheta`, which feel the torques `load` of their gears: n a sample.
    pub fn motor_friction(&mut self, dtheta: &[f64], load: &[f64], out: &mut [f64]) {
        self.each_drive(dtheta, load, out, |drive, v, load| {
            drive.motor_friction(v).0 + drive.gear_loss.loss(v, load).torque
        });
    }

    /// `law` of each joint's drive, sample by sample.
    fn each_drive(&self, velocities: &[f64], load: &[f64], out: &mut [f64], law: impl Fn(&Drive, f64, f64) -> f64) {
        let drives = self.robot.drives.iter().cycle();
        for (((out, &v), &load), drive) in out.iter_mut().zip(velocities).zip(load).zip(drives) {
            *out = law(drive, v, load);
        }
    }

    /// g(q): n a sample.
    pub fn gravity_torque(&mut self, q: &[f64], out: &mut [f64]) {
        let zero = vec![0.0; self.robot.len()];
        self.inverse_dynamics(States { q, dq: &zero, ddq: &zero }, out);
    }

    /// What each number of the varying wrenches adds to each joint's torque, Jᵀ: n × numbers a sample.
    pub fn wrench_map(&mut self, q: &[f64], out: &mut [f64]) {
        let (n, numbers) = (self.robot.len(), self.robot.wrench_states());
        self.each_position(q, out, n * numbers, |b, out| {
            out.fill(0.0);
            b.kinematics.wrench_map(&b.robot.tree, |number, joint, by| out[joint * numbers + number] += by);
        });
    }

    /// M(q): n × n a sample.
    pub fn mass_matrix(&mut self, q: &[f64], out: &mut [f64]) {
        self.each_position(q, out, self.robot.len().pow(2), |b, mass| {
            b.loads.mass_matrix_into(&b.robot.tree, &b.kinematics, mass);
        });
    }

    /// C(q, q̇): n × n a sample.
    pub fn coriolis_matrix(&mut self, s: States<'_>, out: &mut [f64]) {
        self.each(s, out, self.robot.len().pow(2), |b, c| {
            b.loads.coriolis_matrix_into(&b.robot.tree, &b.kinematics, c);
        });
    }

    /// ∂τ/∂q, ∂τ/∂q̇ and M one after the other: 3 n × n a sample.
    pub fn inverse_dynamics_derivatives(&mut self, s: States<'_>, out: &mut [f64]) {
        let size = self.robot.len().pow(2);
        let mut tau = vec![0.0; self.robot.len()];
        self.each(s, out, 3 * size, |b, out| {
            let (by_q, rest) = out.split_at_mut(size);
            let (by_dq, mass) = rest.split_at_mut(size);
            let (tree, k) = (&b.robot.tree, &b.kinematics);
            b.loads.inverse_dynamics_derivatives_into(tree, k, &mut tau, by_q, by_dq, mass);
        });
    }

    /// Specific force at every recorded accelerometer axis.
    pub fn specific_force(&mut self, s: States<'_>, out: &mut [f64]) {
        self.each_motion(s, out, self.robot.acceleration_channels(), |b, out| {
            read(&b.robot.accelerometers, out, |sensor| b.newton_euler.specific_force(&sensor.frame));
        });
    }

    /// Its derivatives in q, q̇ and q̈ one after the other: 3 channels × n a sample.
    pub fn specific_force_derivatives(&mut self, s: States<'_>, out: &mut [f64]) {
        let (n, channels) = (self.robot.len(), self.robot.acceleration_channels());
        self.each(s, out, 3 * channels * n, |b, out| {
            out.fill(0.0);
            let mut row = 0;
            for sensor in &b.robot.accelerometers {
                b.kinematics.specific_force_derivatives(&b.robot.tree, &sensor.frame, |joint, columns| {
                    for (which, column) in columns.iter().enumerate() {
                        for (r, &axis) in sensor.axes.iter().enumerate() {
                            out[(which * channels + row + r) * n + joint] += column.0[axis];
                        }
                    }
                });
                row += sensor.axes.len();
            }
        });
    }

    /// Angular rate at every recorded gyroscope axis.
    pub fn angular_rate(&mut self, s: States<'_>, out: &mut [f64]) {
        self.each_motion(s, out, self.robot.gyroscope_channels(), |b, out| {
            read(&b.robot.gyroscopes, out, |sensor| b.newton_euler.angular_rate(&sensor.frame));
        });
    }

    /// The tool centre point, 3 a sample; nothing is written when the robot has none.
    pub fn tool_position(&mut self, q: &[f64], out: &mut [f64]) {
        let Some(tool) = &self.robot.tool else { return };
        self.each_position(q, out, 3, |b, out| out.copy_from_slice(&b.kinematics.position(tool).0));
    }
}

/// The recorded axes of `sensors`, one after the other.
fn read(sensors: &[Sensor], out: &mut [f64], sense: impl Fn(&Sensor) -> Vec3<f64>) {
    let mut from = 0;
    for sensor in sensors {
        from += sensor.record(&sense(sensor), &mut out[from..]);
    }
}
