//! What is random: standard deviations of filters, and how disturbances wander.

use linkside_core::estimate::kalman;
use serde::{Deserialize, Serialize};

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
