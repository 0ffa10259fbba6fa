//! Inverse dynamics of robots with elastic joints: from a smooth motion of the links to motor motion and torque.
//!
//! The links' recursive Newton–Euler kernel runs on power series in time ([`Series`]), which gives the torque on each link with
//! all its derivatives in one pass. A transmission then turns D δ̇ + φ(δ) = r into torsion δ and its derivatives, from
//! the outermost joint inwards as the inertial coupling S is strictly upper triangular:
//! rᵢ = τ_J,ᵢ + Σ_{j>i} Sᵢⱼ θ̈ⱼ and τ = B θ̈ + Sᵀ q̈ + (1 + ε′) r + motor friction, for the models (1) and (2) of De Luca,
//! Schröder and Thümmel (2007).

use super::transmission::{LoadedTransmission, SMOOTHEST, advance, damped, motor, undamped};
use crate::check::{expect, expect_finite, expect_length, expect_rising};
use crate::dynamics::NewtonEuler;
use crate::error::DesignError;
use crate::interrupt::Watch;
use crate::robot::Robot;
use crate::scalar::Series;

/// The highest derivative of the links' motion that can be asked for.
pub const HIGHEST: usize = 17;

/// A motion of the links.
#[derive(Clone, Copy, Debug)]
pub struct Path<'a> {
    /// Times of the samples, rising [s]; T of them.
    pub t: &'a [f64],
    /// q and its derivatives in time one after the other, each T × n.
    pub derivatives: &'a [f64],
}

/// What the motors have to do; each T × n.
///
/// ```
/// use linkside_core::control::feedforward::{Path, derivative_order, inverse_dynamics};
///
/// let robot = linkside_core::demo::arm()?;
/// // Constant acceleration of 2 rad/s²: q = t², with as many derivatives as motor torques depend on.
/// let t = [0.0, 0.5, 1.0];
/// let mut derivatives = vec![0.0; 3 * (derivative_order(&robot) + 1)];
/// for (i, t) in t.iter().enumerate() {
///     (derivatives[i], derivatives[3 + i], derivatives[6 + i]) = (t * t, 2.0 * t, 2.0);
/// }
/// let desired = inverse_dynamics(&robot, Path { t: &t, derivatives: &derivatives })?;
/// // 1.65 kg m² of link and 3 of motor; the spring is twisted by what the link takes of it.
/// assert!((desired.tau[2] - 9.3).abs() < 1e-9 && (desired.theta[2] - 1.0 - 3.3 / 1.2e4).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Desired {
    /// θ [rad].
    pub theta: Vec<f64>,
    /// θ̇ [rad/s].
    pub dtheta: Vec<f64>,
    /// Motor torque [N m].
    pub tau: Vec<f64>,
}

/// The highest derivative of q that the motor torque depends on.
///
/// 2 where all joints are rigid; an undamped spring adds 2 and a damped one 1, along the longest chain of joints that S couples.
/// So 4 without damping and coupling, 3 with damping, and with a chain of ℓ entries of S 4 + 2ℓ and 3 + ℓ.
pub fn derivative_order(robot: &Robot) -> usize {
    let n = robot.len();
    let mut motors = vec![2; n];
    let mut highest = 2;
    for i in (0..n).rev() {
        let load = (i + 1..n).filter(|j| robot.coupling[i * n + j] != 0.0).map(|j| motors[j]).fold(2, usize::max);
        let drive = &robot.drives[i];
        if drive.elastic {
            motors[i] = load + if drive.damping > 0.0 { 1 } else { 2 };
        }
        highest = highest.max(load).max(motors[i]);
    }
    highest
}

/// Motor motion and torque for the links to follow `path`.
///
/// A damped torsion has a state of its own: it starts where the spring alone carries the load, as at rest, and between samples
/// the load is taken for a cubic. With one or two derivatives more than needed, it is a polynomial of degree five or seven.
/// O(n p²) a sample, p being [`derivative_order`].
///
/// # Errors
/// A joint that nothing drives, derivatives that are missing, arrays that do not fit, numbers that are not finite, times that do not rise, a robot that
/// would need derivatives beyond [`HIGHEST`].
pub fn inverse_dynamics(robot: &Robot, path: Path<'_>) -> Result<Desired, DesignError> {
    let further = check(robot, path)?;
    // Of springs alone, of dampers without further derivatives and with them, and of motors that are coupled; not of every
    // length, which takes long to compile.
    Ok(match derivative_order(robot) + further {
        0..=3 => FeedforwardPass::<4, 2>::new(robot, path, further).run(),
        4..=5 => FeedforwardPass::<6, 4>::new(robot, path, further).run(),
        6..=7 => FeedforwardPass::<8, 6>::new(robot, path, further).run(),
        _ => FeedforwardPass::<{ HIGHEST + 1 }, { HIGHEST - 1 }>::new(robot, path, further).run(),
    })
}

/// Checks everything; how many derivatives beyond those needed are given and of use.
fn check(robot: &Robot, path: Path<'_>) -> Result<usize, DesignError> {
    let needed = derivative_order(robot);
    let driven = robot.drives.iter().all(|drive| !drive.is_passive());
    expect(driven, "the motor inertia of a joint", f64::INFINITY, "a finite one: nothing drives a passive joint")?;
    expect(needed <= HIGHEST, "the order of derivatives that this robot needs", needed as f64, "at most 17")?;
    let width = path.t.len() * robot.len();
    let given = path.derivatives.len().checked_div(width).unwrap_or(needed + 1);
    let whole = if given == 0 { needed + 1 } else { given };
    expect_length("derivatives", path.derivatives.len(), whole * width)?;
    if given <= needed {
        return Err(DesignError::Derivatives { found: given - 1, needed });
    }
    expect_finite("a derivative of the motion", path.derivatives)?;
    expect_rising("t", path.t)?;
    Ok(of_use(robot).min(given - 1 - needed).min(HIGHEST - needed))
}

/// How many derivatives beyond those needed make a torsion more exact.
fn of_use(robot: &Robot) -> usize {
    let damped = robot.drives.iter().any(|drive| drive.elastic && drive.damping > 0.0);
    if damped { SMOOTHEST - 1 } else { 0 }
}

/// One pass over a path, with P Taylor coefficients a signal, and L = P − 2 of accelerations and what is made of them.
struct FeedforwardPass<'a, const P: usize, const L: usize> {
    robot: &'a Robot,
    /// Of the links.
    path: Path<'a>,
    /// Derivatives of q that are looked at.
    order: usize,
    /// Derivatives of a damped transmission's load that are known.
    known: usize,
    /// The links' recursion, on power series in time; the motion that it is of, and its torques.
    recursion: NewtonEuler<Series<L>>,
    motion: [Vec<Series<L>>; 3],
    torque: Vec<Series<L>>,
    /// q, q̇, q̈.
    link: [Vec<Series<P>>; 3],
    /// τ_J, and then what each transmission carries.
    load: Vec<Series<P>>,
    /// θ with its derivatives (n).
    theta: Vec<Series<P>>,
    /// Load and torsion at the sample before; none at the first one, where the torsion has settled.
    before: Vec<Option<LoadedTransmission<P>>>,
}

impl<'a, const P: usize, const L: usize> FeedforwardPass<'a, P, L> {
    fn new(robot: &'a Robot, path: Path<'a>, further: usize) -> Self {
        let zero = || vec![Series::default(); robot.len()];
        let short = || vec![Series::default(); robot.len()];
        Self {
            robot,
            path,
            order: derivative_order(robot) + further,
            known: 1 + further,
            recursion: NewtonEuler::new(&robot.tree),
            motion: [short(), short(), short()],
            torque: short(),
            link: [zero(), zero(), zero()],
            load: zero(),
            theta: zero(),
            before: vec![None; robot.len()],
        }
    }

    /// Sample by sample. Not inlined, as its parts are not: of four lengths in one function, compilers make much too much.
    #[inline(never)]
    fn run(mut self) -> Desired {
        let size = self.path.t.len() * self.robot.len();
        let [mut theta, mut dtheta, mut tau] = [(); 3].map(|()| Vec::with_capacity(size));
        let watch = Watch::current();
        for row in 0..self.path.t.len() {
            if watch.stops() {
                break;
            }
            self.read(row);
            let dt = if row == 0 { 0.0 } else { self.path.t[row] - self.path.t[row - 1] };
            self.transmit(dt);
            theta.extend(self.theta.iter().map(|s| s.0[0]));
            dtheta.extend(self.theta.iter().map(|s| s.0[1]));
            tau.extend((0..self.robot.len()).map(|joint| self.torque(joint)));
        }
        Desired { theta, dtheta, tau }
    }

    /// The links' motion at `row`, and the torque that it takes with all derivatives.
    #[inline(never)]
    fn read(&mut self, row: usize) {
        let n = self.robot.len();
        let [q, dq, ddq] = &mut self.link;
        for joint in 0..n {
            let column = self.path.derivatives.iter().skip(row * n + joint).step_by(self.path.t.len() * n);
            q[joint] = Series::from_derivatives(column.take(self.order + 1).copied());
            dq[joint] = q[joint].rate();
            ddq[joint] = dq[joint].rate();
        }
        for (short, long) in self.motion.iter_mut().zip(&self.link) {
            short.iter_mut().zip(long).for_each(|(short, long)| *short = long.resized());
        }
        let (tree, [q, dq, ddq]) = (&self.robot.tree, &self.motion);
        self.recursion.set(tree, q, dq, ddq);
        self.recursion.inverse_dynamics_into(tree, &mut self.torque);
        for (joint, drive) in self.robot.drives.iter().enumerate() {
            let friction = drive.link_friction(dq[joint]).0;
            self.load[joint] = (self.torque[joint] + friction).resized();
        }
    }

    /// Motor positions, from the outermost joint inwards, `dt` after the sample before.
    #[inline(never)]
    fn transmit(&mut self, dt: f64) {
        let n = self.robot.len();
        for i in (0..n).rev() {
            for j in (i + 1..n).filter(|j| self.robot.coupling[i * n + j] != 0.0) {
                self.load[i] += self.theta[j].rate().rate() * self.robot.coupling[i * n + j];
            }
            let bearing = self.robot.drives[i].bearing_loss;
            if !bearing.is_none() {
                let load = self.load[i];
                self.load[i] = load + bearing.loss_beside(self.link[1][i], load).torque;
            }
            let angle = self.link[0][i] + self.torsion(i, dt);
            self.theta[i] = motor(&self.robot.drives[i], angle);
        }
    }

    /// δ with its derivatives, of a joint whose load is known: algebraic without damping, else integrated over `dt`.
    #[inline(always)]
    fn torsion(&mut self, joint: usize, dt: f64) -> Series<P> {
        let (drive, load) = (&self.robot.drives[joint], self.load[joint]);
        if !drive.elastic {
            return Series::default();
        }
        if drive.damping == 0.0 {
            return undamped(drive, load);
        }
        let torsion = match self.before[joint] {
            Some(before) => advance(drive, before, dt, load, self.known),
            None => drive.torsion(load.value()),
        };
        self.before[joint] = Some(LoadedTransmission { load, torsion });
        damped(drive, load, torsion)
    }

    /// τ = B θ̈ + Sᵀ q̈ + (1 + ε′) r + motor friction.
    #[inline(always)]
    fn torque(&self, joint: usize) -> f64 {
        let (n, drive) = (self.robot.len(), &self.robot.drives[joint]);
        let coupled: f64 = (0..joint).map(|i| self.robot.coupling[i * n + joint] * self.link[2][i].value()).sum();
        let speed = self.theta[joint].0[1];
        let felt = self.load[joint].value() * drive.ripple.output(self.theta[joint].value()).ratio;
        let friction = drive.motor_friction(speed).0 + drive.gear_loss.loss(speed, felt).torque;
        drive.motor_inertia * 2.0 * self.theta[joint].0[2] + coupled + felt + friction
    }
}
