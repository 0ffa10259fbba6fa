//! What errors of accelerometers do to the joint accelerations that are solved from them.

use super::acceleration::AccelerationMap;
use crate::dynamics::Kinematics;
use crate::estimate::kalman::{Tolerance, Uncertain};
use crate::linear::{self, LANES};
use crate::robot::{Robot, Sensor};
use crate::spatial::Vec3;

/// Numbers of one accelerometer: rotation, displacement, scale and bias of each of its axes.
pub(super) const PER_SENSOR: usize = 12;
const ROTATION: usize = 0;
const TRANSLATION: usize = 3;
const SCALE: usize = 6;
const BIAS: usize = 9;

/// Errors of all accelerometers, in columns of [`PER_SENSOR`] a sensor, and one more for what damping leaves open.
///
/// With the weighted map T and the weights W, accelerations are solved by C Tᵀ W, C = (TᵀT)⁻¹ or what damping makes of it: readings
/// that are off by N p put them off by C Tᵀ W N p.
#[derive(Clone, Debug)]
pub(super) struct SensorErrors {
    /// Standard deviation of each number (sensors × [`PER_SENSOR`]).
    stds: Vec<f64>,
    /// Columns, padded.
    pub(super) columns: usize,
    /// Tᵀ W N (unknowns × columns).
    pulls: Vec<f64>,
    /// C (unknowns × unknowns), and the variance of what damping leaves open (unknowns).
    covariance: Vec<f64>,
    open: Vec<f64>,
}

impl SensorErrors {
    pub(super) fn new(robot: &Robot, tolerances: &[Tolerance], bias: f64) -> Self {
        let unknowns = robot.drives.iter().filter(|d| d.elastic).count();
        let mut stds = vec![0.0; PER_SENSOR * robot.accelerometers.len()];
        for one in tolerances {
            if let Some(column) = Self::column(one.parameter) {
                stds[column] = one.counted();
            }
        }
        for (sensor, own) in robot.accelerometers.iter().zip(stds.chunks_exact_mut(PER_SENSOR)) {
            sensor.axes.iter().for_each(|axis| own[BIAS + axis] = bias);
        }
        let columns = (stds.len() + 1).next_multiple_of(LANES);
        let pulls = vec![0.0; unknowns * columns];
        Self { stds, columns, pulls, covariance: vec![0.0; unknowns * unknowns], open: vec![0.0; unknowns] }
    }

    /// The column of a number of an accelerometer.
    pub(super) fn column(parameter: Uncertain) -> Option<usize> {
        match parameter {
            Uncertain::Rotation(s, axis) => Some(PER_SENSOR * s + ROTATION + axis),
            Uncertain::Translation(s, axis) => Some(PER_SENSOR * s + TRANSLATION + axis),
            Uncertain::Scale(s, axis) => Some(PER_SENSOR * s + SCALE + axis),
            _ => None,
        }
    }

    /// Of accelerations that `map` has solved from `reading`, where `kinematics` now has them.
    #[inline(always)]
    pub(super) fn set(&mut self, robot: &Robot, kinematics: &Kinematics<f64>, map: &AccelerationMap, reading: &[f64]) {
        map.covariance_into(&mut self.covariance, &mut self.open);
        self.pulls.fill(0.0);
        let mut row = 0;
        for (s, sensor) in robot.accelerometers.iter().enumerate() {
            let first = PER_SENSOR * s;
            let stds = &self.stds[first..][..PER_SENSOR];
            let errors = unit_errors(kinematics, sensor);
            let weight = 1.0 / (sensor.noise_std * sensor.noise_std);
            kinematics.acceleration_map(&robot.tree, &sensor.frame, |joint, by| {
                let Some(unknown) = map.column(joint) else { return };
                let pulls = &mut self.pulls[unknown * self.columns + first..][..PER_SENSOR];
                for (r, &axis) in (row..).zip(&sensor.axes) {
                    if !reading[r].is_nan() {
                        let factor = by.0[axis] * weight;
                        for ((pull, error), std) in pulls.iter_mut().zip(&errors[axis]).zip(stds) {
                            *pull += factor * error * std;
                        }
                    }
                }
            });
            row += sensor.axes.len();
        }
    }

    /// Variance of the acceleration of an unknown by the sensors' noise [(rad/s²)²].
    #[inline(always)]
    pub(super) fn noise(&self, unknown: usize) -> f64 {
        self.covariance[unknown * self.open.len() + unknown]
    }

    /// What a standard deviation of each number adds to the acceleration of an unknown [rad/s²].
    ///
    /// True accelerations are less than solved ones by what readings are too much.
    #[inline(always)]
    pub(super) fn drive_into(&self, unknown: usize, out: &mut [f64]) {
        let m = self.open.len();
        out.fill(0.0);
        for (k, pulls) in self.pulls.chunks_exact(self.columns).enumerate() {
            linear::add_scaled(out, -self.covariance[unknown * m + k], pulls);
        }
        // Of which sign it is, nobody knows; that it keeps it is the worst.
        out[self.stds.len()] = self.open[unknown].sqrt();
    }
}

/// ∂reading/∂p of each of a sensor's own axes, p its [`PER_SENSOR`] numbers: of a specific force f, rotation gives f × e, and a
/// displacement along e gives ω̇ × e + ω × (ω × e).
#[inline(always)]
fn unit_errors(kinematics: &Kinematics<f64>, sensor: &Sensor) -> [[f64; PER_SENSOR]; 3] {
    let (force, carry) = kinematics.seen(sensor);
    let mut out = [[0.0; PER_SENSOR]; 3];
    for k in 0..3 {
        let mut unit = Vec3::default();
        unit.0[k] = 1.0;
        let (turned, carried) = (force.cross(&unit), carry(&unit));
        for (axis, row) in out.iter_mut().enumerate() {
            row[ROTATION + k] = turned.0[axis];
            row[TRANSLATION + k] = carried.0[axis];
        }
        out[k][SCALE + k] = force.0[k];
        out[k][BIAS + k] = 1.0;
    }
    out
}
