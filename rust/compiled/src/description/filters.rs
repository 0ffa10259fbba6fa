//! Kalman filters.

use super::BuildError;
use super::noise::{ElasticNoise, JerkNoise, LinkDisturbance, MotorJerkNoise, Wrenches};
use super::tolerances::{Tolerance, tolerances};
use linkside_core::error::DesignError;
use linkside_core::estimate::kalman::{
    Discretization, ElasticModel, ElasticSettings, ExtendedKalmanFilter, FilterSettings, Gaussian, JerkDriven,
    JerkModel, Lateness, MotorJerkSettings, NoiseLoss, Phases, SigmaRule,
};
use linkside_core::estimate::measurement::Kind;
use linkside_core::robot::Robot;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Samples that delays may span in all: each costs a filter a state.
const MOST_DELAYED: usize = 4096;

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

/// The filter on a description's model, by the fields that all three descriptions have: serde flattens no struct of them
/// where unknown fields are refused.
macro_rules! filter_of {
    ($description:expr, $robot:expr, $model:expr) => {{
        let own = $description;
        let known = tolerances($robot, &own.tolerances, &own.correlations)?;
        let model = $model.with_tolerances(known).with_late(&late(&own.late)?)?;
        let settings = FilterSettings { gate: own.gate, iterations: own.iterations };
        filter(model, settings, &own.losses, own.points.as_ref(), own.start.as_ref())
    }};
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
        let model = JerkDriven::new(model, self.noise.clone().into(), self.damping)?;
        filter_of!(self, robot, model)
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
        )?;
        filter_of!(self, robot, model)
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
        )?;
        filter_of!(self, robot, model)
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
