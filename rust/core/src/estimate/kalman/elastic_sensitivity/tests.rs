//! What parameters do, by robots that differ.

use super::*;
use crate::estimate::kalman::{
    Discretization, ElasticModel, ElasticNoise, ElasticSettings, Gaussian, Inputs, KalmanSample, Measurement, Model,
    MotorJerkNoise, MotorJerkSettings, Process, WrenchLaw,
};
use crate::estimate::measurement::Kind;
use crate::robot::{BodySpec, Drive, Frame, Friction, JointKind, LoadFriction, Rotor, Sensor, SoftWindup, Tree};
use crate::spatial::{Mat3, Vec3};
use Uncertain as U;
use std::sync::Arc;

const N: usize = 4;
const TAU: [f64; N] = [5.0, -3.0, 2.0, 1.0];

/// Four joints, one of them sliding, one rigid, with everything nonlinear; `parameter` is off by `error`. Motors are
/// coupled to links, or links carry those of the last two joints.
fn robot(carried: bool, parameter: Uncertain, error: f64) -> Robot {
    let log = |p: Uncertain| if p == parameter { error.exp() } else { 1.0 };
    let share = |j: usize, [driving, driven]: [f64; 2]| {
        if j == 2 { LoadFriction::default() } else { LoadFriction { driving, driven, rounding: 0.1 } }
    };
    let drive = |j: usize| Drive {
        elastic: j != 2,
        cubic_stiffness: 3e3 * log(U::Stiffness(j)) + if parameter == U::CubicStiffness(j) { error } else { 0.0 },
        soft_windup: SoftWindup { stiffness: 120.0 * log(U::Stiffness(j)), shape: 80.0 },
        motor_friction: Friction {
            viscous: 0.4 * log(U::MotorFriction(j)),
            coulomb: 0.1 * log(U::MotorFriction(j)),
            ..Friction::default()
        },
        gear_loss: share(j, [0.3, 0.2].map(|mu| mu * log(U::MotorFriction(j)))),
        bearing_loss: share(j, [0.1 * log(U::LinkFriction(j)); 2]),
        link_friction: {
            let share = log(U::LinkFriction(j));
            [0.5 * share, 1.5, 0.5, 0.2 * share, 1.0, 0.5 * share]
        },
        ..Drive::spring(500.0 * log(U::Stiffness(j)), 2.0 * log(U::Damping(j)), 3.0 * log(U::MotorInertia(j)))
    };
    let body = |j: usize| BodySpec {
        parent: j.checked_sub(1),
        joint: j,
        kind: if j == 2 { JointKind::Prismatic } else { JointKind::Revolute },
        rotation: Mat3::IDENTITY,
        translation: Vec3([0.4, 0.1, 0.0]),
        axis: Vec3(if j.is_multiple_of(2) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] }),
        mass: 2.0 * log(U::Mass(j)),
        com: Vec3([0.2, 0.1, 0.0]),
        inertia: Mat3::from_rows(
            [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.15]].map(|row: [f64; 3]| row.map(|x| x * log(U::Mass(j)))),
        ),
    };
    let tree = Tree::new(Vec3([1.0, 0.0, -9.0]), &[0, 1, 2, 3].map(body)).unwrap();
    let (s, c) = if parameter == U::Rotation(0, 1) { error.sin_cos() } else { (0.0, 1.0) };
    let moved = if parameter == U::Translation(0, 2) { error } else { 0.0 };
    let frame = Frame {
        body: 3,
        rotation: Mat3::from_rows([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]),
        translation: Vec3([0.1, -0.2, 0.05 + moved]),
    };
    let sensor = Sensor { frame, axes: vec![2, 0], noise_std: 0.1 };
    let mut coupling = vec![0.0; N * N];
    coupling[1] = 0.2;
    let mut rotors = vec![];
    if carried {
        let axis = Vec3([0.6, 0.0, 0.8]);
        rotors = vec![Rotor { motor: 2, body: 1, axis, ratio: 4.0 }, Rotor { motor: 3, body: 2, axis, ratio: -3.0 }];
    } else {
        (coupling[3], coupling[7], coupling[2], coupling[6]) = (0.1, -0.1, 0.05, 0.3);
    }
    let robot = Robot::new(tree, [0, 1, 2, 3].map(drive).to_vec(), coupling, vec![sensor], vec![], None);
    robot.unwrap().with_rotors(rotors).unwrap()
}

fn parameters() -> Vec<Tolerance> {
    let mut all = vec![U::Rotation(0, 1), U::Translation(0, 2), U::Scale(0, 2), U::EncoderZero(1), U::EncoderZero(2)];
    for j in 0..N {
        all.extend([U::Mass(j), U::LinkFriction(j), U::MotorFriction(j), U::TorqueConstant(j), U::MotorInertia(j)]);
        if j != 2 {
            all.extend([U::Stiffness(j), U::CubicStiffness(j), U::Damping(j)]);
        }
    }
    all.into_iter().map(|parameter| Tolerance { parameter, std: 1.0 }).collect()
}

fn model(robot: Robot) -> ElasticModel {
    let channels = 4 * N + 2;
    let [link, motor, torque, walk, missing] = core::array::from_fn(|_| vec![1e-3; N]);
    let noise = ElasticNoise {
        link,
        motor,
        torque,
        disturbance_walk: walk,
        torque_walk: missing,
        reading: vec![1e-3; channels],
        bias_walk: vec![0.0; channels],
        bias_time: vec![f64::INFINITY; channels],
        initial: vec![1e-3; 3 * N],
        initial_bias: vec![0.0; channels],
    };
    let settings = ElasticSettings {
        kinds: vec![Kind::Motor, Kind::Acceleration, Kind::MotorVelocity, Kind::Link, Kind::Torque],
        disturbances: true,
        biased: vec![false; channels],
        held: true,
        discretization: Discretization::Exact,
        relaxed: false,
    };
    ElasticModel::new(Arc::new(robot), &settings, noise).unwrap()
}

fn state() -> Vec<f64> {
    (0..18).map(|i| 0.3 * (1.7 * f64::from(i)).sin()).collect()
}

fn torques(parameter: Uncertain, error: f64) -> Vec<f64> {
    let one = |j| TAU[j] * if parameter == U::TorqueConstant(j) { error.exp() } else { 1.0 };
    (0..N).map(one).collect()
}

/// Central differences between robots that are truly different, of order four.
fn slope(parameter: Uncertain, of: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    let h = if matches!(parameter, U::CubicStiffness(_)) { 20.0 } else { 1e-2 };
    let [a, b, c, d] = [-2.0, -1.0, 1.0, 2.0].map(|k| of(k * h));
    (0..a.len()).map(|i| (8.0 * (c[i] - b[i]) - (d[i] - a[i])) / (12.0 * h)).collect()
}

fn near(ours: f64, theirs: f64, scale: f64, tolerance: f64, what: &impl core::fmt::Debug) {
    assert!((ours - theirs).abs() <= tolerance * scale, "{what:?}: {ours} {theirs}");
}

#[test]
fn readings_and_accelerations_are_those_of_robots_that_differ() {
    [false, true].into_iter().for_each(differ);
}

fn differ(carried: bool) {
    let tolerances = parameters();
    let mut ours = model(robot(carried, U::Mass(9), 0.0)).with_tolerances(tolerances.clone());
    let (x, tau) = (state(), torques(U::Mass(9), 0.0));
    let m = ours.channels();
    let readings = vec![0.0; m];
    fn sample<'a>(readings: &'a [f64], tau: &'a [f64]) -> KalmanSample<'a> {
        KalmanSample { dt: 1e-3, readings, inputs: Inputs { tau, ..Inputs::default() } }
    }
    let measured = ours.measurement_mut();
    measured.take(&sample(&readings, &tau), true);
    measured.linearise(&x);
    let stride = tolerances.len().next_multiple_of(linear::LANES);
    let mut n = vec![0.0; m * stride];
    measured.signatures(stride, &mut n);
    let sensitivity = measured.sensitivity.clone();
    for (column, &Tolerance { parameter, .. }) in tolerances.iter().enumerate() {
        let by = slope(parameter, |error| {
            let (robot, tau) = (robot(carried, parameter, error), torques(parameter, error));
            let layout = ElasticLayout::new(&robot, true);
            let mut dynamics = ElasticDynamics::new(&robot, &layout);
            dynamics.accelerate(&robot, &layout, &x, &tau);
            let mut model = model(robot);
            model.measurement_mut().take(&sample(&readings, &tau), true);
            let mut read = model.measurement_mut().evaluate(&x).to_vec();
            if parameter == U::Scale(0, 2) {
                read[N] *= error.exp();
            }
            if let U::EncoderZero(j) = parameter {
                read[j] += error;
            }
            [dynamics.ddq.clone(), dynamics.ddtheta.clone(), read].concat()
        });
        let scale = by.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        assert!(scale > 0.0, "{parameter:?}");
        for j in 0..N {
            near(sensitivity.links[j * stride + column], by[j], scale, 1e-8, &parameter);
            if j != 2 {
                near(sensitivity.motors[j * stride + column], by[N + j], scale, 1e-8, &parameter);
            }
        }
        for i in 0..m {
            near(n[i * stride + column], by[2 * N + i], scale, 1e-8, &(parameter, i));
        }
    }
}

/// The same of motors that jerk moves, and of the torques that they need.
#[test]
fn readings_and_torques_where_jerk_moves_motors_are_those_of_robots_that_differ() {
    for carried in [false, true] {
        let tolerances = parameters();
        let mut ours = moved_by_jerk(robot(carried, U::Mass(9), 0.0)).with_tolerances(tolerances.clone());
        let (x, m) = (state(), ours.channels());
        let measured = ours.measurement_mut();
        measured.linearise(&x);
        let stride = tolerances.len().next_multiple_of(linear::LANES);
        let mut n = vec![0.0; m * stride];
        measured.signatures(stride, &mut n);
        for (column, &Tolerance { parameter, .. }) in tolerances.iter().enumerate() {
            let by = slope(parameter, |error| {
                let mut read = moved_by_jerk(robot(carried, parameter, error));
                let mut read = read.measurement_mut().evaluate(&x).to_vec();
                match parameter {
                    U::Scale(0, 2) => read[N] *= error.exp(),
                    U::EncoderZero(j) => read[j] += error,
                    // What is read is less than what is there.
                    U::TorqueConstant(j) => read[m - N + j] *= (-error).exp(),
                    _ => {}
                }
                read
            });
            let scale = by.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            assert!(scale > 0.0, "{parameter:?}");
            for i in 0..m {
                near(n[i * stride + column], by[i], scale, 1e-8, &(parameter, i));
            }
        }
        let (linearised, d) = (measured.linearised().jacobian.to_vec(), x.len());
        for k in 0..d {
            let [less, more] = [-1e-6, 1e-6].map(|h| {
                let mut at = x.clone();
                at[k] += h;
                ours.measurement_mut().evaluate(&at).to_vec()
            });
            for i in 0..m {
                let (by, own) = ((more[i] - less[i]) / 2e-6, linearised[i * d + k]);
                near(own, by, 1.0 + by.abs(), 1e-6, &(i, k));
            }
        }
    }
}

fn moved_by_jerk(robot: Robot) -> ElasticModel {
    let channels = 5 * N + 2;
    let noise = MotorJerkNoise {
        jerk: vec![1e-3; N],
        link: vec![1e-3; N],
        reading: vec![1e-3; channels],
        bias_walk: vec![0.0; channels],
        bias_time: vec![f64::INFINITY; channels],
        initial: vec![1e-3; 3 * N],
        initial_bias: vec![0.0; channels],
    };
    let sensors = [Kind::Motor, Kind::Acceleration, Kind::MotorVelocity, Kind::Link, Kind::Torque];
    let settings = MotorJerkSettings {
        kinds: [&sensors[..], &[Kind::MotorTorque]].concat(),
        biased: vec![false; channels],
        relaxed: false,
    };
    ElasticModel::moved_by_jerk(Arc::new(robot), &settings, noise, None, WrenchLaw::default()).unwrap()
}

/// What a torque's noise does to readings, by torques that differ: each channel's variance is no less than its own and
/// that, and of all channels together in any combination as well.
#[test]
fn readings_hear_the_noise_of_torques() {
    let mut ours = model(robot(false, U::Mass(9), 0.0));
    let m = ours.channels();
    let readings = vec![0.0; m];
    let mut read = |tau: &[f64]| {
        let sample = KalmanSample { dt: 1e-3, readings: &readings, inputs: Inputs { tau, ..Inputs::default() } };
        let measured = ours.measurement_mut();
        measured.take(&sample, true);
        measured.linearise(&state());
        let variances: Vec<f64> = (0..m).map(|i| measured.variance(i)).collect();
        (measured.linearised().prediction.to_vec(), variances)
    };
    let (_, variances) = read(&TAU);
    let by: Vec<Vec<f64>> = (0..N)
        .map(|j| {
            let [less, more] = [-1.0, 1.0].map(|by| {
                let mut tau = TAU;
                tau[j] += by;
                read(&tau).0
            });
            more.iter().zip(&less).map(|(a, b)| 0.5 * (a - b)).collect()
        })
        .collect();
    let own = 1e-6; // of a reading and of a torque alike
    for i in 0..m {
        let heard: f64 = by.iter().map(|g| g[i].abs() * g.iter().map(|g| g.abs()).sum::<f64>()).sum();
        near(variances[i], own * (1.0 + heard), own * (1.0 + heard), 1e-9, &i);
    }
    let heard = |j: usize| by[j].iter().any(|g| g.abs() > 1e-6);
    assert!(heard(2) && by[2][N..N + 2].iter().all(|g| g.abs() > 1e-3)); // the rigid one, by both axes
    for seed in 0..50_u32 {
        let x: Vec<f64> = (0..m).map(|i| f64::from(seed * 7 + i as u32 * 13).sin()).collect();
        let along = |g: &Vec<f64>| g.iter().zip(&x).map(|(g, x)| g * x).sum::<f64>();
        let true_one: f64 = own * (linear::dot(&x, &x) + by.iter().map(|g| along(g).powi(2)).sum::<f64>());
        let ours: f64 = variances.iter().zip(&x).map(|(v, x)| v * x * x).sum();
        assert!(ours >= true_one * (1.0 - 1e-9));
    }
}

/// Ψ as the model has it, and by robots that differ: the largest difference of each.
fn step_error(dt: f64) -> Vec<f64> {
    let tolerances = parameters();
    let stride = tolerances.len().next_multiple_of(linear::LANES);
    let x = state();
    let moved = |parameter: Uncertain, error: f64| {
        let mut model = model(robot(false, parameter, error)).with_tolerances(tolerances.clone());
        let (tau, readings) = (torques(parameter, error), vec![f64::NAN; model.channels()]);
        let sample = KalmanSample { dt, readings: &readings, inputs: Inputs { tau: &tau, ..Inputs::default() } };
        let mut belief = Gaussian::independent(&[0.0; 18]);
        belief.mean.copy_from_slice(&x);
        model.resume(&sample, &mut belief);
        Model::predict(&mut model, &sample, &mut belief);
        (model, belief.mean)
    };
    let (mut ours, _) = moved(U::Mass(9), 0.0);
    let mut columns = vec![0.0; 18 * stride];
    ours.process.drive(&mut columns, stride);
    let of = |(column, t): (usize, &Tolerance)| {
        let by = slope(t.parameter, |error| moved(t.parameter, error).1);
        let scale = by.iter().fold(1e-300_f64, |most, x| most.max(x.abs()));
        by.iter().enumerate().map(|(i, x)| (columns[i * stride + column] - x).abs() / scale).fold(0.0, f64::max)
    };
    tolerances.iter().enumerate().map(of).collect()
}

/// The rate is taken in the middle of the step: the error falls faster than the step.
#[test]
fn a_step_is_that_of_robots_that_differ() {
    let errors = [1e-3, 2.5e-5].map(step_error);
    for (i, t) in parameters().iter().enumerate() {
        let [short, least] = [0, 1].map(|k| errors[k][i]);
        assert!(short < 0.01 && least < 1e-5, "{:?}: {short} {least}", t.parameter);
    }
}
