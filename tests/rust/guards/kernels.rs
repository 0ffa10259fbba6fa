//! What is counted: the work of a sample, on arms of two and of six joints.

use crate::arm::{Mounting, arm, drive};
use crate::count::{LENGTHS, counted_work};
use core::hint::black_box;
use linkside_core::control::{JointPd, Reference, feedforward};
use linkside_core::dynamics::{Batch, DrivenStates, States};
use linkside_core::estimate::kalman::{
    Discretization, ElasticModel, ElasticNoise, ElasticSettings, ExtendedKalmanFilter, FilterSettings, Inputs,
    JerkDriven, JerkModel, JerkNoise, KalmanRecording, KalmanSample, Keep, Model, Smoother,
};
use linkside_core::estimate::likelihood::{Likelihood, LikelihoodRecording, LikelihoodSettings, Parameter};
use linkside_core::estimate::measurement::{Channel, Kind};
use linkside_core::estimate::observer::{
    AccelerationObserver, AccelerationSource, Complex, Form, ObserverSample, ObserverSettings, Start,
};
use linkside_core::estimate::particle::{
    Collapse, Density, Marginalised, ParticleFilter, ParticleSettings, Proposal, Resampling,
};
use linkside_core::estimate::velocity::{Gains, VelocityObserver, VelocitySettings};
use linkside_core::robot::Robot;
use linkside_core::simulate::{Outside, Plan, SensorModel, SimulationStart, Stepping, Suite, TrueState, simulate};
use std::sync::Arc;

/// Sampling period [s].
const PERIOD: f64 = 1e-3;

/// Rows of every signal: a first run of [`FIRST`] samples, and those that are counted.
const ROWS: usize = FIRST + LENGTHS[0] + LENGTHS[1];
const FIRST: usize = 3;

const PARTICLES: usize = 256;

/// Does a number of samples.
type Work = Box<dyn FnMut(usize)>;

/// What a kernel is called, and what makes its work.
type Guarded = (&'static str, fn() -> Work);

const KERNELS: [Guarded; 17] = [
    ("EKF step, two joints", || jerk_filter(2)),
    ("EKF step, six joints", || jerk_filter(6)),
    ("elastic EKF step, six joints", elastic_filter),
    ("smoother, two joints", || smoother(2)),
    ("smoother, six joints", || smoother(6)),
    ("likelihood, two joints", likelihood),
    ("observer step, six joints", observer),
    ("reduced-order observer step, six joints", velocity_observer),
    ("particle step, bootstrap, two joints", || particles(Proposal::Bootstrap)),
    ("particle step, linearised, two joints", || particles(Proposal::Linearised { iterations: 1, tail: None })),
    ("simulator step, six joints", simulator),
    ("inverse dynamics, six joints", || batch(6, |batch, states, out| batch.inverse_dynamics(states, out))),
    ("inverse dynamics' derivatives, six joints", || {
        batch(108, |batch, states, out| batch.inverse_dynamics_derivatives(states, out))
    }),
    ("mass matrix, six joints", || batch(36, |batch, states, out| batch.mass_matrix(states.q, out))),
    ("specific force, six joints", || batch(9, |batch, states, out| batch.specific_force(states, out))),
    ("elastic forward dynamics, six joints", forward_dynamics),
    ("feedforward, six joints", feedforward_torques),
];

/// The names alone, in order.
pub(crate) fn names() -> Vec<&'static str> {
    KERNELS.iter().map(|(name, _)| *name).collect()
}

/// Does everything that is to be counted.
pub(crate) fn run() {
    for (_, make) in KERNELS {
        let mut work = make();
        work(FIRST); // what is done but once in a process, and a filter's first sample
        LENGTHS.into_iter().for_each(|samples| counted_work(&mut *work, samples));
    }
}

/// Two joints with one sensor, or six with three.
fn robot(joints: usize) -> Arc<Robot> {
    let sensor = |body| Mounting { body, at: [0.3, 0.1, 0.2], axes: vec![0, 1, 2], noise_std: 0.05 };
    let bodies: &[usize] = if joints == 2 { &[1] } else { &[2, 4, 5] };
    Arc::new(arm(vec![drive(); joints], &bodies.iter().map(|&body| sensor(body)).collect::<Vec<_>>()))
}

/// Rows that move as motions do, each entry at a frequency of its own: as many as all runs of a kernel take.
fn wave(width: usize, size: f64) -> Vec<f64> {
    let entry = |row: usize, i: usize| size * (0.02 * (1.0 + 0.1 * i as f64) * row as f64 + i as f64).sin();
    (0..ROWS).flat_map(|row| (0..width).map(move |i| entry(row, i))).collect()
}

/// Of sensors near rest, whose z axes are up.
fn accelerations(width: usize) -> Vec<f64> {
    let mut rows = wave(width, 0.1);
    rows.iter_mut().skip(2).step_by(3).for_each(|z| *z += 9.81);
    rows
}

/// `step` of one row after the other.
fn stepping(mut step: impl FnMut(usize) + 'static) -> Work {
    let mut row = 0;
    Box::new(move |samples| {
        (row..row + samples).for_each(&mut step);
        row += samples;
    })
}

/// The rows of one sample.
fn row(all: &[f64], width: usize, i: usize) -> &[f64] {
    &all[i * width..][..width]
}

/// Motor positions and accelerations, row by row.
fn readings(n: usize, sensed: usize) -> Vec<f64> {
    let (theta, acceleration) = (wave(n, 1e-3), accelerations(sensed));
    (0..ROWS).flat_map(|i| [row(&theta, n, i), row(&acceleration, sensed, i)].concat()).collect()
}

/// Links driven by white jerk, with a bias of each channel.
fn jerk_driven(n: usize, link_walk: f64) -> JerkDriven {
    let robot = robot(n);
    let channels = n + robot.acceleration_channels();
    let model = JerkModel::new(robot, &[Kind::Motor, Kind::Acceleration], &vec![true; channels]).unwrap();
    JerkDriven::new(model, jerk_noise(n, channels, link_walk), true).unwrap()
}

fn jerk_noise(n: usize, channels: usize, link_walk: f64) -> JerkNoise {
    JerkNoise {
        jerk: vec![20.0; n],
        link_walk: vec![link_walk; 2 * n],
        reading: [vec![1e-3; n], vec![0.5; channels - n]].concat(),
        torsion: 1e-3,
        bias_walk: vec![1e-6; channels],
        bias_time: vec![50.0; channels],
        initial: vec![1e-3; 3 * n],
        initial_bias: vec![1e-4; channels],
    }
}

fn plain(n: usize) -> ExtendedKalmanFilter<JerkDriven> {
    ExtendedKalmanFilter::new(jerk_driven(n, 0.0), FilterSettings { gate: None, iterations: 1 }).unwrap()
}

fn jerk_filter(n: usize) -> Work {
    let mut filter = plain(n);
    let width = filter.model().channels();
    let (readings, dtheta, jerk) = (readings(n, width - n), wave(n, 0.02), wave(n, 0.5));
    stepping(move |i| {
        let inputs = Inputs { dtheta: row(&dtheta, n, i), jerk: row(&jerk, n, i), tau: &[] };
        filter.step(KalmanSample { dt: PERIOD, readings: row(&readings, width, i), inputs }).unwrap();
    })
}

fn smoother(n: usize) -> Work {
    let filter = plain(n);
    let width = filter.model().channels();
    let (readings, dtheta, jerk) = (readings(n, width - n), wave(n, 0.02), wave(n, 0.5));
    Box::new(move |samples| {
        let inputs = Inputs { dtheta: &dtheta[..samples * n], jerk: &jerk[..samples * n], tau: &[] };
        let recording =
            KalmanRecording { dt: &[PERIOD; ROWS][..samples], readings: &readings[..samples * width], inputs };
        black_box(Smoother::new(&filter).run(recording, Keep::default()).unwrap());
    })
}

/// Links and motors driven by measured torques, with disturbances and biases.
fn elastic_filter() -> Work {
    const N: usize = 6;
    let robot = robot(N);
    let channels = N + robot.acceleration_channels();
    let settings = ElasticSettings {
        kinds: vec![Kind::Motor, Kind::Acceleration],
        disturbances: true,
        biased: [vec![false; N], vec![true; channels - N]].concat(),
        held: true,
        discretization: Discretization::Exact,
        relaxed: true,
    };
    let noise = ElasticNoise {
        link: vec![3e-3; N],
        motor: vec![1e-2; N],
        torque: vec![2.0; N],
        disturbance_walk: vec![1.0; N],
        reading: [vec![1e-5; N], vec![0.05; channels - N]].concat(),
        torque_walk: vec![10.0; N],
        bias_walk: vec![1e-3; channels],
        bias_time: vec![50.0; channels],
        initial: vec![1e-2; 3 * N],
        initial_bias: vec![1e-2; channels],
    };
    let model = ElasticModel::new(robot, &settings, noise).unwrap();
    let mut filter = ExtendedKalmanFilter::new(model, FilterSettings { gate: None, iterations: 1 }).unwrap();
    let (readings, tau) = (readings(N, channels - N), wave(N, 5.0));
    stepping(move |i| {
        let inputs = Inputs { tau: row(&tau, N, i), ..Inputs::default() };
        filter.step(KalmanSample { dt: PERIOD, readings: row(&readings, channels, i), inputs }).unwrap();
    })
}

/// The log-likelihood.
fn likelihood() -> Work {
    const N: usize = 2;
    let robot = robot(N);
    let sensed = robot.acceleration_channels();
    let channels = N + sensed;
    let parameters =
        [Parameter::Stiffness(0), Parameter::Damping(1), Parameter::MassScale(1), Parameter::SensorBias(0, 0)];
    let settings = LikelihoodSettings {
        noise: jerk_noise(N, channels, 0.0),
        biased: vec![true; channels],
        fixed: vec![],
        huber: f64::INFINITY,
    };
    Box::new(move |samples| {
        let first = |width, rows: Vec<f64>| rows[..samples * width].to_vec();
        let recording = LikelihoodRecording {
            t: (0..samples).map(|i| PERIOD * i as f64).collect(),
            theta: first(N, wave(N, 1e-3)),
            dtheta: first(N, wave(N, 0.02)),
            acceleration: first(sensed, accelerations(sensed)),
            jerk: first(N, wave(N, 0.5)),
            period: PERIOD,
        };
        let likelihood = Likelihood::new(Arc::clone(&robot), settings.clone(), recording).unwrap();
        black_box(likelihood.log_likelihood(&parameters, &[1.1e5, 70.0, 1.1, 0.1]).unwrap());
    })
}

fn observer() -> Work {
    const N: usize = 6;
    let robot = robot(N);
    let sensed = robot.acceleration_channels();
    let poles: Vec<_> = [-200.0, -210.0, -220.0, -230.0].map(|pole| Complex::new(pole, 0.0)).into();
    let settings = ObserverSettings {
        period: PERIOD,
        poles: vec![poles; N],
        bias: false,
        form: Form::Current,
        source: AccelerationSource::Sensors,
        worst_acceleration_std: 10.0,
        start: Start::Rest,
    };
    let mut observer = AccelerationObserver::new(robot, settings).unwrap();
    let (theta, tau, acceleration) = (wave(N, 1e-3), wave(N, 5.0), accelerations(sensed));
    stepping(move |i| {
        let [theta, tau] = [&theta, &tau].map(|signal| row(signal, N, i));
        observer.step(ObserverSample { theta, tau, acceleration: row(&acceleration, sensed, i) }).unwrap();
    })
}

fn velocity_observer() -> Work {
    const N: usize = 6;
    let settings = VelocitySettings {
        period: PERIOD,
        gains: Gains::Constant(vec![100.0; N]),
        spring: vec![0.0; N],
        motors: true,
        start: Start::Rest,
        wrap: vec![core::f64::consts::TAU; N],
    };
    let mut observer = VelocityObserver::new(robot(N), settings).unwrap();
    let (q, torque) = (wave(N, 0.5), wave(N, 5.0));
    stepping(move |i| observer.step(row(&q, N, i), row(&torque, N, i)).unwrap())
}

fn particles(proposal: Proposal) -> Work {
    const N: usize = 2;
    let model = jerk_driven(N, 1e-4);
    let channels = N + robot(N).acceleration_channels();
    let settings = ParticleSettings {
        particles: PARTICLES,
        seed: 0,
        proposal,
        resampling: Resampling::Systematic,
        threshold: 1.0, // at every step
        kernel: None,
        densities: vec![Density::Normal; channels],
        limits: vec![(-3.0, 3.0); N],
        initial: vec![],
        collapse: Collapse::Stop,
        quantiles: vec![],
    };
    let mut filter = ParticleFilter::new(model, settings, Marginalised::Nothing).unwrap();
    let (readings, dtheta, jerk) = (readings(N, channels - N), wave(N, 0.02), wave(N, 0.5));
    stepping(move |i| {
        let inputs = Inputs { dtheta: row(&dtheta, N, i), jerk: row(&jerk, N, i), tau: &[] };
        filter.step(KalmanSample { dt: PERIOD, readings: row(&readings, channels, i), inputs }).unwrap();
    })
}

/// The loop of sensing, control and one step of Runge and Kutta.
fn simulator() -> Work {
    const N: usize = 6;
    let robot = robot(N);
    let model = |noise| SensorModel {
        noise,
        bias: 0.0,
        resolution: 1e-6,
        delay: 0.0,
        corner_frequency: f64::INFINITY,
        every: 1,
    };
    let noise = |channel: &Channel| if matches!(channel, Channel::Acceleration { .. }) { 0.05 } else { 0.0 };
    let models: Vec<_> =
        Kind::all_channels(Kind::SENSORS, &robot).iter().map(|channel| model(noise(channel))).collect();
    Box::new(move |samples| {
        let reference = Reference::new(vec![0.0], vec![0.1; N], N).unwrap();
        let mut law = JointPd::new(reference, vec![2000.0; N], vec![200.0; N], vec![0.0; N]).unwrap();
        let suite = Suite::new(&robot, &models, 2.5e-4, 0).unwrap();
        let plan = Plan { period: 2.5e-4, count: samples, stepping: Stepping::Fixed(1), keep_every: 1 };
        let (start, outside) = (SimulationStart::default(), Outside::default());
        black_box(simulate(&robot, start, plan, outside, suite, &mut TrueState, &mut law).unwrap());
    })
}

/// A function of arrays of states that gives `width` numbers a sample.
fn batch(width: usize, f: impl Fn(&mut Batch, States<'_>, &mut [f64]) + 'static) -> Work {
    const N: usize = 6;
    let (robot, states) = (robot(N), [1.0, 2.0, 3.0].map(|size| wave(N, size)));
    let mut out = vec![0.0; ROWS * width];
    Box::new(move |samples| {
        let [q, dq, ddq] = states.each_ref().map(|signal| &signal[..samples * N]);
        f(&mut Batch::new(Arc::clone(&robot)), States { q, dq, ddq }, &mut out[..samples * width]);
        black_box(&out);
    })
}

fn forward_dynamics() -> Work {
    const N: usize = 6;
    let (robot, signals) = (robot(N), [1.0, 2.0, 1.001, 2.0, 5.0].map(|size| wave(N, size)));
    let mut out = vec![0.0; ROWS * 2 * N];
    Box::new(move |samples| {
        let [q, dq, theta, dtheta, tau] = signals.each_ref().map(|signal| &signal[..samples * N]);
        let states = DrivenStates { q, dq, theta, dtheta, tau };
        Batch::new(Arc::clone(&robot)).forward_dynamics(states, &mut out[..samples * 2 * N]);
        black_box(&out);
    })
}

fn feedforward_torques() -> Work {
    const N: usize = 6;
    let robot = robot(N);
    let derivatives = [0.5, 0.1, 0.5, 2.0].map(|size| wave(N, size));
    Box::new(move |samples| {
        let t: Vec<_> = (0..samples).map(|i| PERIOD * i as f64).collect();
        let derivatives = derivatives.each_ref().map(|signal| &signal[..samples * N]).concat();
        let path = feedforward::Path { t: &t, derivatives: &derivatives };
        black_box(feedforward::inverse_dynamics(&robot, path).unwrap());
    })
}
