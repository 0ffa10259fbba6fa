//! Disturbance torques of links.

use linkside_core::estimate::kalman;
use pyo3::prelude::*;

/// What each link's may be at the first sample, by how much it wanders in a second, and over which time all forget.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct LinkDisturbance {
    initial: Vec<f64>,
    walk: Vec<f64>,
    time: f64,
}

impl From<LinkDisturbance> for kalman::LinkDisturbance {
    fn from(d: LinkDisturbance) -> Self {
        let LinkDisturbance { initial, walk, time } = d;
        Self { initial, walk, time }
    }
}
