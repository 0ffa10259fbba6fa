//! Kalman filters and their noise.

use super::BuildError;
use linkside_core::error::DesignError;
use linkside_core::estimate::kalman::{
    self, Discretization, ElasticModel, ElasticSettings, ExtendedKalmanFilter, FilterSettings, Gaussian, JerkDriven,
    JerkModel, Lateness, MotorJerkSettings, NoiseLoss, Phases, SigmaRule, Tolerances, Uncertain,
};
use linkside_core::estimate::measurement::Kind;
use linkside_core::robot::Robot;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Samples that delays may span in all, and numbers that may have tolerances: each costs a filter a state or a column.
const MOST_DELAYED: usize = 4096;
const MOST_TOLERANCES: usize = 1024;

/// Kalman filter on the jerk-driven model; see [`JerkDriven`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct JerkFilter {
    /// Kinds of channels, as [`Kind::name`] has them.
    pub kinds: Vec<String>,
    /// Which channels have a bias.
    pub biased: Vec<bool>,
    /// How uncertain everything is.
    pub noise: JerkNoise,
    /// See [`FilterSettings`].
    pub gate: Option<f64>,
    /// Likewise.
    pub iterations: usize,
    /// Whether the damping torque is predicted.
    pub damping: bool,
    /// Numbers that are known to a tolerance only.
    pub tolerances: Vec<Tolerance>,
    /// Two of them, and the correlation of their errors.
    #[serde(default)]
    pub correlations: Vec<(usize, usize, f64)>,
    /// What is inside the sensor of each channel; empty where there is nothing in any.
    #[serde(default)]
    pub late: Vec<Option<Late>>,
    /// What errors of each channel cost, as [`NoiseLoss::named`]; empty where all cost squares.
    #[serde(default)]
    pub losses: Vec<String>,
    /// Which sigma points are in place of derivatives, as [`SigmaRule::named`].
    #[serde(default)]
    pub points: Option<String>,
    /// How disturbance torques of links wander, where they have any.
    #[serde(default)]
    pub link_disturbance: Option<LinkDisturbance>,
    /// How varying wrenches on links wander.
    #[serde(default)]
    pub wrenches: Wrenches,
    /// Where it starts; none: from rest.
    #[serde(default)]
    pub start: Option<Belief>,
}

/// Kalman filter on the elastic-joint model; see [`ElasticModel`]. What [`JerkFilter`] has too is the same.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct ElasticFilter {
    pub kinds: Vec<String>,
    /// Whether each motor has a disturbance torque.
    pub disturbances: bool,
    /// Whether friction elements start relaxed.
    #[serde(default)]
    pub relaxed: bool,
    pub biased: Vec<bool>,
    /// Whether the covariance moves by 1 + A h, not by the exponential.
    pub first_order: bool,
    /// Whether a sample's torques have acted since the one before.
    pub held: bool,
    pub noise: ElasticNoise,
    pub gate: Option<f64>,
    pub iterations: usize,
    pub tolerances: Vec<Tolerance>,
    #[serde(default)]
    pub correlations: Vec<(usize, usize, f64)>,
    #[serde(default)]
    pub late: Vec<Option<Late>>,
    #[serde(default)]
    pub losses: Vec<String>,
    #[serde(default)]
    pub points: Option<String>,
    #[serde(default)]
    pub link_disturbance: Option<LinkDisturbance>,
    /// How varying wrenches on links wander.
    #[serde(default)]
    pub wrenches: Wrenches,
    #[serde(default)]
    pub start: Option<Belief>,
}

/// Kalman filter on the elastic-joint model with motors moved by jerk; see [`ElasticModel::moved_by_jerk`]. What
/// [`JerkFilter`] and [`ElasticFilter`] have too is the same.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct MotorJerkFilter {
    pub kinds: Vec<String>,
    pub relaxed: bool,
    pub biased: Vec<bool>,
    pub noise: MotorJerkNoise,
    pub gate: Option<f64>,
    pub iterations: usize,
    pub tolerances: Vec<Tolerance>,
    pub correlations: Vec<(usize, usize, f64)>,
    pub late: Vec<Option<Late>>,
    pub losses: Vec<String>,
    pub points: Option<String>,
    pub link_disturbance: Option<LinkDisturbance>,
    pub wrenches: Wrenches,
    #[serde(default)]
    pub start: Option<Belief>,
}

/// Standard deviations of everything that is random; see [`kalman::JerkNoise`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct JerkNoise {
    pub jerk: Vec<f64>,
    pub link_walk: Vec<f64>,
    pub reading: Vec<f64>,
    pub torsion: f64,
    pub bias_walk: Vec<f64>,
    pub bias_time: Vec<f64>,
    pub initial: Vec<f64>,
    pub initial_bias: Vec<f64>,
}

/// Standard deviations of everything that is random; see [`kalman::ElasticNoise`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct ElasticNoise {
    pub link: Vec<f64>,
    pub motor: Vec<f64>,
    pub torque: Vec<f64>,
    pub disturbance_walk: Vec<f64>,
    pub reading: Vec<f64>,
    pub torque_walk: Vec<f64>,
    pub bias_walk: Vec<f64>,
    pub bias_time: Vec<f64>,
    pub initial: Vec<f64>,
    pub initial_bias: Vec<f64>,
}

/// Standard deviations of everything that is random; see [`kalman::MotorJerkNoise`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct MotorJerkNoise {
    pub jerk: Vec<f64>,
    pub link: Vec<f64>,
    pub reading: Vec<f64>,
    pub bias_walk: Vec<f64>,
    pub bias_time: Vec<f64>,
    pub initial: Vec<f64>,
    pub initial_bias: Vec<f64>,
}

/// How disturbance torques of links wander; see [`kalman::LinkDisturbance`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct LinkDisturbance {
    pub initial: Vec<f64>,
    pub walk: Vec<f64>,
    pub time: f64,
}

/// How varying wrenches wander; see [`kalman::WrenchLaw`].
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Wrenches {
    pub initial: Vec<f64>,
    pub walk: Vec<f64>,
}

/// A parameter's kind, its joint or sensor, its axis, and its standard deviation.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Tolerance(pub String, pub usize, pub usize, pub f64);

/// Time constant and delay inside a sensor [s], and how many steps of time the delay can have.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub struct Late(pub f64, pub f64, pub usize);

/// Mean of a state, and its covariance by rows.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Belief {
    pub mean: Vec<f64>,
    pub covariance: Vec<Vec<f64>>,
}

impl JerkFilter {
    /// The filter, with all checks.
    ///
    /// # Errors
    /// Settings that do not fit `robot`, or are out of range.
    pub fn build(&self, robot: &Arc<Robot>) -> Result<ExtendedKalmanFilter<JerkDriven>, BuildError> {
        let mut model = JerkModel::new(Arc::clone(robot), &kinds(&self.kinds)?, &self.biased)?;
        let torques = self.link_disturbance.clone().map(Into::into);
        model = model.with_disturbances(torques, self.wrenches.clone().into())?;
        let model = JerkDriven::new(model, self.noise.clone().into(), self.damping)?
            .with_tolerances(tolerances(robot, &self.tolerances, &self.correlations)?)
            .with_late(&late(&self.late)?)?;
        filter(
            model,
            FilterSettings { gate: self.gate, iterations: self.iterations },
            &self.losses,
            self.points.as_ref(),
            self.start.as_ref(),
        )
    }
}

impl ElasticFilter {
    /// The filter, with all checks.
    ///
    /// # Errors
    /// Settings that do not fit `robot`, or are out of range.
    pub fn build(&self, robot: &Arc<Robot>) -> Result<ExtendedKalmanFilter<ElasticModel>, BuildError> {
        let settings = ElasticSettings {
            kinds: kinds(&self.kinds)?,
            disturbances: self.disturbances,
            biased: self.biased.clone(),
            held: self.held,
            relaxed: self.relaxed,
            discretization: if self.first_order { Discretization::FirstOrder } else { Discretization::Exact },
        };
        let links = self.link_disturbance.clone().map(Into::into);
        let model = ElasticModel::disturbed(
            Arc::clone(robot),
            &settings,
            self.noise.clone().into(),
            links,
            self.wrenches.clone().into(),
        )?
        .with_tolerances(tolerances(robot, &self.tolerances, &self.correlations)?)
        .with_late(&late(&self.late)?)?;
        filter(
            model,
            FilterSettings { gate: self.gate, iterations: self.iterations },
            &self.losses,
            self.points.as_ref(),
            self.start.as_ref(),
        )
    }
}

impl MotorJerkFilter {
    /// The filter, with all checks.
    ///
    /// # Errors
    /// Settings that do not fit `robot`, or are out of range.
    pub fn build(&self, robot: &Arc<Robot>) -> Result<ExtendedKalmanFilter<ElasticModel>, BuildError> {
        let (kinds, biased, relaxed) = (kinds(&self.kinds)?, self.biased.clone(), self.relaxed);
        let links = self.link_disturbance.clone().map(Into::into);
        let model = ElasticModel::moved_by_jerk(
            Arc::clone(robot),
            &MotorJerkSettings { kinds, biased, relaxed },
            self.noise.clone().into(),
            links,
            self.wrenches.clone().into(),
        )?
        .with_tolerances(tolerances(robot, &self.tolerances, &self.correlations)?)
        .with_late(&late(&self.late)?)?;
        filter(
            model,
            FilterSettings { gate: self.gate, iterations: self.iterations },
            &self.losses,
            self.points.as_ref(),
            self.start.as_ref(),
        )
    }
}

impl From<JerkNoise> for kalman::JerkNoise {
    fn from(n: JerkNoise) -> Self {
        let JerkNoise { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias } = n;
        Self { jerk, link_walk, reading, torsion, bias_walk, bias_time, initial, initial_bias }
    }
}

impl From<ElasticNoise> for kalman::ElasticNoise {
    fn from(n: ElasticNoise) -> Self {
        Self {
            link: n.link,
            motor: n.motor,
            torque: n.torque,
            disturbance_walk: n.disturbance_walk,
            reading: n.reading,
            torque_walk: n.torque_walk,
            bias_walk: n.bias_walk,
            bias_time: n.bias_time,
            initial: n.initial,
            initial_bias: n.initial_bias,
        }
    }
}

impl From<MotorJerkNoise> for kalman::MotorJerkNoise {
    fn from(n: MotorJerkNoise) -> Self {
        let MotorJerkNoise { jerk, link, reading, bias_walk, bias_time, initial, initial_bias } = n;
        Self { jerk, link, reading, bias_walk, bias_time, initial, initial_bias }
    }
}

impl From<Wrenches> for kalman::WrenchLaw {
    fn from(law: Wrenches) -> Self {
        let Wrenches { initial, walk } = law;
        Self { initial, walk }
    }
}

impl From<LinkDisturbance> for kalman::LinkDisturbance {
    fn from(d: LinkDisturbance) -> Self {
        let LinkDisturbance { initial, walk, time } = d;
        Self { initial, walk, time }
    }
}

impl Belief {
    /// # Errors
    /// Shapes that do not belong together, numbers that are not finite.
    fn build(&self) -> Result<Gaussian, DesignError> {
        let covariance = self.covariance.concat();
        if let Some(&value) = self.mean.iter().chain(&covariance).find(|x| !x.is_finite()) {
            return Err(DesignError::Range { what: "a start", value, expected: "finite numbers" });
        }
        Gaussian::new(&self.mean, &covariance)
    }
}

/// The filter on either model.
fn filter<M: Phases>(
    model: M,
    settings: FilterSettings,
    losses: &[String],
    points: Option<&String>,
    start: Option<&Belief>,
) -> Result<ExtendedKalmanFilter<M>, BuildError> {
    let mut filter = ExtendedKalmanFilter::new(model, settings)?;
    if !losses.is_empty() {
        let find = |name: &String| NoiseLoss::named(name).ok_or_else(|| BuildError::unknown("a loss", name));
        filter.set_losses(&losses.iter().map(find).collect::<Result<Vec<_>, _>>()?)?;
    }
    let rule = |name: &String| SigmaRule::named(name).ok_or_else(|| BuildError::unknown("sigma points", name));
    filter.set_points(points.map(rule).transpose()?);
    filter.set_start(start.map(Belief::build).transpose()?)?;
    Ok(filter)
}

/// Kinds of channels by name.
///
/// # Errors
/// A name that none has.
pub fn kinds(names: &[String]) -> Result<Vec<Kind>, BuildError> {
    names.iter().map(|name| Kind::named(name).ok_or_else(|| BuildError::unknown("a kind of channel", name))).collect()
}

/// What is inside the sensor of each channel.
///
/// # Errors
/// Delays that span too many samples.
pub fn late(inside: &[Option<Late>]) -> Result<Vec<Option<Lateness>>, BuildError> {
    let spanned = inside.iter().flatten().fold(0_usize, |sum, late| sum.saturating_add(late.2));
    BuildError::limit("samples that delays span", spanned, MOST_DELAYED)?;
    let one = |&Late(time_constant, delay, steps): &Late| Lateness { time_constant, delay, steps };
    Ok(inside.iter().map(|inside| inside.as_ref().map(one)).collect())
}

/// Numbers of `robot` that are known to a tolerance only.
///
/// # Errors
/// One of a joint, a sensor or a kind that there is not; correlations that no errors have.
pub fn tolerances(
    robot: &Robot,
    each: &[Tolerance],
    correlations: &[(usize, usize, f64)],
) -> Result<Tolerances, BuildError> {
    BuildError::limit("tolerances", each.len(), MOST_TOLERANCES)?;
    let each: Result<_, _> = each.iter().map(|one| one.build(robot)).collect();
    Ok(Tolerances::correlated(each?, correlations.to_vec())?)
}

impl Tolerance {
    fn build(&self, robot: &Robot) -> Result<kalman::Tolerance, BuildError> {
        use Uncertain as U;
        let Self(ref kind, i, axis, std) = *self;
        let (parameter, parts) = match kind.as_str() {
            "stiffness" => (U::Stiffness(i), robot.len()),
            "cubic_stiffness" => (U::CubicStiffness(i), robot.len()),
            "damping" => (U::Damping(i), robot.len()),
            "yielding" => (U::Yielding(i), robot.len()),
            "hysteresis" => (U::Hysteresis(i), robot.len()),
            "mass" => (U::Mass(i), robot.len()),
            "link_friction" => (U::LinkFriction(i), robot.len()),
            "torque_constant" => (U::TorqueConstant(i), robot.len()),
            "motor_friction" => (U::MotorFriction(i), robot.len()),
            "motor_inertia" => (U::MotorInertia(i), robot.len()),
            "encoder_line" => (U::EncoderLine(i, axis), robot.len()),
            "encoder_zero" => (U::EncoderZero(i), robot.len()),
            "lost_motion" => (U::LostMotion(i), robot.len()),
            "rotation" => (U::Rotation(i, axis), robot.accelerometers.len()),
            "translation" => (U::Translation(i, axis), robot.accelerometers.len()),
            "scale" => (U::Scale(i, axis), robot.accelerometers.len()),
            _ => return Err(BuildError::unknown("a tolerance", kind)),
        };
        let axes = match parameter {
            U::EncoderLine(j, _) => robot.drives.get(j).map_or(0, |drive| 2 * drive.encoder_lines.len()),
            _ => 3,
        };
        if i >= parts || axis >= axes {
            return Err(BuildError::unknown("a tolerance of a part", &format!("{kind} {i} {axis}")));
        }
        if !(std >= 0.0 && std.is_finite()) {
            return Err(DesignError::Range { what: "a tolerance", value: std, expected: "at least 0" }.into());
        }
        Ok(kalman::Tolerance { parameter, std })
    }
}
