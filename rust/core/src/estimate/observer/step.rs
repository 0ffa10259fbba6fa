//! The observer, sample by sample.
//!
//! A step at sample k, for each joint on its own but for q̈, which all share:
//!
//! 1. predict (θ, q, θ̇, q̇) over the period by the exact map of the linear model, with the torque and the acceleration of the sample
//!    before ([`Sampled`]);
//! 2. correct them by the innovation θ_k − θ̂: with the gain of the poles where the last sample was there too, with gains that vary
//!    in time at the start and after a gap (`late`, `correction`);
//! 3. q̈ from the accelerometers at the corrected posture, by weighted least squares ([`AccelerationMap`]);
//! 4. what the linear model lacks (nonlinear springs, friction, inertial coupling) as a torque for the next period, at the estimate.

use super::acceleration::{AccelerationMap, Observability};
use super::correction::{JointCorrection, LONGEST};
use super::deviations::{ObserverDeviations, ObserverView, link_of};
use super::gains::JointModel;
use super::late::VaryingGain;
use super::poles::Poles;
use super::recording::ObserverSample;
use super::rest::Rest;
use super::sampled::{JointState, Sampled};
use super::settings::{AccelerationSource, Form, ObserverSettings, Start, check};
use super::uncertainty::Uncertainty;
use crate::check::{are_sound, expect_length, refuse_infinite};
use crate::dynamics::Kinematics;
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::robot::Robot;
use crate::simd::{self, Kernel};
use std::sync::Arc;

/// Link state from motor positions, motor torques and accelerations, without the links' dynamics
/// (De Luca, Schröder and Thümmel 2007, Theorems 1 and 2, and eq. (12)).
///
/// Per joint, with x = (θ, q, θ̇, q̇): the linear model B θ̈ + D(θ̇ − q̇) + K(θ − q) = τ − friction − (Sᵀq̈), q̈ measured,
/// corrected by the motor position at each sample. A step costs O(n · channels) and allocates nothing.
///
/// ```
/// use linkside_core::estimate::observer::{
///     AccelerationObserver, AccelerationSource, Complex, Form, ObserverSample, ObserverSettings, Start,
/// };
///
/// let robot = std::sync::Arc::new(linkside_core::demo::arm()?);
/// let mut observer = AccelerationObserver::new(robot, ObserverSettings {
///     period: 1e-3,
///     poles: vec![[-90.0, -100.0, -110.0, -120.0].map(|pole| Complex::new(pole, 0.0)).to_vec()],
///     bias: false,
///     form: Form::Current,
///     source: AccelerationSource::Sensors,
///     worst_acceleration_std: 10.0,
///     start: Start::Rest,
/// })?;
/// // In a control loop: once a period. Here the arm stands still, its motor at 0.1 rad.
/// for _ in 0..100 {
///     observer.step(ObserverSample { theta: &[0.1], tau: &[0.0], acceleration: &[0.0, 0.0, 9.81], dtheta: &[] })?;
/// }
/// assert!((observer.q()[0] - 0.1).abs() < 1e-9 && observer.dq()[0].abs() < 1e-9);
/// assert_eq!(observer.status(), 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct AccelerationObserver {
    /// Links, drives and sensors.
    robot: Arc<Robot>,
    /// What it was made with.
    settings: ObserverSettings,
    /// Each joint's kind of linear model (n).
    models: Vec<JointModel>,
    /// Each joint's map over a period, and its gain (n).
    joints: Vec<Sampled>,
    /// Each joint's gains where samples are missing and at the start (n).
    corrections: Vec<JointCorrection>,
    /// From accelerometers to q̈.
    map: AccelerationMap,
    /// Of the links at the predicted posture, then of the tool.
    kinematics: Kinematics<f64>,
    /// Finds where links hang at a first sample.
    rest: Rest,
    /// (θ, q, θ̇, q̇, bias) of each joint (n); (θ, θ̇, θ̈, –, –) where rigid.
    state: Vec<JointState>,
    /// The state before the last innovation.
    predicted: Vec<JointState>,
    /// Torque on each motor's row over the coming period, less what the linear model has, and without coupling.
    torque: Vec<f64>,
    /// Measured link accelerations, bias and all.
    measured: Vec<f64>,
    /// Those of the sample before.
    previous: Vec<f64>,
    /// What is reported: q, q̇ and q̈ (n), less their bias.
    q: Vec<f64>,
    dq: Vec<f64>,
    ddq: Vec<f64>,
    /// Position of the tool centre point [m].
    tool: [f64; 3],
    /// How far off all this may be, where that is wanted.
    deviations: Option<ObserverDeviations>,
    /// The torque on each motor's row, and mean squares of innovations, for these (n).
    loaded: Vec<f64>,
    innovations: Vec<[f64; 2]>,
    /// Flags of the last sample, see [`Status`].
    status: u8,
    /// Samples taken, for messages.
    taken: usize,
    started: bool,
    /// The fastest pole [rad/s].
    fastest: f64,
}

/// |λ|h may not exceed this: beyond, a sampled error no longer decays the way its pole says.
const FASTEST: f64 = 2.0;

impl AccelerationObserver {
    /// Designs the observer.
    ///
    /// # Errors
    /// Poles that are unstable, unpaired, too many or too fast for the period; fewer accelerations than elastic joints.
    pub fn new(robot: Arc<Robot>, settings: ObserverSettings) -> Result<Self, DesignError> {
        let n = robot.len();
        check(&robot, &settings)?;
        let models: Vec<_> = robot
            .drives
            .iter()
            .map(|drive| match (drive.elastic, settings.bias) {
                (false, _) => JointModel::Rigid,
                (true, false) => JointModel::Elastic,
                (true, true) => JointModel::ElasticWithBias,
            })
            .collect();
        let (mut joints, mut corrections) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let mut fastest: f64 = 0.0;
        for (joint, model) in models.iter().enumerate() {
            let poles = Poles::new(joint, &settings.poles[joint], model.order())?;
            let (speed, limit) = (poles.fastest(), FASTEST / settings.period);
            if speed > limit {
                return Err(DesignError::FastPole { joint, speed, period: settings.period, limit });
            }
            let sampled = Sampled::new(*model, &robot.drives[joint], &poles, settings.period);
            let late = VaryingGain::new(*model, &robot.drives[joint], speed, settings.period);
            let most = sampled.innovation(model.order(), settings.worst_acceleration_std);
            let bounds = [most, most * (speed * settings.period).min(1.0)];
            corrections.push(JointCorrection::new(late, settings.period, bounds, link_of(*model)));
            fastest = fastest.max(speed);
            joints.push(sampled);
        }
        Ok(Self {
            map: AccelerationMap::new(&robot, settings.worst_acceleration_std),
            kinematics: Kinematics::new(&robot.tree),
            rest: Rest::new(&robot),
            state: vec![JointState::default(); n],
            predicted: vec![JointState::default(); n],
            torque: vec![0.0; n],
            measured: vec![0.0; n],
            previous: vec![0.0; n],
            q: vec![0.0; n],
            dq: vec![0.0; n],
            ddq: vec![0.0; n],
            tool: [f64::NAN; 3],
            deviations: None,
            loaded: vec![0.0; n],
            innovations: vec![[0.0; 2]; n],
            status: 0,
            taken: 0,
            started: false,
            fastest,
            robot,
            settings,
            models,
            joints,
            corrections,
        })
    }

    /// With standard deviations by what is not known exactly; estimates stay the same to the last bit.
    ///
    /// # Errors
    /// Wrong lengths, numbers out of range.
    pub fn with_uncertainty(mut self, uncertainty: &Uncertainty) -> Result<Self, DesignError> {
        uncertainty.check(&self.robot)?;
        let pace = [self.fastest, self.settings.period];
        let source = self.settings.source;
        self.deviations =
            Some(ObserverDeviations::new(&self.robot, &self.models, &self.joints, pace, source, uncertainty));
        Ok(self)
    }

    /// Resets the observer: the next sample starts from the beginning.
    pub fn reset(&mut self) {
        self.taken = 0;
        self.started = false;
    }

    /// Starts from a given state, each of length n; the next sample is one period later.
    ///
    /// # Errors
    /// Wrong lengths.
    pub fn start(&mut self, theta: &[f64], q: &[f64], dtheta: &[f64], dq: &[f64]) -> Result<(), DesignError> {
        let expected = self.robot.len();
        for (what, given) in [("theta", theta), ("q", q), ("dtheta", dtheta), ("dq", dq)] {
            expect_length(what, given.len(), expected)?;
        }
        for (j, (state, model)) in self.state.iter_mut().zip(&self.models).enumerate() {
            *state = joint_state(*model, theta[j], q[j], [dtheta[j], dq[j]]);
        }
        self.begin(Start::Rest);
        if let Some(deviations) = &mut self.deviations {
            deviations.begin_known();
        }
        Ok(())
    }

    /// Goes on from the present state.
    fn begin(&mut self, start: Start) {
        self.predicted.copy_from_slice(&self.state);
        self.corrections.iter_mut().for_each(|correction| correction.begin(start));
        self.measured.fill(0.0);
        self.torque.fill(0.0);
        self.started = true;
    }

    /// Takes one sample; afterwards the getters give the state at its time.
    ///
    /// The first sample starts the observer, as its [`Start`] says, unless [`start`](Self::start) did.
    ///
    /// # Errors
    /// A sample that cannot be used, of wrong lengths or with an infinite reading; a first one without every motor position,
    /// or without a static equilibrium; a motor position that has been missing for more than [`LONGEST`]. The state then
    /// stays as it was. [`RunError::NotFinite`]: readings so extreme that the state is not finite; the next sample restarts.
    pub fn step(&mut self, sample: ObserverSample<'_>) -> Result<(), RunError> {
        self.check(sample)?;
        self.take(sample)?;
        let sample = self.taken - 1;
        if !self.is_finite() {
            self.reset();
            return Err(RunError::NotFinite { sample });
        }
        Ok(())
    }

    /// Refuses a sample before anything has changed.
    fn check(&self, sample: ObserverSample<'_>) -> Result<(), DesignError> {
        let ObserverSample { theta, tau, acceleration, dtheta } = sample;
        let (n, m) = (self.joints(), self.channels());
        let speeds = if dtheta.is_empty() { 0 } else { n };
        let all = [("theta", theta, n), ("tau", tau, n), ("acceleration", acceleration, m), ("dtheta", dtheta, speeds)];
        for (what, values, expected) in all {
            expect_length(what, values.len(), expected)?;
            refuse_infinite(what, values)?;
        }
        let late = |(correction, theta): (&JointCorrection, &f64)| theta.is_nan() && correction.is_at_limit();
        match self.corrections.iter().zip(theta).position(late) {
            Some(joint) if self.started => Err(DesignError::Late { joint, longest: LONGEST }),
            _ => Ok(()),
        }
    }

    /// Whether links and motors still have positions and velocities, and links accelerations.
    pub(super) fn is_finite(&self) -> bool {
        let mut motors = (0..self.joints()).map(|joint| self.motor(joint));
        are_sound([&self.q[..], &self.dq, &self.ddq, self.q_std()].into_iter().flatten())
            && motors.all(|(theta, dtheta)| are_sound(&[theta, dtheta]))
    }

    /// [`step`](Self::step) with a sample that has been checked.
    pub(super) fn take(&mut self, sample: ObserverSample<'_>) -> Result<(), DesignError> {
        simd::phase(ObserverStep { observer: self, sample })
    }

    /// One period: predict, read accelerations, correct, hold.
    #[inline(always)]
    fn take_here(&mut self, sample: ObserverSample<'_>) -> Result<(), DesignError> {
        self.status = 0;
        let first = !self.started;
        if self.started {
            // 1. The model over the last period, torque and accelerations held at their last values.
            self.predict();
            // 2. Accelerations at the predicted posture, from this sample's readings (eq. (12)).
            self.read_accelerations(sample.acceleration);
            // 3. The prediction again, as if accelerations had run straight from the last sample to this one.
            self.interpolate();
        } else {
            // A first sample: θ as read, links where gravity lets them hang.
            self.start_from_rest(sample.theta)?;
            self.read_accelerations(sample.acceleration);
        }
        // 4. The innovation θ − θ̂ moves all states of its joint.
        self.correct(sample.theta, first);
        // 5. The torque from now on; what the linear model lacks is taken off at the corrected state.
        self.hold_torque(sample.tau);
        self.report();
        // 6. How far off that may be.
        self.deviate(sample, first);
        self.taken += 1;
        Ok(())
    }

    /// Standard deviations, where they are wanted.
    #[inline(always)]
    fn deviate(&mut self, sample: ObserverSample<'_>, first: bool) {
        if self.deviations.is_none() {
            return;
        }
        for j in 0..self.joints.len() {
            self.loaded[j] = self.torque[j] - self.coupling_torque(j, &self.measured);
            self.innovations[j] = self.corrections[j].means();
        }
        let Self { deviations, robot, models, map, state, q, dq, ddq, measured, loaded, innovations, .. } = self;
        let links = [&q[..], &dq[..], &ddq[..]];
        let look = ObserverView { robot, models, map, state, links, measured, torque: loaded, innovations };
        if let Some(deviations) = deviations {
            simd::phase(Deviate { deviations, look: &look, sample, first });
            if deviations.is_faulty() {
                self.status |= Status::CONTRADICTED | Status::FAULTY;
            }
        }
    }

    /// A first sample: at rest, with gains that let the next samples say otherwise where [`Start`] is to be found out.
    fn start_from_rest(&mut self, theta: &[f64]) -> Result<(), DesignError> {
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        let q = self.rest.find(&self.robot, theta)?;
        for (j, (state, model)) in self.state.iter_mut().zip(&self.models).enumerate() {
            *state = joint_state(*model, theta[j], q[j], [0.0; 2]);
        }
        self.begin(self.settings.start);
        if let Some(deviations) = &mut self.deviations {
            let (corrections, start) = (&self.corrections, self.settings.start);
            deviations.begin_hanging(&self.robot, &self.state, |j| match start {
                Start::Auto => corrections[j].first_covariance(),
                Start::Rest => Default::default(),
            });
        }
        Ok(())
    }

    /// One period on, everything held.
    #[inline(always)]
    fn predict(&mut self) {
        for j in 0..self.joints.len() {
            // Joint by joint: given q̈, the motors' equations are not coupled (Theorem 1).
            let torque = self.torque[j] - self.coupling_torque(j, &self.measured);
            self.predicted[j] = self.joints[j].predict(&self.state[j], torque, self.measured[j]);
        }
        self.previous.copy_from_slice(&self.measured);
    }

    /// Sᵀq̈ on motor j for measured accelerations, less their estimated bias.
    #[inline(always)]
    fn coupling_torque(&self, j: usize, measured: &[f64]) -> f64 {
        let n = self.joints.len();
        let mut sum = 0.0;
        // S is strictly upper triangular: the motor of joint j feels the joints before it.
        for i in 0..j {
            let s = self.robot.coupling[i * n + j];
            if s != 0.0 {
                sum += s * (measured[i] - self.state[i][4]);
            }
        }
        sum
    }

    /// Link accelerations at the predicted state.
    #[inline(always)]
    fn read_accelerations(&mut self, reading: &[f64]) {
        if reading.iter().any(|x| x.is_nan()) {
            self.status |= Status::BRIDGED;
        }
        match self.settings.source {
            AccelerationSource::Joints => {
                for (kept, &value) in self.measured.iter_mut().zip(reading) {
                    *kept = if value.is_nan() { *kept } else { value };
                }
            }
            AccelerationSource::Sensors => self.read_sensors(reading),
        }
    }

    /// Link accelerations by least squares from the accelerometers, at the predicted posture and velocity (eq. (12)).
    #[inline(always)]
    fn read_sensors(&mut self, reading: &[f64]) {
        // A prior of zero where the sensors cannot see; of what it last was where they are silent for a moment.
        let silent = self.status & Status::BRIDGED != 0;
        for j in 0..self.joints.len() {
            let x = &self.predicted[j];
            match self.models[j] {
                JointModel::Rigid => {
                    (self.q[j], self.dq[j], self.ddq[j]) = (x[0], x[1], x[2]);
                    self.measured[j] = x[2];
                }
                _ => {
                    (self.q[j], self.dq[j], self.ddq[j]) = (x[1], x[3], 0.0);
                    self.measured[j] = if silent { self.measured[j] } else { 0.0 };
                }
            }
        }
        self.kinematics.set_motion(&self.robot.tree, &self.q, &self.dq, &self.ddq);
        self.status |= match self.map.solve(&self.robot, &self.kinematics, reading, &mut self.measured) {
            Observability::Full => 0,
            Observability::Damped => Status::DAMPED,
            Observability::Unobservable => Status::DAMPED | Status::UNSEEN,
        };
    }

    /// Redoes the prediction with accelerations on a straight line between the samples.
    #[inline(always)]
    fn interpolate(&mut self) {
        for j in 0..self.joints.len() {
            // What was held is replaced by a ramp: only the change enters, through the ramp response.
            let torque = self.coupling_torque(j, &self.previous) - self.coupling_torque(j, &self.measured);
            let change = self.measured[j] - self.previous[j];
            self.joints[j].interpolate(&mut self.predicted[j], torque, change);
        }
    }

    /// Uses the motor positions; those of a `first` sample have made the state.
    #[inline(always)]
    fn correct(&mut self, theta: &[f64], first: bool) {
        for j in 0..self.joints.len() {
            self.state[j] = self.predicted[j];
            // NaN where θ is missing; the correction then remembers the gap, and the next gain is that of a longer one.
            let innovation = theta[j] - self.predicted[j][0];
            if innovation.is_nan() {
                self.status |= Status::BRIDGED;
            }
            if let Some(deviations) = &self.deviations {
                self.corrections[j].expect(deviations.surprise(j));
            }
            let used = self.corrections[j].apply(&self.joints[j], &mut self.state[j], innovation);
            if let Some(deviations) = self.deviations.as_mut().filter(|_| !first) {
                deviations.take(j, &self.joints[j], &used);
            }
            if self.corrections[j].is_contradicted() {
                self.status |= Status::CONTRADICTED;
            }
        }
    }

    /// Replaces the torque of the last sample (n): a controller knows only after the sample what it commands until the next.
    ///
    /// # Errors
    /// A wrong length.
    pub fn hold(&mut self, tau: &[f64]) -> Result<(), DesignError> {
        expect_length("tau", tau.len(), self.robot.len())?;
        self.hold_torque(tau);
        Ok(())
    }

    /// The torque that acts until the next sample: measured, less dry friction and the spring's nonlinear part.
    #[inline(always)]
    fn hold_torque(&mut self, tau: &[f64]) {
        for j in 0..self.joints.len() {
            if self.models[j] == JointModel::Rigid {
                continue;
            }
            let (drive, x) = (&self.robot.drives[j], &self.state[j]);
            if tau[j].is_nan() {
                self.status |= Status::BRIDGED;
            } else {
                // Feedforward of the nonlinear terms at the estimate keeps the error's dynamics linear but for their
                // own error.
                self.torque[j] = tau[j] - drive.dry_friction(x[2]) - drive.nonlinear_torque(x[0] - x[1]);
            }
        }
    }

    /// What the getters give: the corrected or the predicted state, and the tool.
    #[inline(always)]
    fn report(&mut self) {
        for j in 0..self.joints.len() {
            let x = self.reported(j);
            (self.q[j], self.dq[j], self.ddq[j]) = match self.models[j] {
                JointModel::Rigid => (x[0], x[1], x[2]),
                _ => (x[1], x[3], self.measured[j] - x[4]),
            };
        }
        if let Some(tool) = &self.robot.tool {
            self.kinematics.set_position(&self.robot.tree, &self.q);
            self.tool = self.kinematics.position(tool).0;
        }
    }

    /// The state of a joint that the [`Form`] of the observer reports.
    #[inline(always)]
    fn reported(&self, joint: usize) -> JointState {
        match self.settings.form {
            Form::Current => self.state[joint],
            Form::Predictor => self.predicted[joint],
        }
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    /// Number of acceleration channels that [`ObserverSample::acceleration`] must have.
    pub fn channels(&self) -> usize {
        match self.settings.source {
            AccelerationSource::Joints => self.joints.len(),
            AccelerationSource::Sensors => self.robot.acceleration_channels(),
        }
    }

    /// Link positions (n).
    pub fn q(&self) -> &[f64] {
        &self.q
    }

    /// Link velocities (n).
    pub fn dq(&self) -> &[f64] {
        &self.dq
    }

    /// Link accelerations (n), less their estimated bias.
    pub fn ddq(&self) -> &[f64] {
        &self.ddq
    }

    /// Motor position and velocity of one joint.
    pub fn motor(&self, joint: usize) -> (f64, f64) {
        let x = self.reported(joint);
        match self.models[joint] {
            JointModel::Rigid => (x[0], x[1]),
            _ => (x[0], x[2]),
        }
    }

    /// Standard deviations of link positions (n) [rad]; empty where they are not wanted.
    pub fn q_std(&self) -> &[f64] {
        self.deviations.as_ref().map_or(&[], |deviations| &deviations.q_std)
    }

    /// Those of the tool centre point [m], NaN where there are none.
    pub fn tool_std(&self) -> [f64; 3] {
        self.deviations.as_ref().map_or([f64::NAN; 3], |deviations| deviations.tool_std)
    }

    /// Tool centre point, NaN without one.
    pub fn tool(&self) -> [f64; 3] {
        self.tool
    }

    /// Whether the robot has a tool.
    pub(super) fn has_tool(&self) -> bool {
        self.robot.tool.is_some()
    }

    /// Samples taken.
    pub(super) fn taken(&self) -> usize {
        self.taken
    }

    /// Time since the first sample [s].
    pub fn time(&self) -> f64 {
        self.taken.saturating_sub(1) as f64 * self.settings.period
    }

    /// See [`Status`](crate::estimate::Status).
    pub fn status(&self) -> u8 {
        self.status
    }
}

/// An observer's step, to be compiled for each instruction set.
struct ObserverStep<'a, 'b> {
    observer: &'a mut AccelerationObserver,
    sample: ObserverSample<'b>,
}

impl Kernel for ObserverStep<'_, '_> {
    type Output = Result<(), DesignError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.observer.take_here(self.sample)
    }
}

/// Standard deviations after a step, likewise.
struct Deviate<'a, 'b> {
    deviations: &'a mut ObserverDeviations,
    look: &'a ObserverView<'b>,
    sample: ObserverSample<'b>,
    first: bool,
}

impl Kernel for Deviate<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.deviations.look(self.look, self.sample, self.first);
    }
}

/// A joint's state at these positions of motor and link, and their velocities; no bias is known yet.
fn joint_state(model: JointModel, theta: f64, q: f64, [dtheta, dq]: [f64; 2]) -> JointState {
    match model {
        JointModel::Rigid => [theta, dtheta, 0.0, 0.0, 0.0],
        _ => [theta, q, dtheta, dq, 0.0],
    }
}
