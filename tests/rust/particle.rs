//! Particle filters against the Kalman filter where both are exact, and against themselves.

mod arm;

use Marginalised::{Accelerations, Biases, Nothing};
use arm::{Mounting, arm, drive};
use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::Status;
use linkside_core::estimate::kalman::{
    ExtendedKalmanFilter, FilterSettings, Inputs, JerkDriven, JerkModel, JerkNoise, KalmanRecording, Keep,
};
use linkside_core::estimate::measurement::{Evaluation, Kind};
use linkside_core::estimate::particle::{
    Collapse, Density, MOST_PARTICLES, Marginalised, ParticleFilter, ParticleOutput, ParticleSettings, Proposal,
    Resampling,
};
use linkside_core::robot::{Drive, Robot, Sensor, SoftWindup};
use linkside_core::spatial::{Mat3, Vec3};
use std::sync::Arc;

const JOINTS: usize = 3;
/// Motors, an accelerometer's two axes, a gyroscope's three axes, links, torques.
const CHANNELS: usize = 3 * JOINTS + 5;
const KINDS: &[Kind] = &[Kind::Motor, Kind::Acceleration, Kind::Rate, Kind::Link, Kind::Torque];
const DT: f64 = 1e-3;
const LINEARISED: Proposal = Proposal::Linearised { iterations: 1, tail: None };

/// Three joints, one rigid, one with everything nonlinear that a drive can have.
fn robot() -> Robot {
    let soft = Drive {
        cubic_stiffness: 3e8,
        soft_windup: SoftWindup { stiffness: 3e4, shape: 1e5 },
        link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
        ..drive()
    };
    let rigid = Drive { elastic: false, ..drive() };
    let mountings = [Mounting { body: 2, at: [0.3, 0.1, 0.2], axes: vec![0, 2], noise_std: 0.05 }];
    let mut robot = arm(vec![drive(), soft, rigid], &mountings);
    let frame = robot.tree.frame("gyroscope", 1, &Mat3::IDENTITY, &Vec3([0.1, 0.0, 0.0])).unwrap();
    robot.gyroscopes.push(Sensor { frame, axes: vec![0, 1, 2], noise_std: 0.01 });
    robot
}

fn noise() -> JerkNoise {
    JerkNoise {
        jerk: vec![20.0; JOINTS],
        link_walk: vec![0.0; 2 * JOINTS],
        reading: vec![1e-2; CHANNELS],
        torsion: 3e-3,
        bias_walk: vec![1e-4; CHANNELS],
        bias_time: vec![f64::INFINITY; CHANNELS],
        initial: [[1e-4; JOINTS], [1e-3; JOINTS], [0.1; JOINTS]].concat(),
        initial_bias: vec![1e-2; CHANNELS],
    }
}

/// Nothing is random before the second sample, and there hardly anything.
fn certain(jerk: f64) -> JerkNoise {
    let none = vec![0.0; CHANNELS];
    JerkNoise {
        jerk: vec![jerk; JOINTS],
        bias_walk: none.clone(),
        initial: vec![0.0; 9],
        initial_bias: none,
        ..noise()
    }
}

fn model(noise: JerkNoise) -> JerkDriven {
    let model = JerkModel::new(Arc::new(robot()), KINDS, &[true; CHANNELS]).unwrap();
    JerkDriven::new(model, noise, true).unwrap()
}

fn settings(particles: usize, proposal: Proposal) -> ParticleSettings {
    ParticleSettings {
        particles,
        seed: 1,
        proposal,
        resampling: Resampling::Systematic,
        threshold: 0.5,
        kernel: Some(0.5),
        densities: vec![Density::Normal; CHANNELS],
        limits: vec![(f64::NEG_INFINITY, f64::INFINITY); JOINTS],
        initial: vec![],
        collapse: Collapse::Flag, // what is tested is the cloud alone
        quantiles: vec![],
    }
}

/// Readings near rest that sway, motor velocities and jerk.
struct Signals {
    dt: Vec<f64>,
    readings: Vec<f64>,
    dtheta: Vec<f64>,
    jerk: Vec<f64>,
}

fn signals(count: usize) -> Signals {
    let wave = |i: usize, scale: f64| scale * (0.7 * i as f64).sin();
    let model = JerkModel::new(Arc::new(robot()), KINDS, &[true; CHANNELS]).unwrap();
    let mut rest = Evaluation::new(&robot(), CHANNELS);
    rest.evaluate(&robot(), model.channel_list(), &[0.0; 3 * JOINTS], &[f64::NAN; JOINTS]);
    Signals {
        dt: vec![DT; count],
        readings: (0..count * CHANNELS).map(|i| rest.prediction[i % CHANNELS] + wave(i, 1e-5)).collect(),
        dtheta: (0..count * JOINTS).map(|i| wave(i, 1e-3)).collect(),
        jerk: (0..count * JOINTS).map(|i| wave(i, 1.0)).collect(),
    }
}

impl Signals {
    fn rows(&self, from: usize, to: usize) -> KalmanRecording<'_> {
        KalmanRecording {
            dt: &self.dt[from..to],
            readings: &self.readings[from * CHANNELS..to * CHANNELS],
            inputs: Inputs {
                dtheta: &self.dtheta[from * JOINTS..to * JOINTS],
                jerk: &self.jerk[from * JOINTS..to * JOINTS],
                tau: &[],
            },
        }
    }

    fn all(&self) -> KalmanRecording<'_> {
        self.rows(0, self.dt.len())
    }
}

fn run(noise: JerkNoise, settings: ParticleSettings, marginalised: Marginalised, signals: &Signals) -> ParticleOutput {
    let mut filter = ParticleFilter::new(model(noise), settings, marginalised).unwrap();
    filter.run(signals.all(), Keep::default()).unwrap()
}

fn kalman(noise: JerkNoise, signals: &Signals) -> Vec<f64> {
    let mut filter = ExtendedKalmanFilter::new(model(noise), FilterSettings { gate: None, iterations: 1 }).unwrap();
    filter.run(signals.all(), Keep::default()).unwrap().log_likelihood
}

#[test]
fn one_particle_without_noise_finds_the_kalman_filters_likelihood() {
    let signals = signals(20);
    let expected = kalman(certain(0.0), &signals);
    for proposal in [Proposal::Bootstrap, LINEARISED] {
        for marginalised in [Nothing, Biases] {
            let found = run(certain(0.0), settings(1, proposal), marginalised, &signals).links.log_likelihood;
            for (f, e) in found.iter().zip(&expected) {
                assert!((f - e).abs() < 1e-9 * e.abs(), "{proposal:?}: {f} {e}");
            }
        }
    }
}

/// Doucet, Godsill and Andrieu (2000), section II.D: the weight of the optimal proposal is the predictive density.
#[test]
fn the_linearised_proposals_weight_does_not_depend_on_the_draw() {
    let signals = signals(2);
    let noise = certain(1e-4); // so little that every channel is linear over it, all of their derivatives at work
    let expected = kalman(JerkNoise { reading: vec![1e-5; CHANNELS], ..noise.clone() }, &signals)[1];
    let mut first = None;
    for seed in 0..10 {
        let noise = JerkNoise { reading: vec![1e-5; CHANNELS], ..noise.clone() };
        for proposal in [LINEARISED, Proposal::Linearised { iterations: 3, tail: None }] {
            let one = ParticleSettings { seed, ..settings(1, proposal) };
            let found = run(noise.clone(), one, Biases, &signals).links.log_likelihood[1];
            assert!((found / expected - 1.0).abs() < 1e-8, "{found} {expected}");
            let first = *first.get_or_insert(found);
            assert!((found / first - 1.0).abs() < 1e-10, "{found} {first}");
        }
    }
}

/// So little of everything that every channel is linear over it.
fn wandering() -> JerkNoise {
    let link_walk = [[1e-6; JOINTS], [1e-5; JOINTS]].concat();
    JerkNoise { link_walk, reading: vec![1e-5; CHANNELS], bias_walk: vec![1e-5; CHANNELS], ..certain(1e-4) }
}

/// Positions and velocities of a particle that starts with certainty are drawn; what it weighs is the readings' density
/// given the start, whichever numbers were drawn, and that is the Kalman filter's.
#[test]
fn marginalised_accelerations_leave_a_weight_that_does_not_depend_on_the_draw() {
    let signals = signals(2);
    let uncertain = JerkNoise {
        initial: [[5e-7; JOINTS], [5e-7; JOINTS], [5e-5; JOINTS]].concat(),
        initial_bias: vec![1e-5; CHANNELS],
        ..wandering()
    };
    for (noise, sample) in [(uncertain, 0), (wandering(), 1)] {
        let expected = kalman(noise.clone(), &signals)[sample];
        for seed in 0..10 {
            for iterations in [1, 3] {
                let proposal = Proposal::Linearised { iterations, tail: None };
                let one = ParticleSettings { seed, ..settings(1, proposal) };
                let found = run(noise.clone(), one, Accelerations, &signals).links.log_likelihood[sample];
                assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
            }
        }
    }
}

#[test]
fn a_bias_is_drawn_or_marginalised_with_the_same_likelihood() {
    let signals = signals(2);
    let noise = JerkNoise { bias_walk: vec![0.3; CHANNELS], ..certain(1e-3) };
    let plain = run(noise.clone(), settings(1, LINEARISED), Nothing, &signals).links.log_likelihood[1];
    let closed = run(noise.clone(), settings(1, LINEARISED), Biases, &signals).links.log_likelihood[1];
    let expected = kalman(noise, &signals)[1];
    assert!((plain / expected - 1.0).abs() < 1e-6 && (closed / expected - 1.0).abs() < 1e-6);
}

#[test]
fn neither_threads_nor_pieces_change_a_bit() {
    let signals = signals(12);
    let bits = |(marginalised, threads, split): (Marginalised, usize, usize)| {
        let wandering = JerkNoise { link_walk: vec![1e-5; 2 * JOINTS], ..noise() };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut filter = ParticleFilter::new(model(wandering), settings(3000, LINEARISED), marginalised).unwrap();
            let mut out = Vec::new();
            for (from, to) in [(0, split), (split, 12)] {
                let part = filter.run(signals.rows(from, to), Keep { covariance: true, innovations: false }).unwrap();
                out.extend(part.links.state.into_iter().chain(part.links.covariance).map(f64::to_bits));
                out.extend(part.effective.into_iter().chain(part.best).map(f64::to_bits));
            }
            out
        })
    };
    let sorted = |mut bits: Vec<u64>| {
        bits.sort_unstable();
        bits
    };
    for marginalised in [Nothing, Accelerations] {
        let one = bits((marginalised, 1, 12));
        assert!(one == bits((marginalised, 2, 12)), "two threads");
        assert!(sorted(one) == sorted(bits((marginalised, 2, 5))), "two pieces");
    }
}

#[test]
fn students_noise_of_many_degrees_is_normal_noise() {
    let signals = signals(5);
    let noise = JerkNoise { bias_walk: vec![0.0; CHANNELS], initial_bias: vec![0.0; CHANNELS], ..noise() };
    let normal = run(noise.clone(), settings(50, LINEARISED), Nothing, &signals);
    let many =
        ParticleSettings { densities: vec![Density::Student { freedom: 1e7 }; CHANNELS], ..settings(50, LINEARISED) };
    let students = run(noise, many, Nothing, &signals);
    for (a, b) in normal.links.log_likelihood.iter().zip(&students.links.log_likelihood) {
        assert!((a - b).abs() < 1e-3, "{a} {b}");
    }
}

#[test]
fn a_heavier_proposal_weighs_itself_out() {
    let signals = signals(2);
    let expected = kalman(certain(50.0), &signals)[1];
    let heavy = settings(20_000, Proposal::Linearised { iterations: 1, tail: Some(4) });
    let found = run(certain(50.0), heavy, Biases, &signals);
    assert!((found.links.log_likelihood[1] - expected).abs() < 0.05, "{:?} {expected}", found.links.log_likelihood);
    assert!(found.effective[1] < 19_000.0);
}

#[test]
fn impossible_readings_stop_or_are_passed_over() {
    let signals = signals(6);
    let limits = vec![(50.0, 60.0); JOINTS];
    let bounded = |collapse| ParticleSettings { collapse, limits: limits.clone(), ..settings(200, LINEARISED) };
    let mut filter = ParticleFilter::new(model(noise()), bounded(Collapse::Stop), Nothing).unwrap();
    assert_eq!(filter.run(signals.all(), Keep::default()).unwrap_err(), RunError::Impossible { sample: 0 });
    for marginalised in [Nothing, Biases, Accelerations] {
        for collapse in [Collapse::Flag, Collapse::Reseed] {
            let out = run(noise(), bounded(collapse), marginalised, &signals);
            let flags = Status::PREDICTED | Status::CONTRADICTED;
            assert!(out.links.status.iter().all(|s| s & flags == flags), "{:?}", out.links.status);
            assert!(out.links.used.iter().all(|&used| used == 0));
            assert!(out.links.q.iter().all(|q| q.is_finite()));
        }
    }
}

#[test]
fn particles_beyond_limits_have_no_weight() {
    let signals = signals(30);
    let free = run(noise(), settings(500, LINEARISED), Biases, &signals);
    let highest = free.links.q.iter().step_by(JOINTS).fold(f64::NEG_INFINITY, |a, &b| a.max(b));
    let mut limits = vec![(f64::NEG_INFINITY, f64::INFINITY); JOINTS];
    limits[0].1 = highest - 1e-5;
    let limit = limits[0].1;
    let bounded =
        run(noise(), ParticleSettings { limits, kernel: None, ..settings(500, LINEARISED) }, Biases, &signals);
    assert!(bounded.links.q.iter().step_by(JOINTS).all(|&q| q <= limit));
    assert!(bounded.best.iter().step_by(JOINTS).all(|&q| q <= limit));
}

#[test]
fn settings_out_of_range_are_named() {
    let refused = |change: &dyn Fn(&mut ParticleSettings), marginalised| {
        let mut s = settings(10, LINEARISED);
        change(&mut s);
        match ParticleFilter::new(model(noise()), s, marginalised).unwrap_err() {
            DesignError::Range { what, .. } | DesignError::Length { what, .. } => what,
            other => panic!("{other}"),
        }
    };
    type Case<'a> = (&'a str, &'a dyn Fn(&mut ParticleSettings));
    let cases: [Case<'_>; 16] = [
        ("particles", &|s| s.particles = 0),
        ("particles", &|s| s.particles = MOST_PARTICLES + 1),
        ("threshold", &|s| s.threshold = 1.5),
        ("kernel", &|s| s.kernel = Some(0.0)),
        ("iterations", &|s| s.proposal = Proposal::Linearised { iterations: 0, tail: None }),
        ("proposal_tail", &|s| s.proposal = Proposal::Linearised { iterations: 1, tail: Some(3) }),
        ("densities", &|s| s.densities.truncate(2)),
        ("outliers", &|s| s.densities[0] = Density::Student { freedom: 0.5 }),
        ("outliers", &|s| s.densities[0] = Density::Mixture { share: 1.0, scale: 50.0 }),
        ("outliers", &|s| s.densities[0] = Density::Mixture { share: 0.02, scale: 1.0 }),
        ("limits", &|s| s.limits.truncate(1)),
        ("limits", &|s| s.limits[0] = (1.0, 1.0)),
        ("initial", &|s| s.initial = vec![0.0; 4]),
        ("initial", &|s| s.initial = vec![f64::NAN; 3]),
        ("quantiles", &|s| s.quantiles = vec![1.0]),
        ("threshold", &|s| s.threshold = f64::NAN),
    ];
    for (what, change) in cases {
        assert_eq!(refused(change, Nothing), what);
    }
    assert_eq!(refused(&|s| s.densities[0] = Density::Student { freedom: 4.0 }, Biases), "outliers");
    let channels = CHANNELS + JOINTS;
    let kinds = [KINDS, &[Kind::MotorVelocity]].concat();
    let model = JerkModel::new(Arc::new(robot()), &kinds, &vec![true; channels]).unwrap();
    let none = vec![0.0; channels];
    let bias_time = vec![f64::INFINITY; channels];
    let noise =
        JerkNoise { reading: vec![1.0; channels], bias_walk: none.clone(), bias_time, initial_bias: none, ..noise() };
    let model = JerkDriven::new(model, noise, true).unwrap();
    let error = ParticleFilter::new(model, settings(10, LINEARISED), Nothing).unwrap_err();
    assert!(matches!(error, DesignError::Range { what: "motor_velocities", .. }));
}
