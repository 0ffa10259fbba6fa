//! Whole arrays at once: one row a sample, row-major. Eight samples go through a kernel together, and each has the bits that
//! it would have alone.

mod answers;

use crate::interrupt::Watch;
use crate::robot::{Drive, Robot};
use crate::scalar::{Lanes, Scalar};
use crate::simd::{self, Kernel};
use answers::{
    Accelerations, AngularRate, Answer, CoriolisMatrix, MassMatrix, Room, SpecificForce, SpecificForceDerivatives,
    ToolPosition, Torque, TorqueDerivatives, WrenchMap,
};
use core::marker::PhantomData;
use std::sync::Arc;

/// The most that an answer takes.
const MOST_SIGNALS: usize = 5;

/// Samples side by side.
const WIDE: usize = 8;
type Wide = Lanes<WIDE>;

/// Dynamics and sensor models of a robot over many samples; each output row is that sample's, flattened row-major.
#[derive(Debug)]
pub struct Batch {
    robot: Arc<Robot>,
    /// For one sample.
    one: Room<f64>,
    /// For eight; made when there are as many.
    wide: Option<Box<SampleBlock>>,
}

/// A state of the links, one row a sample, n columns.
#[derive(Clone, Copy, Debug)]
pub struct States<'a> {
    /// q.
    pub q: &'a [f64],
    /// q̇.
    pub dq: &'a [f64],
    /// q̈.
    pub ddq: &'a [f64],
}

/// A state of links and motors with the motors' torque, one row a sample, n columns.
#[derive(Clone, Copy, Debug)]
pub struct DrivenStates<'a> {
    /// q.
    pub q: &'a [f64],
    /// q̇.
    pub dq: &'a [f64],
    /// θ.
    pub theta: &'a [f64],
    /// θ̇.
    pub dtheta: &'a [f64],
    /// τ.
    pub tau: &'a [f64],
}

/// Eight samples: scratch, signals and answers.
#[derive(Debug)]
struct SampleBlock {
    room: Room<Wide>,
    signals: [Vec<Wide>; MOST_SIGNALS],
    out: Vec<Wide>,
}

impl Batch {
    /// Scratch for `robot`.
    pub fn new(robot: Arc<Robot>) -> Self {
        Self { one: Room::new(&robot), wide: None, robot }
    }

    /// Asks `A` at every sample, `width` numbers each, eight samples at a time as long as there are as many. A signal of a single
    /// sample is that of all.
    fn ask<A: Answer<S>, const S: usize>(&mut self, signals: [&[f64]; S], out: &mut [f64], width: usize) {
        let whole = out.len() / (WIDE * width).max(1) * WIDE;
        let (blocks, rest) = out.split_at_mut(whole * width);
        let watch = Watch::current();
        if whole > 0 {
            let Self { robot, wide, .. } = self;
            let n = robot.len();
            let SampleBlock { room, signals: gathered, out: answers } =
                &mut **wide.get_or_insert_with(|| SampleBlock::new(robot));
            answers.resize(width, Wide::default());
            for (i, out) in blocks.chunks_exact_mut(WIDE * width).enumerate().take_while(|_| !watch.stops()) {
                gathered.iter_mut().zip(signals).for_each(|(to, signal)| gather(signal, n, WIDE * i, to));
                let signals = core::array::from_fn(|s| &*gathered[s]);
                simd::phase(Asked::<A, _, S> { room, robot, signals, out: answers, of: PhantomData });
                scatter(answers, out);
            }
        }
        self.ask_one_by_one::<A, S>(signals, whole, rest, width);
    }

    /// The same one sample at a time, from sample `first` on.
    fn ask_one_by_one<A: Answer<S>, const S: usize>(
        &mut self,
        signals: [&[f64]; S],
        first: usize,
        out: &mut [f64],
        width: usize,
    ) {
        let Self { robot, one: room, .. } = self;
        let watch = Watch::current();
        for (i, out) in (first..).zip(out.chunks_exact_mut(width.max(1))).take_while(|_| !watch.stops()) {
            let signals = signals.map(|signal| row(signal, robot.len(), i));
            simd::phase(Asked::<A, _, S> { room, robot, signals, out, of: PhantomData });
        }
    }

    /// τ: n a sample.
    pub fn inverse_dynamics(&mut self, s: States<'_>, out: &mut [f64]) {
        self.ask::<Torque, 3>([s.q, s.dq, s.ddq], out, self.robot.len());
    }

    /// q̈ and θ̈ one after the other: 2 n a sample.
    pub fn forward_dynamics(&mut self, s: DrivenStates<'_>, out: &mut [f64]) {
        self.ask::<Accelerations, 5>([s.q, s.dq, s.theta, s.dtheta, s.tau], out, 2 * self.robot.len());
    }

    /// Friction of the links at velocities `dq`, where their motion takes the torques `load` without it: n a sample.
    pub fn link_friction(&mut self, dq: &[f64], load: &[f64], out: &mut [f64]) {
        self.each_drive(dq, load, out, |drive, v, load| drive.link_friction_beside(v, load).torque);
    }

    /// Friction of the motors at velocities `dtheta`, which feel the torques `load` of their gears: n a sample.
    pub fn motor_friction(&mut self, dtheta: &[f64], load: &[f64], out: &mut [f64]) {
        self.each_drive(dtheta, load, out, |drive, v, load| {
            drive.motor_friction(v).0 + drive.gear_loss.loss(v, load).torque
        });
    }

    /// `law` of each joint's drive, sample by sample.
    fn each_drive(&self, velocities: &[f64], load: &[f64], out: &mut [f64], law: impl Fn(&Drive, f64, f64) -> f64) {
        let drives = self.robot.drives.iter().cycle();
        for (((out, &v), &load), drive) in out.iter_mut().zip(velocities).zip(load).zip(drives) {
            *out = law(drive, v, load);
        }
    }

    /// g(q): n a sample.
    pub fn gravity_torque(&mut self, q: &[f64], out: &mut [f64]) {
        let zero = vec![0.0; self.robot.len()];
        self.inverse_dynamics(States { q, dq: &zero, ddq: &zero }, out);
    }

    /// What each number of the varying wrenches adds to each joint's torque, Jᵀ: n × numbers a sample.
    pub fn wrench_map(&mut self, q: &[f64], out: &mut [f64]) {
        self.ask_one_by_one::<WrenchMap, 1>([q], 0, out, self.robot.len() * self.robot.wrench_states());
    }

    /// M(q): n × n a sample.
    pub fn mass_matrix(&mut self, q: &[f64], out: &mut [f64]) {
        self.ask::<MassMatrix, 1>([q], out, self.robot.len().pow(2));
    }

    /// C(q, q̇): n × n a sample.
    pub fn coriolis_matrix(&mut self, q: &[f64], dq: &[f64], out: &mut [f64]) {
        self.ask_one_by_one::<CoriolisMatrix, 2>([q, dq], 0, out, self.robot.len().pow(2));
    }

    /// ∂τ/∂q, ∂τ/∂q̇ and M one after the other: 3 n × n a sample.
    pub fn inverse_dynamics_derivatives(&mut self, s: States<'_>, out: &mut [f64]) {
        self.ask::<TorqueDerivatives, 3>([s.q, s.dq, s.ddq], out, 3 * self.robot.len().pow(2));
    }

    /// Specific force at every recorded accelerometer axis.
    pub fn specific_force(&mut self, s: States<'_>, out: &mut [f64]) {
        self.ask::<SpecificForce, 3>([s.q, s.dq, s.ddq], out, self.robot.acceleration_channels());
    }

    /// Its derivatives in q, q̇ and q̈ one after the other: 3 channels × n a sample.
    pub fn specific_force_derivatives(&mut self, s: States<'_>, out: &mut [f64]) {
        let width = 3 * self.robot.acceleration_channels() * self.robot.len();
        self.ask_one_by_one::<SpecificForceDerivatives, 3>([s.q, s.dq, s.ddq], 0, out, width);
    }

    /// Angular rate at every recorded gyroscope axis.
    pub fn angular_rate(&mut self, q: &[f64], dq: &[f64], out: &mut [f64]) {
        self.ask_one_by_one::<AngularRate, 2>([q, dq], 0, out, self.robot.gyroscope_channels());
    }

    /// The tool centre point, 3 a sample; NaN when the robot has none.
    pub fn tool_position(&mut self, q: &[f64], out: &mut [f64]) {
        self.ask_one_by_one::<ToolPosition, 1>([q], 0, out, 3);
    }
}

impl SampleBlock {
    fn new(robot: &Robot) -> Box<Self> {
        let signals = core::array::from_fn(|_| vec![Wide::default(); robot.len()]);
        Box::new(Self { room: Room::new(robot), signals, out: Vec::new() })
    }
}

/// Sample `i` of a signal of `n` numbers a sample.
#[inline(always)]
fn row(signal: &[f64], n: usize, i: usize) -> &[f64] {
    if signal.len() == n { signal } else { &signal[i * n..][..n] }
}

/// Samples `first` and further of a signal side by side.
fn gather(signal: &[f64], n: usize, first: usize, to: &mut [Wide]) {
    for lane in 0..WIDE {
        for (to, value) in to.iter_mut().zip(row(signal, n, first + lane)) {
            to.0[lane] = *value;
        }
    }
}

/// Answers that are side by side as one row a sample.
fn scatter(answers: &[Wide], out: &mut [f64]) {
    for (lane, row) in out.chunks_exact_mut(answers.len()).enumerate() {
        for (to, value) in row.iter_mut().zip(answers) {
            *to = value.0[lane];
        }
    }
}

/// An [`Answer`], to be compiled for each instruction set.
struct Asked<'a, A, T, const S: usize> {
    room: &'a mut Room<T>,
    robot: &'a Robot,
    signals: [&'a [T]; S],
    out: &'a mut [T],
    of: PhantomData<A>,
}

impl<A: Answer<S>, T: Scalar, const S: usize> Kernel for Asked<'_, A, T, S> {
    type Output = ();
    const LANES: bool = T::LANES;

    #[inline(always)]
    fn run(self) {
        A::at(self.room, self.robot, self.signals, self.out);
    }
}
