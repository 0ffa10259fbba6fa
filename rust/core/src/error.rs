//! What can be wrong with what a user gives us. Below the boundary kernels do not fail.

use thiserror::Error;

/// A robot that cannot be computed with.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RobotError {
    /// No moving body.
    #[error("the robot has no moving joint")]
    NoBodies,
    /// A body before its parent.
    #[error("body {body} comes before its parent {parent}")]
    Order {
        /// The body.
        body: usize,
        /// Its parent.
        parent: usize,
    },
    /// A joint index twice, or none for a joint.
    #[error("joint {joint} must move exactly one body, it moves {count}")]
    Joint {
        /// The joint.
        joint: usize,
        /// How many bodies it moves.
        count: usize,
    },
    /// An axis that is not of length one.
    #[error("the axis of body {body} has length {length}, expected 1")]
    Axis {
        /// The body.
        body: usize,
        /// The axis' length.
        length: f64,
    },
    /// A quantity out of its range.
    #[error("{what} of {owner} is {value}, expected {expected}")]
    Range {
        /// Which quantity.
        what: &'static str,
        /// Whose.
        owner: String,
        /// Its value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A frame on a body that does not exist.
    #[error("{owner} is on body {body}, there are {count}")]
    Body {
        /// Which frame.
        owner: String,
        /// The body it names.
        body: usize,
        /// How many there are.
        count: usize,
    },
    /// Inertia that no masses have.
    #[error(
        "the inertia of links and motors together is not positive definite at q = {posture:.3?}: the coupling is too large for the motor inertias and the links"
    )]
    Indefinite {
        /// Where, q.
        posture: Vec<f64>,
    },
    /// Arrays that do not fit together.
    #[error("{what} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// What was expected.
        expected: usize,
    },
}

/// Settings of an estimator that cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DesignError {
    /// Not as many poles as states.
    #[error("joint {joint} has {found} poles, expected {expected}")]
    PoleCount {
        /// The joint.
        joint: usize,
        /// How many were given.
        found: usize,
        /// How many states there are.
        expected: usize,
    },
    /// A pole with a real part that is not negative.
    #[error("joint {joint} has the pole {re:+}{im:+}j, expected a negative real part")]
    UnstablePole {
        /// The joint.
        joint: usize,
        /// Real part [1/s].
        re: f64,
        /// Imaginary part [1/s].
        im: f64,
    },
    /// A complex pole without its mirror image.
    #[error("joint {joint} has the pole {re:+}{im:+}j without its conjugate")]
    UnpairedPole {
        /// The joint.
        joint: usize,
        /// Real part [1/s].
        re: f64,
        /// Imaginary part [1/s].
        im: f64,
    },
    /// Poles so fast that the innovation at one sample would overshoot.
    #[error(
        "joint {joint} has a pole of {speed:.0} rad/s, too fast for a period of {period} s: at most {limit:.0} rad/s"
    )]
    FastPole {
        /// The joint.
        joint: usize,
        /// Magnitude of the pole [rad/s].
        speed: f64,
        /// Sampling period [s].
        period: f64,
        /// The fastest that is accepted [rad/s].
        limit: f64,
    },
    /// A gain of a velocity observer so fast that it would hardly more than difference positions.
    #[error("a gain of {gain:.4} 1/s is too fast for a period of {period} s: at most {limit:.4} 1/s")]
    FastGain {
        /// The gain [1/s].
        gain: f64,
        /// Sampling period [s].
        period: f64,
        /// The fastest that is accepted [1/s].
        limit: f64,
    },
    /// A spring on the position error that would swing up from sample to sample.
    #[error(
        "the position gains give an eigenvalue of {stiffness:.4} 1/s² at the first posture, unstable at this rate: expected below {limit:.4} 1/s²"
    )]
    StiffSpring {
        /// λmax(M⁻¹K_P) [1/s²].
        stiffness: f64,
        /// The least that is refused [1/s²].
        limit: f64,
    },
    /// A setting out of its range.
    #[error("{what} is {value}, expected {expected}")]
    Range {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// Fewer acceleration channels than elastic joints.
    #[error(
        "{joints} elastic joints but only {channels} accelerations are measured; add accelerometers, or set `elastic: false` on joints that give little"
    )]
    TooFewAccelerations {
        /// Elastic joints.
        joints: usize,
        /// Measured axes.
        channels: usize,
    },
    /// Arrays that do not fit together.
    #[error("{what} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// What was expected.
        expected: usize,
    },
    /// A motion that is not known to be smooth enough for its torque.
    #[error("the motion is given up to derivative {found}, this robot's torque needs derivative {needed}")]
    Derivatives {
        /// Highest derivative of the links' motion that is given.
        found: usize,
        /// Highest one that is needed.
        needed: usize,
    },
    /// A parameter of a joint, a sensor or an axis that does not exist.
    #[error("the robot has no {parameter}")]
    NoParameter {
        /// The parameter.
        parameter: String,
    },
    /// A reading that no sensor gives.
    #[error("{what}[{index}] is {value}, expected a finite number, or NaN where a reading is missing")]
    Infinite {
        /// Which signal.
        what: &'static str,
        /// Which of its entries.
        index: usize,
        /// What it is.
        value: f64,
    },
    /// Results or particles that do not fit into memory.
    #[error("{:.3} GB of memory are needed and not there: take fewer samples or particles at a time, or keep less", bytes / 1e9)]
    Memory {
        /// What was asked for at once.
        bytes: f64,
    },
    /// Positions too far apart for an observer.
    #[error(
        "the position of joint {joint} has been missing for more than {longest} s, longer than an observer bridges: its error grows between positions"
    )]
    Late {
        /// The joint.
        joint: usize,
        /// The longest time that is bridged [s].
        longest: f64,
    },
    /// The gravity iteration for a start at rest did not settle.
    #[error(
        "no static equilibrium found for the first sample: gravity is too strong for the stiffness; give an initial state"
    )]
    NoEquilibrium,
    /// The first sample of a channel that must be there.
    #[error("the first sample of the position of joint {joint} is missing; an observer cannot start without it")]
    NoStart {
        /// The joint.
        joint: usize,
    },
}

/// A run that broke down.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RunError {
    /// Settings or arrays that cannot be used.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// A state that is no longer a number.
    #[error("the estimate is not finite after sample {sample}: look for infinite or absurd readings there")]
    NotFinite {
        /// Index of the sample.
        sample: usize,
    },
    /// No particle of a filter explains a sample's readings.
    #[error(
        "no particle is compatible with the readings of sample {sample} and the limits: look for absurd readings there, or let the filter go on with collapse='reseed'"
    )]
    Impossible {
        /// Index of the sample.
        sample: usize,
    },
    /// A request to stop; see [`interrupt`](crate::interrupt).
    #[error("stopped at sample {sample}, as asked")]
    Interrupted {
        /// Index of the first sample that was not taken.
        sample: usize,
    },
    /// A cloud that no longer explains the readings.
    #[error(
        "the particles no longer explain the readings at sample {sample}, as a Kalman filter beside them does: take more particles, wider noise, or let the filter go on with collapse='reseed'"
    )]
    Lost {
        /// Index of the sample.
        sample: usize,
    },
    /// A posture at which the robot's inertia cannot be inverted.
    #[error("the inertia is singular at the posture of sample {sample}: a joint moves no mass there")]
    SingularInertia {
        /// Index of the sample.
        sample: usize,
    },
}

/// A simulation that cannot go on.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SimulationError {
    /// Settings or arrays that cannot be used.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// Coupling of motors that leaves no inertia.
    #[error("the inertia is not positive definite at the start: the coupling is too strong for the motor inertias")]
    Singular,
    /// A step that the stiffness makes unstable.
    #[error(
        "a step of {step:.3e} s is unstable for this stiffness: the largest stable one is {limit:.3e} s, so take at least {substeps} substeps a period, or the adaptive integrator"
    )]
    Step {
        /// Step of integration [s].
        step: f64,
        /// The largest stable one [s].
        limit: f64,
        /// Steps a period that are stable.
        substeps: f64,
    },
    /// A motion that no step is short enough for.
    #[error(
        "the adaptive integrator cannot meet the tolerance at t = {time:.9} s with steps of {step:.1e} s: the motion of joint {joint} is too abrupt, expected a larger rtol or atol, or a smoother friction"
    )]
    Abrupt {
        /// Where the error is largest.
        joint: usize,
        /// When [s].
        time: f64,
        /// Step of integration [s].
        step: f64,
    },
    /// A state that is no longer a number.
    #[error(
        "the motion is not finite at t = {time:.9} s: the loop is unstable, or a fixed step of integration is (the adaptive integrator tells which)"
    )]
    NotFinite {
        /// When [s].
        time: f64,
    },
    /// A request to stop; see [`interrupt`](crate::interrupt).
    #[error("stopped at t = {time:.9} s, as asked")]
    Interrupted {
        /// When [s].
        time: f64,
    },
    /// A torque that is no number.
    #[error("the controller's torque of joint {joint} is {value} at t = {time:.9} s, expected a number")]
    Torque {
        /// The joint.
        joint: usize,
        /// The torque.
        value: f64,
        /// When [s].
        time: f64,
    },
    /// A controller that gives no torque.
    #[error("the controller gave no torque at t = {time:.9} s")]
    Refused {
        /// When [s].
        time: f64,
    },
}
