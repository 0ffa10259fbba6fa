//! The Kalman filter's channels against dual numbers, and its smoother against itself in stretches.

mod arm;

use arm::{Mounting, arm, drive};
use linkside_core::estimate::kalman::{
    Discretization, ElasticModel, ElasticNoise, ElasticSettings, ExtendedKalmanFilter, FilterSettings,
    FixedLagSmoother, Gaussian, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanRecording, KalmanSample, Keep,
    Lateness, LinkDisturbance, Measurement, Model, MotorJerkNoise, MotorJerkSettings, Phases, Smoother, WrenchLaw,
};
use linkside_core::estimate::measurement::{Evaluation, Kind};
use linkside_core::robot::{
    Acting, Drive, Friction, FrictionElement, Harmonic, Hysteresis, LoadFriction, Ripple, Robot, Sensor, SoftWindup,
    Tracker, WRENCH, Wrench,
};
use linkside_core::scalar::Dual;
use linkside_core::spatial::{Mat3, Vec3};
use proptest::prelude::*;
use std::sync::Arc;

const JOINTS: usize = 3;
const ALL: &[Kind] = Kind::SENSORS;
/// Motors, an accelerometer's two axes, motor velocities, a gyroscope's three axes, links, torques, links' velocities, a
/// tracker's two axes.
const CHANNELS: usize = 5 * JOINTS + 7;

/// Three joints, one rigid, one with everything nonlinear that a drive can have.
fn robot() -> Robot {
    let soft = Drive {
        cubic_stiffness: 3e8,
        soft_windup: SoftWindup { stiffness: 3e4, shape: 1e5 },
        link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
        hysteresis: Hysteresis { elements: vec![FrictionElement::dahl(5e4, 20.0)] },
        ripple: Ripple::new(vec![Harmonic { amplitude: 2e-3, frequency: 40.0, phase: 0.3 }]),
        ..drive()
    };
    let rigid = Drive { elastic: false, ..drive() };
    let mountings = [Mounting { body: 2, at: [0.3, 0.1, 0.2], axes: vec![0, 2], noise_std: 0.05 }];
    let mut robot = arm(vec![drive(), soft, rigid], &mountings);
    let frame = robot.tree.frame("gyroscope", 1, &Mat3::IDENTITY, &Vec3([0.1, 0.0, 0.0])).unwrap();
    robot.gyroscopes.push(Sensor { frame, axes: vec![0, 1, 2], noise_std: 0.01 });
    let frame = robot.tree.frame("tracker", 2, &Mat3::IDENTITY, &Vec3([0.2, -0.1, 0.4])).unwrap();
    let target = Sensor { frame, axes: vec![0, 2], noise_std: 1e-4 };
    let axes = Mat3::from_rows([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]]);
    robot.with_trackers(vec![Tracker { target, axes, origin: Vec3([1.0, -2.0, 0.5]) }]).unwrap()
}

fn noise() -> JerkNoise {
    JerkNoise {
        jerk: vec![20.0; JOINTS],
        link_walk: [[1e-4; JOINTS], [1e-2; JOINTS]].concat(),
        reading: vec![1e-3; CHANNELS],
        torsion: 1e-3,
        bias_walk: vec![1e-6; CHANNELS],
        bias_time: vec![50.0; CHANNELS],
        initial: vec![1e-3; 3 * JOINTS],
        initial_bias: vec![1e-4; CHANNELS],
    }
}

fn model(disturbed: bool) -> JerkDriven {
    let mut model = JerkModel::new(Arc::new(robot()), ALL, &[true; CHANNELS]).unwrap();
    if disturbed {
        let law = LinkDisturbance { initial: vec![5.0; JOINTS], walk: vec![20.0; JOINTS], time: 0.7 };
        model = model.with_disturbances(Some(law), WrenchLaw::default()).unwrap();
    }
    JerkDriven::new(model, noise(), true).unwrap()
}

/// A model that has seen a sample, so that motor velocities and jerk are in it, linearised at `state`; with disturbance
/// torques where that has them.
fn linearised(state: &[f64]) -> JerkDriven {
    let mut model = model(state.len() > 3 * JOINTS);
    let mut belief = Gaussian::independent(&vec![0.0; model.states()]);
    let inputs = Inputs { dtheta: &[0.3, -0.2, 0.1], jerk: &[5.0, -7.0, 3.0], tau: &[] };
    model.start(&KalmanSample { dt: 1e-3, readings: &[0.0; CHANNELS], inputs }, &mut belief).unwrap();
    model.linearise(state);
    model
}

/// States with torques on links and a wrench.
const PUSHED: usize = 4 * JOINTS + WRENCH;

fn pushed_states() -> impl Strategy<Value = Vec<f64>> {
    (states(), prop::collection::vec(-50.0..50.0, WRENCH)).prop_map(|(links, wrench)| [links, wrench].concat())
}

/// The robot with a measured wrench on its second link, and a constant one on its third.
fn pressed(robot: Robot) -> Robot {
    let turned = Mat3::from_rows([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]]);
    let wrench = |body, acting| {
        let frame = robot.tree.frame("wrench", body, &turned, &Vec3([0.3, -0.1, 0.2])).unwrap();
        Wrench { frame, acting }
    };
    let held = Acting::Constant([30.0, -20.0, 10.0, 3.0, 1.0, -2.0]);
    let wrenches = vec![wrench(2, held), wrench(1, Acting::Varying { measured: true })];
    robot.with_wrenches(wrenches).unwrap()
}

fn states() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-1.5..1.5, 4 * JOINTS)
}

proptest! {
    #[test]
    fn derivatives_of_channels_are_those_of_dual_numbers(state in pushed_states(), share in prop_oneof![Just(0.0), 0.0..0.3_f64]) {
        let (mut robot, dtheta) = (robot(), [0.3, -0.2, f64::NAN]);
        robot.drives[1].bearing_friction = Friction { coulomb: 9.0, asymmetry: 2.0, ..Friction::default() };
        robot.drives[1].bearing_loss = LoadFriction { driving: share, driven: share, rounding: 5.0 };
        let robot = pressed(robot);
        let channels = Kind::all_channels(ALL, &robot);
        let mut plain = Evaluation::disturbed(&robot, channels.len(), [JOINTS, WRENCH]);
        plain.evaluate(&robot, &channels, &state, &dtheta);
        let mut dual = Evaluation::<Dual<PUSHED>>::disturbed(&robot, channels.len(), [JOINTS, WRENCH]);
        let variables: Vec<_> = state.iter().enumerate().map(|(i, &x)| Dual::variable(x, i)).collect();
        dual.evaluate(&robot, &channels, &variables, &dtheta);
        for (i, h) in dual.prediction.iter().enumerate() {
            prop_assert_eq!(h.value, plain.prediction[i]);
            for k in 0..PUSHED {
                let (ours, theirs) = (plain.jacobian[i * PUSHED + k], h.gradient[k]);
                prop_assert!((ours - theirs).abs() <= 1e-11 * (1.0 + theirs.abs()), "{:?} {k}: {ours} {theirs}", channels[i]);
            }
        }
    }

    /// What others give a link its transmission need not; without that, all is as it was.
    #[test]
    fn disturbances_are_taken_off_the_loads(state in states()) {
        let d = 3 * JOINTS;
        let (plain, disturbed) = (linearised(&state[..d]), linearised(&state));
        let still = linearised(&[&state[..d], &[0.0; JOINTS]].concat());
        prop_assert_eq!(still.linearised().prediction, plain.linearised().prediction);
        let (before, after) = (plain.linearised().prediction, disturbed.linearised().prediction);
        let torques = CHANNELS - 2 - 2 * JOINTS;
        for (channel, (before, after)) in before.iter().zip(after).enumerate() {
            if (torques..torques + JOINTS).contains(&channel) {
                let off = state[d + channel - torques];
                prop_assert!((before - off - after).abs() <= 1e-12 * (1.0 + before.abs()));
            } else if (JOINTS..JOINTS + 2).contains(&channel) {
                prop_assert_eq!(before, after);
            }
        }
    }

    /// The two ways to the links' motion, by bodies' own axes and by the base's, read the same.
    #[test]
    fn channels_alone_are_those_with_derivatives(state in states()) {
        for state in [&state[..], &state[..3 * JOINTS]] {
            let mut model = linearised(state);
            let with: Vec<f64> = model.linearised().prediction.to_vec();
            for (with, alone) in with.iter().zip(model.measurement_mut().evaluate(state)) {
                prop_assert!((with - alone).abs() <= 1e-12 * (1.0 + with.abs()), "{with} {alone}");
            }
        }
    }

    #[test]
    fn motor_velocity_is_the_rate_of_motor_position(state in states()) {
        let model = linearised(&state);
        let at = model.linearised();
        let (d, jerk) = (4 * JOINTS, [5.0, -7.0, 3.0]);
        let first = JOINTS + 2;
        for j in 0..JOINTS {
            let fading = state[3 * JOINTS..].iter().map(|d| -d / 0.7);
            let rates = state[JOINTS..3 * JOINTS].iter().chain(&jerk).copied().chain(fading);
            let rate: f64 = at.jacobian[j * d..][..d].iter().zip(rates).map(|(h, x)| h * x).sum();
            prop_assert!((at.prediction[first + j] - rate).abs() <= 1e-12 * (1.0 + rate.abs()));
        }
        let step = 1e-5;
        for k in 0..d {
            let [above, below] = [step, -step].map(|s| {
                let mut moved = state.clone();
                moved[k] += s;
                linearised(&moved).linearised().prediction[first..first + JOINTS].to_vec()
            });
            for j in 0..JOINTS {
                let slope = (above[j] - below[j]) / (2.0 * step);
                let ours = at.jacobian[(first + j) * d + k];
                prop_assert!((ours - slope).abs() <= 1e-6 * (1.0 + slope.abs()), "{j} {k}: {ours} {slope}");
            }
        }
    }
}

/// A recording of nothing in particular, some of it missing.
fn signals(count: usize) -> [Vec<f64>; 4] {
    let wave = |width: usize, size: f64, turn: f64| -> Vec<f64> {
        (0..count * width).map(|i| size * (turn * i as f64).sin()).collect()
    };
    let mut readings = wave(CHANNELS, 1e-3, 0.37);
    for i in (50..readings.len()).step_by(11) {
        readings[i] = f64::NAN;
    }
    [vec![1e-3; count], readings, wave(JOINTS, 0.1, 0.21), wave(JOINTS, 5.0, 0.13)]
}

#[test]
fn a_smoother_does_not_depend_on_how_a_recording_is_cut() {
    [false, true].into_iter().for_each(check_cuts);
}

fn check_cuts(disturbed: bool) {
    let count = 60;
    let [dt, readings, dtheta, jerk] = signals(count);
    let rows = |a: usize, b: usize| KalmanRecording {
        dt: &dt[a..b],
        readings: &readings[a * CHANNELS..b * CHANNELS],
        inputs: Inputs { dtheta: &dtheta[a * JOINTS..b * JOINTS], jerk: &jerk[a * JOINTS..b * JOINTS], tau: &[] },
    };
    let keep = Keep { covariance: true, innovations: false };
    let filter = ExtendedKalmanFilter::new(model(disturbed), FilterSettings { gate: None, iterations: 1 }).unwrap();
    let whole = Smoother::new(&filter).run(rows(0, count), keep).unwrap();
    let cuts = [0, 1, 17, 18, 40, count];
    let (mut ahead, mut starts) = (filter.clone(), Vec::new());
    for cut in cuts.windows(2) {
        starts.push(ahead.clone());
        ahead.run(rows(cut[0], cut[1]), Keep::default()).unwrap();
    }
    let mut smoother = Smoother::new(&filter);
    smoother.finish();
    for (start, cut) in starts.iter().zip(cuts.windows(2)).rev() {
        let (a, b) = (cut[0], cut[1]);
        let part = smoother.stretch_back(start, rows(a, b), keep).unwrap();
        let states = filter.model().states();
        assert_eq!(part.state, whole.state[a * states..b * states]);
        assert_eq!(part.covariance, whole.covariance[a * states * states..b * states * states]);
    }
}

fn plain<M: Phases>(model: M) -> ExtendedKalmanFilter<M> {
    ExtendedKalmanFilter::new(model, FilterSettings { gate: None, iterations: 1 }).unwrap()
}

/// With a filter and a delay inside the accelerometer.
fn late() -> ExtendedKalmanFilter<JerkDriven> {
    let mut inside = [None; CHANNELS];
    inside[JOINTS] = Some(Lateness { time_constant: 2e-3, delay: 2.4e-3, steps: 3 });
    inside[JOINTS + 1] = inside[JOINTS];
    plain(model(false).with_late(&inside).unwrap())
}

fn elastic() -> ExtendedKalmanFilter<ElasticModel> {
    let settings = ElasticSettings {
        kinds: vec![Kind::Motor, Kind::Acceleration],
        disturbances: true,
        biased: vec![false, false, false, true, true],
        held: true,
        relaxed: true,
        discretization: Discretization::Exact,
    };
    let noise = ElasticNoise {
        link: vec![3e-3; JOINTS],
        motor: vec![1e-2; JOINTS],
        torque: vec![1.0; JOINTS],
        disturbance_walk: vec![0.1; JOINTS],
        reading: [vec![1e-4; JOINTS], vec![0.1; 2]].concat(),
        torque_walk: vec![1.0; JOINTS],
        bias_walk: vec![1e-4; JOINTS + 2],
        bias_time: vec![f64::INFINITY; JOINTS + 2],
        initial: vec![1e-3; 3 * JOINTS],
        initial_bias: vec![0.1; JOINTS + 2],
    };
    plain(ElasticModel::new(Arc::new(robot()), &settings, noise).unwrap())
}

/// Every sample's smoothed state by all samples up to a lag later, against the smoother of the recording that ends there.
fn check_lag<M: Phases>(filter: &ExtendedKalmanFilter<M>, recording: impl Fn(usize) -> Vec<[Vec<f64>; 5]>) {
    const COUNT: usize = 45;
    let keep = Keep { covariance: true, innovations: false };
    let rows = recording(COUNT);
    fn sample(row: &[Vec<f64>; 5]) -> KalmanSample<'_> {
        let [dt, readings, dtheta, jerk, tau] = row;
        KalmanSample { dt: dt[0], readings, inputs: Inputs { dtheta, jerk, tau } }
    }
    let joined = |count: usize| -> [Vec<f64>; 5] {
        core::array::from_fn(|k| rows[..count].iter().flat_map(|row| row[k].clone()).collect())
    };
    for lag in [1, 2, 3, 4, 7, 12] {
        let mut lagged = FixedLagSmoother::new(filter, lag).unwrap();
        for (now, row) in rows.iter().enumerate() {
            let Some((_, found)) = lagged.step(sample(row)).unwrap() else { continue };
            if now % 11 != 0 && now + 1 < COUNT {
                continue;
            }
            let [dt, readings, dtheta, jerk, tau] = &joined(now + 1);
            let inputs = Inputs { dtheta, jerk, tau };
            let whole = Smoother::new(filter).run(KalmanRecording { dt, readings, inputs }, keep).unwrap();
            let (at, states) = (now - lag, filter.model().states());
            for (own, other) in found.state.iter().zip(&whole.state[at * states..]) {
                assert!((own - other).abs() < 1e-9 * (1.0 + other.abs()), "{lag} {now}: {own} {other}");
            }
            let covariance = &whole.covariance[at * states * states..];
            for i in 0..states {
                for j in 0..states {
                    let size = (covariance[i * states + i] * covariance[j * states + j]).sqrt();
                    let apart = found.covariance[i * states + j] - covariance[i * states + j];
                    assert!(apart.abs() <= 1e-6 * size, "{lag} {now} {i} {j}: {apart} of {size}");
                }
            }
        }
    }
}

/// Rows of the signals that the jerk-driven model takes.
fn jerk_rows(count: usize) -> Vec<[Vec<f64>; 5]> {
    let [dt, readings, dtheta, jerk] = signals(count);
    let row = |values: &[f64], width: usize, i: usize| values[i * width..(i + 1) * width].to_vec();
    (0..count)
        .map(|i| {
            let [dtheta, jerk] = [&dtheta, &jerk].map(|signal| row(signal, JOINTS, i));
            [row(&dt, 1, i), row(&readings, CHANNELS, i), dtheta, jerk, vec![]]
        })
        .collect()
}

fn elastic_rows(count: usize) -> Vec<[Vec<f64>; 5]> {
    let mut rows = jerk_rows(count);
    for [_, readings, dtheta, jerk, tau] in &mut rows {
        readings.truncate(JOINTS + 2);
        *tau = core::mem::take(dtheta);
        jerk.clear();
    }
    rows
}

/// Motors moved by jerk, their torques being read.
fn moved_by_jerk() -> ExtendedKalmanFilter<ElasticModel> {
    let kinds = vec![Kind::Motor, Kind::Acceleration, Kind::MotorTorque];
    let channels = 2 * JOINTS + 2;
    let biased = (0..channels).map(|channel| channel >= JOINTS).collect();
    let noise = MotorJerkNoise {
        jerk: vec![30.0; JOINTS],
        link: vec![3e-3; JOINTS],
        reading: [vec![1e-4; JOINTS], vec![0.1; 2], vec![1.0; JOINTS]].concat(),
        bias_walk: vec![1e-4; channels],
        bias_time: vec![f64::INFINITY; channels],
        initial: vec![1e-3; 3 * JOINTS],
        initial_bias: vec![0.1; channels],
    };
    let settings = MotorJerkSettings { kinds, biased, relaxed: true };
    plain(ElasticModel::moved_by_jerk(Arc::new(robot()), &settings, noise, None, WrenchLaw::default()).unwrap())
}

fn moved_rows(count: usize) -> Vec<[Vec<f64>; 5]> {
    let mut rows = jerk_rows(count);
    for [_, readings, dtheta, ..] in &mut rows {
        readings.truncate(JOINTS + 2);
        readings.append(dtheta);
    }
    rows
}

#[test]
fn a_fixed_lag_is_the_smoother_up_to_now() {
    check_lag(&plain(model(true)), jerk_rows);
    check_lag(&late(), jerk_rows);
    check_lag(&elastic(), elastic_rows);
    check_lag(&moved_by_jerk(), moved_rows);
}
