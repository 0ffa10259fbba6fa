//! The Python face of `linkside-core`: converts, calls, raises. No arithmetic here.

mod array;
mod bag;
mod compiled;
mod control;
mod elastic_filter;
mod error;
mod filtering;
mod gil;
mod kalman;
mod learning;
mod likelihood;
mod live;
mod observer;
mod particle;
mod plain;
mod robot;
mod simulate;
mod state;
mod velocity;

use pyo3::prelude::*;

/// Compiled kernels of linkside.
#[pymodule]
mod _core {
    #[pymodule_export]
    use crate::bag::{BagCollector, McapReader, unpack_file};
    #[pymodule_export]
    use crate::compiled::compiled;
    #[pymodule_export]
    use crate::control::{derivative_order, feedforward};
    #[pymodule_export]
    use crate::elastic_filter::ElasticJointFilter;
    #[pymodule_export]
    use crate::kalman::{ExtendedKalmanFilter, FixedLagSmoother, StretchSmoother, largest_nis};
    #[pymodule_export]
    use crate::learning::{LearningLoop, LearningStep};
    #[pymodule_export]
    use crate::likelihood::{Likelihood, Response};
    #[pymodule_export]
    use crate::observer::{
        AccelerationObserver, acceleration_inverse, observer_bound, observer_gains, sampled_observer,
    };
    #[pymodule_export]
    use crate::particle::ParticleFilter;
    #[pymodule_export]
    use crate::robot::Robot;
    #[pymodule_export]
    use crate::simulate::simulate;
    #[pymodule_export]
    const START_SAMPLES: usize = linkside_core::estimate::Status::START;
    #[pymodule_export]
    const RELAXED: f64 = linkside_core::estimate::kalman::ElasticSettings::RELAXED;
    #[pymodule_export]
    use crate::state::State;
    #[pymodule_export]
    use crate::velocity::VelocityObserver;
}
