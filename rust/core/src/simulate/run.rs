//! The loop: sense, tell, control, move.
//!
//! A sample: sensors read the true motion; the feedback makes of the readings what the controller may know; the controller
//! gives torques, which amplifiers hold until the next sample; the plant is integrated to there. What is kept is the truth
//! at the moment of reading, beside the readings. Noise depends on the seed, the sensor and the sample alone.

use super::adaptive::{Adaptive, StepTolerance};
use super::feedback::{Feedback, Known};
use super::integrator::{RungeKutta, largest_stable_step};
use super::plant::Plant;
use super::recording::SimulatedRecording;
use super::sensors::{JointMotion, Suite};
use super::start::SimulationStart;
use crate::check::{expect, expect_length};
use crate::control::{Controller, Reference, RobotState};
use crate::error::{DesignError, SimulationError};
use crate::interrupt::Watch;
use crate::robot::Robot;
use crate::simd::{self, Kernel};

/// How the robot moves between samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stepping {
    /// Number of steps of [`RungeKutta`] in a period.
    Fixed(usize),
    /// [`Adaptive`] steps, the last of a period ending at the sample.
    Adaptive(StepTolerance),
}

/// How long and how finely.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Of sensors and controller [s].
    pub period: f64,
    /// Samples.
    pub count: usize,
    /// Between samples.
    pub stepping: Stepping,
    /// Every n-th sample is kept.
    pub keep_every: usize,
}

/// Steps of integration between two samples, at most.
const MOST_SUBSTEPS: usize = 1_000_000;

impl Plan {
    fn check(&self) -> Result<(), DesignError> {
        let positive = self.period > 0.0 && self.period.is_finite();
        expect(positive, "period", self.period, "a finite number greater than 0")?;
        let substeps = if let Stepping::Fixed(substeps) = self.stepping { substeps } else { 1 };
        for (what, value) in [("samples", self.count), ("substeps", substeps), ("keep_every", self.keep_every)] {
            expect(value > 0, what, 0.0, "at least 1")?;
        }
        expect(substeps <= MOST_SUBSTEPS, "substeps", substeps as f64, "at most 1000000")
    }
}

/// What acts on links from outside, in time; between samples it is what it is in the middle.
#[derive(Clone, Debug, Default)]
pub struct Outside {
    /// A torque on each link (n) [N m].
    pub push: Option<Reference>,
    /// The numbers of the robot's varying wrenches [N, N m]; none: they are zero.
    pub wrench: Option<Reference>,
}

/// Moves `robot` under `controller` and what acts from `outside`; sensors and controller act every period, torques are held in
/// between.
///
/// ```
/// use linkside_core::control::{JointPd, Reference};
/// use linkside_core::simulate::{Outside, Plan, SensorModel, SimulationStart, Stepping, Suite, TrueState, simulate};
///
/// let robot = linkside_core::demo::arm()?;
/// // To 0.1 rad by proportional and derivative control of the motor, for one second at 1 kHz.
/// let reference = Reference::new(vec![0.0], vec![0.1], 1)?;
/// let mut law = JointPd::new(reference, vec![2000.0], vec![200.0], vec![0.0])?;
/// let exact = SensorModel {
///     noise: 0.0, bias: 0.0, resolution: 0.0, delay: 0.0, corner_frequency: f64::INFINITY, every: 1,
/// };
/// let suite = Suite::new(&robot, &[exact; 8], 1e-3, 0)?; // θ, three accelerations, θ̇, q, τ_J, q̇
/// let plan = Plan { period: 1e-3, count: 1000, stepping: Stepping::Fixed(4), keep_every: 1 };
/// let run = simulate(&robot, SimulationStart::default(), plan, Outside::default(), suite, &mut TrueState, &mut law)?;
/// assert!((run.q[999] - 0.1).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A plan or a start that cannot be used, a fixed step too large for the stiffness, a tolerance that cannot be met, a
/// controller that refuses or gives no number, a state that is no longer finite.
pub fn simulate(
    robot: &Robot,
    start: SimulationStart,
    plan: Plan,
    outside: Outside,
    suite: Suite,
    feedback: &mut dyn Feedback,
    controller: &mut dyn Controller,
) -> Result<SimulatedRecording, SimulationError> {
    plan.check()?;
    let mut world = World::new(robot, start, plan.stepping, outside)?;
    world.out = SimulatedRecording::with_capacity(robot, plan.count.div_ceil(plan.keep_every), suite.readings.len())?;
    // A fixed step beyond the stability limit of the stiffest mode would explode after samples that look right: refused
    // beforehand, with the number of substeps that would do.
    let own = world.x.len() - if world.outside.push.is_some() { robot.len() } else { 0 };
    let limit = largest_stable_step(robot, &world.x[..own], &world.tau);
    if limit.is_nan() {
        return Err(SimulationError::Singular);
    }
    if let Stepping::Fixed(substeps) = plan.stepping {
        let step = plan.period / substeps as f64;
        if step > limit {
            return Err(SimulationError::Step { step, limit, substeps: (plan.period / limit).ceil() });
        }
    }
    let mut run = SimulationRun { robot, plan, world, suite, feedback, controller };
    let watch = Watch::current();
    for sample in 0..plan.count {
        run.sample(sample, &watch)?;
    }
    Ok(run.world.out)
}

/// A [`Stepping`] with its room.
enum Mover {
    Fixed(RungeKutta, usize),
    Adaptive(Box<Adaptive>),
}

impl Mover {
    fn new(plant: &Plant, stepping: Stepping) -> Result<Self, DesignError> {
        Ok(match stepping {
            Stepping::Fixed(substeps) => Self::Fixed(RungeKutta::new(plant), substeps),
            Stepping::Adaptive(tolerance) => Self::Adaptive(Box::new(Adaptive::new(plant, tolerance)?)),
        })
    }
}

/// The robot and what it left behind.
struct World {
    /// (q, q̇, θ, θ̇), as the plant's layout has it.
    x: Vec<f64>,
    /// Torque until the next sample (n) [N m].
    tau: Vec<f64>,
    /// What acts on the links from outside.
    outside: Outside,
    /// Dynamics, with the accelerations and frames of the sample.
    plant: Plant,
    mover: Mover,
    /// What the controller knows.
    known: RobotState,
    /// Motor positions and velocities, one a joint also where rigid.
    theta: Vec<f64>,
    dtheta: Vec<f64>,
    /// Rows so far.
    out: SimulatedRecording,
}

impl World {
    fn new(
        robot: &Robot,
        start: SimulationStart,
        stepping: Stepping,
        mut outside: Outside,
    ) -> Result<Self, DesignError> {
        let n = robot.len();
        let mut acts = (vec![0.0; n], vec![0.0; robot.wrench_states()]);
        let parts = [("push", &mut outside.push, &mut acts.0), ("wrench", &mut outside.wrench, &mut acts.1)];
        for (what, path, values) in parts {
            if let Some(path) = path {
                expect_length(what, path.width(), values.len())?;
                path.at(0.0, |j, value, _| values[j] = value);
            }
        }
        let (RobotState { q, dq, theta, dtheta }, tau) = start.complete(robot, &acts.0, &acts.1)?;
        let plant = Plant::pushed(robot, outside.push.is_some());
        let mover = Mover::new(&plant, stepping)?;
        let mut x = vec![0.0; plant.layout.dense];
        plant.layout.gather([&q, &dq, &theta, &dtheta], &mut x);
        let known = RobotState::new(n);
        let [theta, dtheta] = [vec![0.0; n], vec![0.0; n]];
        Ok(Self { x, tau, outside, plant, mover, known, theta, dtheta, out: SimulatedRecording::default() })
    }

    /// Lets what acts from outside be what it is at `t`.
    #[inline(always)]
    fn push(&mut self, t: f64) {
        let Self { outside, plant: Plant { layout, .. }, x, .. } = self;
        for (path, first) in [(&mut outside.push, layout.link_disturbance), (&mut outside.wrench, layout.wrench)] {
            if let (Some(path), Some(first)) = (path, first) {
                path.at(t, |j, value, _| x[first + j] = value);
            }
        }
    }

    /// Accelerations, motor positions and the kinematics at the present state.
    #[inline(always)]
    fn look(&mut self, robot: &Robot) {
        let Plant { layout, dynamics } = &mut self.plant;
        let (n, x) = (layout.joints, &self.x);
        dynamics.accelerate(robot, layout, x, &self.tau);
        dynamics.kinematics.set_motion(&robot.tree, &x[..n], &x[n..2 * n], &dynamics.ddq);
        for j in 0..n {
            (self.theta[j], self.dtheta[j]) = (x[layout.theta[j]], x[layout.dtheta[j]]);
        }
    }

    /// The truth as feedback may look at it.
    #[inline(always)]
    fn motion(&self) -> JointMotion<'_> {
        let n = self.theta.len();
        JointMotion { q: &self.x[..n], dq: &self.x[n..2 * n], theta: &self.theta, dtheta: &self.dtheta }
    }

    /// Moves from one sample to the next.
    fn advance(&mut self, robot: &Robot, t: f64, dt: f64, watch: &Watch) -> Result<(), SimulationError> {
        let Self { x, tau, plant, mover, .. } = self;
        match mover {
            Mover::Fixed(method, substeps) => {
                for _ in 0..*substeps {
                    if watch.stops() {
                        return Err(SimulationError::Interrupted { time: t });
                    }
                    // Equal steps, the last one ending at the sample.
                    method.step(robot, plant, x, tau, dt / *substeps as f64);
                }
                Ok(())
            }
            Mover::Adaptive(_) if watch.stops() => Err(SimulationError::Interrupted { time: t }),
            Mover::Adaptive(method) => method.advance(robot, plant, x, tau, (t, dt)),
        }
    }

    /// A row of the recording.
    fn keep(&mut self, robot: &Robot, t: f64, readings: &[f64]) {
        let n = robot.len();
        let Self { x, tau, plant, known, theta, dtheta, out, .. } = self;
        out.t.push(t);
        let known = [&known.q, &known.dq, &known.theta, &known.dtheta];
        known.into_iter().for_each(|values| out.known.extend_from_slice(values));
        for (all, values) in [
            (&mut out.readings, readings),
            (&mut out.tau, tau),
            (&mut out.q, &x[..n]),
            (&mut out.dq, &x[n..2 * n]),
            (&mut out.ddq, &plant.dynamics.ddq),
            (&mut out.theta, theta),
            (&mut out.dtheta, dtheta),
        ] {
            all.extend_from_slice(values);
        }
        if let Some(first) = plant.layout.link_disturbance {
            out.push.extend_from_slice(&x[first..][..n]);
        }
        if let Some(first) = plant.layout.wrench {
            out.wrench.extend_from_slice(&x[first..]);
        }
        if let Some(tool) = &robot.tool {
            out.tool.extend_from_slice(&plant.dynamics.kinematics.position(tool).0);
        }
    }
}

/// [`World::look`], to be compiled for each instruction set.
struct Look<'a> {
    world: &'a mut World,
    robot: &'a Robot,
}

impl Kernel for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.world.look(self.robot);
    }
}

/// All sensors of a sample.
struct Read<'a> {
    suite: &'a mut Suite,
    robot: &'a Robot,
    world: &'a World,
    sample: usize,
}

impl Kernel for Read<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { suite, robot, world, sample } = self;
        suite.read(robot, &world.plant, &world.x, sample);
    }
}

/// A simulation on its way.
struct SimulationRun<'a> {
    robot: &'a Robot,
    plan: Plan,
    world: World,
    suite: Suite,
    feedback: &'a mut dyn Feedback,
    controller: &'a mut dyn Controller,
}

impl SimulationRun<'_> {
    /// One turn of the loop: look, sense, tell, control, keep, move.
    fn sample(&mut self, sample: usize, watch: &Watch) -> Result<(), SimulationError> {
        let Self { robot, plan, world, suite, feedback, controller } = self;
        let (dt, t) = (plan.period, sample as f64 * plan.period);
        // 1. Where the robot is: accelerations under the torque that has been acting, and all frames.
        world.push(t);
        simd::phase(Look { world, robot });
        if !world.plant.dynamics.ddq.iter().chain(&world.x).all(|value| value.is_finite()) {
            return Err(SimulationError::NotFinite { time: t });
        }
        // 2. Sense: readings of this instant, with noise, bias, filter, delay and quantisation.
        simd::phase(Read { suite, robot, world, sample });
        // 3. Tell: from truth or readings to the state that the controller knows (taken out: the truth is lent).
        let mut state = core::mem::take(&mut world.known);
        let known = Known { truth: world.motion(), readings: &suite.readings, tau: &world.tau, dt };
        feedback.state_into(known, &mut state)?;
        world.known = state;
        // 4. Control: a new torque, held until the next sample.
        controller.torque(t, &world.known, &mut world.tau).map_err(|_| SimulationError::Refused { time: t })?;
        if let Some(joint) = world.tau.iter().position(|value| !value.is_finite()) {
            return Err(SimulationError::Torque { joint, value: world.tau[joint], time: t });
        }
        // 5. Keep a row: state and readings at t, with the torque that acts from t on, as logs have it.
        if sample.is_multiple_of(plan.keep_every) {
            world.keep(robot, t, &suite.readings);
        }
        // 6. Move to t + dt.
        world.push(t + 0.5 * dt);
        world.advance(robot, t, dt, watch)
    }
}
