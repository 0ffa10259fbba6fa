//! Whole recordings with any numbers and lengths: filter, smoother, fixed-lag smoother, particle filter.

use super::bytes::Bytes;
use super::calls::FILES;
use linkside_compiled::Description;
use linkside_compiled::description::Method;
use linkside_core::estimate::kalman::{
    ExtendedKalmanFilter, FilterOutput, FixedLagSmoother, Inputs, JerkDriven, KalmanRecording, KalmanSample, Keep,
    Model, Smoother,
};
use linkside_core::estimate::particle::{
    Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling,
};
use std::sync::Arc;

fn filter() -> ExtendedKalmanFilter<JerkDriven> {
    let description = Description::from_bytes(FILES[1]).expect("a file of the tests");
    let robot = Arc::new(description.robot.build().expect("a robot of the tests"));
    let Method::Ekf(settings) = description.estimator else { unreachable!("the second file is of a Kalman filter") };
    settings.build(&robot).expect("settings of the tests")
}

/// Arrays of a recording, with lengths that now and then do not fit.
struct Arrays {
    dt: Vec<f64>,
    readings: Vec<f64>,
    inputs: [Vec<f64>; 3],
}

impl Arrays {
    fn new(bytes: &mut Bytes<'_>, model: &impl Model) -> Self {
        let count = bytes.below(12);
        let (channels, joints) = (model.channels(), model.robot().len());
        let dt = (0..count).map(|_| if bytes.below(16) == 0 { bytes.number() } else { 1e-3 }).collect();
        let mut rows = |width| {
            let odd = usize::from(bytes.below(32) == 0);
            bytes.numbers(count * width + odd)
        };
        let readings = rows(channels);
        let inputs = [true, true, false]
            .map(|_| rows(joints))
            .map(|rows| if rows.first() == Some(&0.0) { vec![] } else { rows });
        Self { dt, readings, inputs }
    }

    fn recording(&self) -> KalmanRecording<'_> {
        let [dtheta, jerk, tau] = &self.inputs;
        KalmanRecording { dt: &self.dt, readings: &self.readings, inputs: Inputs { dtheta, jerk, tau } }
    }
}

fn keep(bytes: &mut Bytes<'_>) -> Keep {
    Keep { covariance: bytes.flag(), innovations: bytes.flag() }
}

/// Estimates are finite, and their standard deviations no less than zero.
fn check(out: &FilterOutput) {
    for values in [&out.q, &out.dq, &out.ddq, &out.theta, &out.dtheta, &out.state] {
        assert!(values.iter().all(|x| x.is_finite()));
    }
    assert!(out.q_std.iter().all(|&std| std >= 0.0));
}

/// The filter over a recording in two runs, each of any length.
pub fn run_filter(data: &[u8]) {
    let (mut bytes, mut filter) = (Bytes(data), filter());
    for _ in 0..2 {
        let keep = keep(&mut bytes);
        let arrays = Arrays::new(&mut bytes, filter.model());
        match filter.run(arrays.recording(), keep) {
            Ok(out) => check(&out),
            Err(_) => filter.reset(),
        }
    }
}

/// The smoother, and the one of fixed lag.
pub fn run_smoother(data: &[u8]) {
    let (mut bytes, filter) = (Bytes(data), filter());
    let keep = keep(&mut bytes);
    let lag = bytes.below(6);
    let arrays = Arrays::new(&mut bytes, filter.model());
    if let Ok(out) = Smoother::new(&filter).run(arrays.recording(), keep) {
        check(&out);
    }
    let Ok(mut smoother) = FixedLagSmoother::new(&filter, lag) else { return };
    let (channels, recording) = (filter.model().channels(), arrays.recording());
    for (&dt, readings) in recording.dt.iter().zip(recording.readings.chunks(channels)) {
        if let Ok(Some((t, out))) = smoother.step(KalmanSample { dt, readings, inputs: Inputs::default() }) {
            assert!(t.is_finite());
            check(out);
        }
    }
    if let Ok((_, out)) = smoother.flush() {
        check(&out);
    }
}

/// A cloud of particles, and its smoother.
pub fn run_particles(data: &[u8]) {
    let (mut bytes, model) = (Bytes(data), filter().model().clone());
    let pick = |index: usize| {
        [Resampling::Systematic, Resampling::Stratified, Resampling::Residual, Resampling::Multinomial][index]
    };
    let (channels, joints) = (model.channels(), model.robot().len());
    let density = match bytes.below(3) {
        0 => Density::Normal,
        1 => Density::Student { freedom: bytes.number() },
        _ => Density::Mixture { share: bytes.number(), scale: bytes.number() },
    };
    let settings = ParticleSettings {
        particles: bytes.below(24),
        seed: u64::from(bytes.byte()),
        proposal: if bytes.flag() { Proposal::Bootstrap } else { Proposal::Linearised { iterations: 1, tail: None } },
        resampling: pick(bytes.below(4)),
        threshold: if bytes.flag() { 0.5 } else { bytes.number() },
        kernel: bytes.flag().then(|| bytes.number()),
        densities: vec![density; channels],
        limits: vec![
            if bytes.flag() { (f64::NEG_INFINITY, f64::INFINITY) } else { (bytes.number(), bytes.number()) };
            joints
        ],
        initial: vec![],
        collapse: [Collapse::Flag, Collapse::Stop, Collapse::Reseed][bytes.below(3)],
        quantiles: if bytes.flag() { vec![bytes.number()] } else { vec![] },
    };
    let marginalised = [Marginalised::Nothing, Marginalised::Biases, Marginalised::Accelerations][bytes.below(3)];
    let keep = keep(&mut bytes);
    let Ok(mut filter) = ParticleFilter::new(model.clone(), settings, marginalised) else { return };
    let arrays = Arrays::new(&mut bytes, &model);
    let whole = |out: &[f64]| assert!(out.iter().all(|x| x.is_finite()));
    if let Ok(out) = filter.run(arrays.recording(), keep) {
        whole(&out.links.q);
    }
    if let Ok(out) = filter.smooth(arrays.recording(), keep) {
        whole(&out.links.q);
    }
}
