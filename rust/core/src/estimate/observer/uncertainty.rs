//! What an observer is to take as not known exactly, and which columns that makes.

use super::sensor_errors::SensorErrors;
use super::settings::AccelerationSource;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::estimate::kalman::{Tolerances, Uncertain};
use crate::linear::LANES;
use crate::robot::Robot;
use core::ops::Range;

/// What an [`AccelerationObserver`](super::AccelerationObserver) is to take as not known exactly: standard deviations.
#[derive(Clone, Debug)]
pub struct Uncertainty {
    /// Numbers of the robot; those that the observer does not use do nothing.
    pub tolerances: Tolerances,
    /// Steps of motor positions, as noise (n) [rad].
    pub encoder: Vec<f64>,
    /// Noise of motor torques (n) [N m].
    pub torque: Vec<f64>,
    /// Bias of each axis of the accelerometers [m/s²], or of each measured joint acceleration [rad/s²].
    pub bias: f64,
    /// Scale of measured joint accelerations.
    pub scale: f64,
}

impl Uncertainty {
    /// # Errors
    /// Wrong lengths, numbers out of range.
    pub(super) fn check(&self, robot: &Robot) -> Result<(), DesignError> {
        for (what, values) in [("encoder noise", &self.encoder), ("torque noise", &self.torque)] {
            expect_length(what, values.len(), robot.len())?;
        }
        let rest = [("a bias", self.bias), ("a scale", self.scale)];
        let each = self.encoder.iter().chain(&self.torque).map(|&value| ("a standard deviation", value));
        for (what, value) in each.chain(rest) {
            expect(value >= 0.0 && value.is_finite(), what, value, "a number, at least 0")?;
        }
        Ok(())
    }

    /// Standard deviation of a number of joint `joint`; 0 where it is exact.
    pub(super) fn of(&self, parameter: Uncertain) -> f64 {
        let found = self.tolerances.iter().find(|one| one.parameter == parameter);
        found.map_or(0.0, |one| one.counted())
    }
}

/// A number of a joint's drive, its standard deviation, and its column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Own {
    pub(super) parameter: Uncertain,
    pub(super) std: f64,
    pub(super) column: usize,
}

/// A column: of all joints, where it is of a sensor, or of one.
pub(super) type Place = (Option<usize>, usize);

/// Which column each number has: first a joint's own, those of its encoder and those that are torques, then accelerations, which
/// sensors share out among joints.
#[derive(Clone, Debug)]
pub(super) struct Columns {
    /// Of each joint.
    pub(super) own: Vec<Vec<Own>>,
    pub(super) readings: Range<usize>,
    pub(super) torques: Range<usize>,
    /// Those of a torque which is not read, and of dry friction at standstill.
    pub(super) missing: usize,
    pub(super) sticking: usize,
    pub(super) accelerations: Range<usize>,
    /// Two columns and the correlation of their numbers.
    pub(super) correlations: Vec<(Place, Place, f64)>,
}

impl Columns {
    pub(super) fn new(robot: &Robot, uncertainty: &Uncertainty, source: AccelerationSource) -> Self {
        let n = robot.len();
        let (mut lines, mut torques) = (vec![Vec::new(); n], vec![Vec::new(); n]);
        for one in uncertainty.tolerances.iter() {
            let (parameter, std) = (one.parameter, one.counted());
            match parameter {
                Uncertain::EncoderLine(j, _) => lines[j].push((parameter, std)),
                _ => {
                    if let Some(j) = torque_of(robot, parameter) {
                        torques[j].push((parameter, std));
                    }
                }
            }
        }
        let most = |of: &[Vec<_>]| of.iter().map(Vec::len).max().unwrap_or_default();
        let readings = 0..most(&lines).next_multiple_of(LANES);
        let missing = readings.end + most(&torques);
        let sticking = missing + 1;
        let torque_range = readings.end..(sticking + 1).next_multiple_of(LANES);
        let shared = match source {
            AccelerationSource::Sensors => SensorErrors::new(robot, &uncertainty.tolerances, uncertainty.bias).columns,
            AccelerationSource::Joints => (2 * n).next_multiple_of(LANES),
        };
        let accelerations = torque_range.end..torque_range.end + shared;
        let numbered = |(lines, torques): (&Vec<_>, &Vec<_>)| {
            let number = |first: usize, of: &[(Uncertain, f64)]| -> Vec<Own> {
                let one = |(i, &(parameter, std))| Own { parameter, std, column: first + i };
                of.iter().enumerate().map(one).collect()
            };
            [number(0, lines), number(torque_range.start, torques)].concat()
        };
        let own: Vec<Vec<Own>> = lines.iter().zip(&torques).map(numbered).collect();
        let correlations = Vec::new();
        let mut columns = Self { own, readings, torques: torque_range, missing, sticking, accelerations, correlations };
        let place = |i: usize| columns.place(uncertainty.tolerances[i].parameter);
        let pair = |(i, j, value)| Some((place(i)?, place(j)?, value));
        columns.correlations = uncertainty.tolerances.correlations().filter_map(pair).collect();
        columns
    }

    /// Columns of joint `j` that are torques on its motor which its spring then has to hold.
    #[inline(always)]
    pub(super) fn carried(&self, j: usize) -> impl Iterator<Item = usize> + '_ {
        use Uncertain as U;
        let motors =
            |one: &&Own| matches!(one.parameter, U::TorqueConstant(_) | U::MotorFriction(_) | U::MotorInertia(_));
        self.own[j].iter().filter(motors).map(|one| one.column).chain([self.missing, self.sticking])
    }

    /// Where a number is; none that has no effect.
    fn place(&self, parameter: Uncertain) -> Option<Place> {
        if let Some(column) = SensorErrors::column(parameter) {
            return Some((None, self.accelerations.start + column));
        }
        let find = |(j, own): (usize, &Vec<Own>)| {
            own.iter().find(|one| one.parameter == parameter).map(|one| (Some(j), one.column))
        };
        self.own.iter().enumerate().find_map(find)
    }
}

/// The joint whose motor a number gives more or less torque.
fn torque_of(robot: &Robot, parameter: Uncertain) -> Option<usize> {
    use Uncertain as U;
    match parameter {
        U::Stiffness(j)
        | U::CubicStiffness(j)
        | U::Damping(j)
        | U::TorqueConstant(j)
        | U::MotorFriction(j)
        | U::MotorInertia(j)
            if robot.drives[j].elastic =>
        {
            Some(j)
        }
        _ => None,
    }
}
