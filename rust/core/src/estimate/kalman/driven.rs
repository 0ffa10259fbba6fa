//! The jerk-driven model as a filter runs it: its channels, and what they say of the motors.
//!
//! Given the links' state, the motor follows from the load: θ = q + φ⁻¹(M q̈ + C q̇ + g + friction − D(θ̇ − q̇)). So the position
//! of a motor is one more sensor of the links, with the noise of its encoder and a relative error of the torsion, and the
//! damping torque is taken from motor velocities: measured where the log has them, else from the slope of the last positions
//! (`motor_velocity`), whose variance is added. Where motor velocities are channels, they are the derivative of the same
//! function along the motion, with the commanded jerk.

use super::jerk::{JerkModel, JerkNoise};
use super::jerk_process::JerkProcess;
use super::model::{Linearised, Measurement, Report};
use super::motor_velocity::MotorVelocity;
use super::output::FilterOutput;
use super::paired::Paired;
use super::recording::{KalmanRecording, KalmanSample};
use super::tolerances::Tolerances;
use super::uncertain::{MotorsAt, Tolerance};
use crate::error::DesignError;
use crate::estimate::measurement::{Channel, Evaluation};
use crate::estimate::observer::Rest;
use crate::scalar::Dual;

/// The jerk-driven model with its noise, as a filter runs it.
///
/// It needs the links' masses and the springs, and no motor torques: what moves the links is taken to be random, beside
/// the jerk that was commanded. Motors are measurements of the links, θ = q + φ⁻¹(M q̈ + C q̇ + g + friction), so that
/// a motor's position tells acceleration as well, through the spring. The example is at
/// [`ExtendedKalmanFilter`](super::ExtendedKalmanFilter).
pub type JerkDriven = Paired<JerkProcess, JerkMeasurement>;

impl JerkDriven {
    /// `model` with `noise`; `damping` says whether the damping torque D(θ̇ − q̇), which the paper drops, is predicted.
    ///
    /// # Errors
    /// Noise that does not fit the model.
    pub fn new(model: JerkModel, noise: JerkNoise, damping: bool) -> Result<Self, DesignError> {
        model.check(&noise)?;
        let measurement = JerkMeasurement::new(model.clone(), noise.clone(), damping);
        Ok(Self::of(JerkProcess { rest: Rest::new(&model.robot), model, noise }, measurement))
    }

    /// The model of a robot of which some numbers are known to a tolerance only.
    pub fn with_tolerances(mut self, tolerances: impl Into<Tolerances>) -> Self {
        self.measurement.tolerances = tolerances.into();
        self
    }

    /// Number of accelerometer channels.
    pub fn acceleration_channels(&self) -> usize {
        self.process.model.acceleration_channels()
    }

    /// The model without its noise.
    pub(crate) fn jerk_model(&self) -> &JerkModel {
        &self.process.model
    }

    /// The noise.
    pub(crate) fn noise(&self) -> &JerkNoise {
        &self.process.noise
    }

    /// Motor velocities for the damping torque, and jerk, of the sample last predicted to.
    pub(crate) fn inputs(&self) -> (&[f64], &[f64]) {
        (&self.measurement.dtheta, &self.measurement.jerk)
    }
}

/// The channels of the jerk-driven model.
#[derive(Clone, Debug)]
pub struct JerkMeasurement {
    /// Channels and biases.
    model: JerkModel,
    /// Standard deviations of readings, and of the predicted torsion.
    noise: JerkNoise,
    /// Whether the damping torque D(θ̇ − q̇) is predicted.
    damping: bool,
    /// h and its Jacobian where the channels were last looked at.
    evaluation: Evaluation<f64>,
    /// Motor positions and how they change in time; there when motor velocities are measured.
    motors: Option<Motors>,
    /// Where the channels are linearised.
    reference: Vec<f64>,
    /// Motor velocities for the damping torque.
    dtheta: Vec<f64>,
    /// Their variances where they come of motor positions; else that is in the motors' noise.
    dtheta_variance: Vec<f64>,
    /// Motor velocities where the log has none.
    slope: MotorVelocity,
    /// Commanded jerk of the sample last predicted to (n) [rad/s³], and the time before it [s].
    jerk: Vec<f64>,
    dt: f64,
    /// Numbers of the robot that are known to a tolerance only.
    tolerances: Tolerances,
}

impl JerkMeasurement {
    fn new(model: JerkModel, noise: JerkNoise, damping: bool) -> Self {
        let (n, m) = (model.joints(), model.channels());
        Self {
            evaluation: Evaluation::disturbed(&model.robot, m, model.disturbances.parts()),
            motors: model.channels.contains(&Channel::MotorVelocity(0)).then(|| Motors::new(&model)),
            reference: vec![0.0; model.dense()],
            dtheta: vec![f64::NAN; n],
            dtheta_variance: vec![0.0; n],
            slope: MotorVelocity::new(n),
            jerk: vec![0.0; n],
            dt: 0.0,
            tolerances: Tolerances::default(),
            model,
            noise,
            damping,
        }
    }
}

impl JerkMeasurement {
    /// What `noise` adds to the variance of a channel where the channels were linearised.
    #[inline(always)]
    pub(super) fn noise_variance(&self, noise: &JerkNoise, i: usize) -> f64 {
        let square = |x: f64| x * x;
        let own = square(noise.reading[i]);
        match self.model.channels[i] {
            Channel::Motor(j) => own + square(noise.torsion * (self.evaluation.prediction[i] - self.reference[j])),
            Channel::MotorVelocity(j) => own + self.jolts(j, 2, &noise.jerk),
            _ => own,
        }
    }

    /// What random walks of states from the `block`-th n on, of these densities, do to the rate of motor `j`'s torsion.
    #[inline(always)]
    fn jolts(&self, j: usize, block: usize, densities: &[f64]) -> f64 {
        let row = &self.evaluation.jacobian[j * self.dense()..][block * self.model.joints()..];
        row.iter().zip(densities).map(|(h, jolt)| (h * jolt) * (h * jolt)).sum::<f64>() / self.dt
    }

    /// What a motor velocity that comes of positions adds to the variance of the predicted torsion, by its damping.
    #[inline(always)]
    fn velocity_variance(&self, joint: usize) -> f64 {
        let (drive, variance) = (&self.model.robot.drives[joint], self.dtheta_variance[joint]);
        if variance == 0.0 || !drive.elastic {
            return 0.0;
        }
        // δ = φ⁻¹(r − D(θ̇ − q̇)): an error of θ̇ moves the torsion by D/φ'(δ). Motors are the first channels.
        let lag = drive.damping * self.evaluation.by_torque[joint];
        lag * lag * variance
    }
}

impl Measurement for JerkMeasurement {
    #[inline(always)]
    fn dense(&self) -> usize {
        self.reference.len()
    }

    #[inline(always)]
    fn biases(&self) -> &[Option<usize>] {
        &self.model.biases
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        let needed = [("dtheta", recording.inputs.dtheta), ("jerk", recording.inputs.jerk)];
        recording.expect(self.model.channels(), self.model.joints(), &needed)
    }

    #[inline(always)]
    fn take(&mut self, sample: &KalmanSample<'_>, first: bool) {
        if first {
            self.slope.reset();
        }
        self.dt = sample.dt;
        self.jerk.copy_from_slice(sample.inputs.jerk);
        if self.damping {
            self.dtheta.copy_from_slice(sample.inputs.dtheta);
            // The readings of this very sample: motor positions are the first n channels, and a slope to now needs
            // them.
            self.slope.push(sample.dt, &sample.readings[..self.jerk.len()]);
            self.slope.fill(&mut self.dtheta, &mut self.dtheta_variance);
        }
    }

    /// Friction elements are no states here: they follow the torsion that the estimate has.
    #[inline(always)]
    fn follow(&mut self, state: &[f64], anew: bool) {
        let Self { model, evaluation, motors, dtheta, .. } = self;
        if evaluation.wound.is_empty() {
            return;
        }
        evaluation.follow(&model.robot, &model.channels, state, dtheta, anew);
        if let Some(motors) = motors {
            motors.evaluation.wound.clone_from_slice(&evaluation.wound);
        }
    }

    fn channels(&self) -> &[Channel] {
        &self.model.channels
    }

    fn tolerances(&self) -> &Tolerances {
        &self.tolerances
    }

    #[inline(always)]
    fn signatures(&mut self, stride: usize, out: &mut [f64]) {
        let Self { model, evaluation, reference, dtheta, tolerances, .. } = self;
        let (n, channels) = (model.joints(), &model.channels);
        let Evaluation { motion, wound, .. } = evaluation;
        let at = MotorsAt { links: &reference[..2 * n], dtheta, wound };
        motion.signatures(&model.robot, channels, tolerances, at, stride, out);
        if let Some(motors) = &mut self.motors {
            motors.signatures(model, tolerances, dtheta, stride, out);
        }
    }

    /// A motor position changes with its link's acceleration by Mⱼⱼ/φ′.
    #[inline(always)]
    fn swings(&self, out: &mut [f64]) {
        let (n, d) = (out.len(), self.reference.len());
        for (j, (out, row)) in out.iter_mut().zip(self.evaluation.jacobian.chunks_exact(d)).enumerate() {
            *out = row[2 * n + j].max(0.0).sqrt();
        }
    }

    #[inline(always)]
    fn evaluate(&mut self, state: &[f64]) -> &[f64] {
        let Self { model, evaluation, dtheta, jerk, motors, .. } = self;
        evaluation.predict(&model.robot, &model.channels, state, dtheta);
        if let Some(motors) = motors {
            motors.evaluate(model, state, dtheta, jerk);
            motors.write_values(&model.channels, evaluation);
        }
        &self.evaluation.prediction
    }

    #[inline(always)]
    fn linearise(&mut self, reference: &[f64]) {
        self.reference.copy_from_slice(reference);
        let Self { model, evaluation, dtheta, jerk, motors, .. } = self;
        evaluation.evaluate(&model.robot, &model.channels, reference, dtheta);
        if let Some(motors) = motors {
            motors.evaluate(model, reference, dtheta, jerk);
            motors.write_values(&model.channels, evaluation);
            motors.write_rows(model, evaluation);
        }
    }

    #[inline(always)]
    fn linearised(&self) -> Linearised<'_> {
        Linearised { prediction: &self.evaluation.prediction, jacobian: &self.evaluation.jacobian }
    }

    fn linearised_mut(&mut self) -> (&mut [f64], &mut [f64]) {
        (&mut self.evaluation.prediction, &mut self.evaluation.jacobian)
    }

    /// A motor position's has a part that grows with its predicted torsion; a motor velocity's, what the jerk that is not
    /// known does to the torsion's rate: with acceleration a random walk, that rate has no variance but over a step.
    #[inline(always)]
    fn variance(&self, i: usize) -> f64 {
        let own = self.noise_variance(&self.noise, i);
        match self.model.channels[i] {
            Channel::Motor(j) => own + self.velocity_variance(j),
            Channel::MotorVelocity(j) => own + self.jolts(j, 3, &self.model.disturbances.walk),
            _ => own,
        }
    }
}

impl Report for JerkMeasurement {
    fn memory(&self) -> usize {
        let n = self.model.joints();
        n * (self.dense() + 2) + self.dense()
    }

    /// Where the motors' channels were linearised, and the result.
    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        let n = self.model.joints();
        memory.extend_from_slice(&self.evaluation.jacobian[..n * self.dense()]);
        memory.extend_from_slice(&self.evaluation.prediction[..n]);
        memory.extend_from_slice(&self.reference);
        memory.extend_from_slice(&self.jerk);
    }

    /// The first n channels are the motors': their positions by the linearisation, their velocities by its rate.
    #[inline(always)]
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput) {
        let (n, d) = (self.model.joints(), self.dense());
        let (jacobian, rest) = memory.split_at(n * d);
        let (prediction, rest) = rest.split_at(n);
        let (reference, jerk) = rest.split_at(d);
        for (signal, values) in [&mut out.q, &mut out.dq, &mut out.ddq].into_iter().zip(state.chunks_exact(n)) {
            signal[i * n..][..n].copy_from_slice(values);
        }
        for (j, row) in jacobian.chunks_exact(d).enumerate() {
            let (mut theta, mut dtheta) = (prediction[j], 0.0);
            // θ(x) ≈ θ(x₀) + H (x − x₀), θ̇ = H ẋ with ẋ = (q̇, q̈, jerk): the linearisation that the update has used.
            for k in 0..3 * n {
                theta += row[k] * (state[k] - reference[k]);
                dtheta += row[k] * if k < 2 * n { state[n + k] } else { jerk[k - 2 * n] };
            }
            for k in 3 * n..d {
                theta += row[k] * (state[k] - reference[k]);
                dtheta += row[k] * self.model.disturbances.rate(k - 3 * n, state[k]);
            }
            (out.theta[i * n + j], out.dtheta[i * n + j]) = (theta, dtheta);
        }
    }
}

/// Motor positions with their rates: numbers that carry the derivative along time.
///
/// θ̇ = H ẋ: what a motor velocity measures is the rate of what its position does, so that one text serves both, over
/// numbers that carry a derivative along time.
#[derive(Clone, Debug)]
struct Motors {
    /// One motor position a joint.
    channels: Vec<Channel>,
    /// Their predictions and Jacobian, with the rate of everything.
    evaluation: Evaluation<Dual<1>>,
    /// (q, q̇, q̈) with rates (q̇, q̈, jerk).
    state: Vec<Dual<1>>,
    /// Scratch of the signatures.
    rates: Vec<Dual<1>>,
}

impl Motors {
    fn new(model: &JerkModel) -> Self {
        let n = model.joints();
        Self {
            channels: (0..n).map(Channel::Motor).collect(),
            evaluation: Evaluation::disturbed(&model.robot, n, model.disturbances.parts()),
            state: vec![Dual::default(); model.dense()],
            rates: Vec::new(),
        }
    }

    /// At a state that moves with `jerk`; the damping torque's `dtheta` is taken to stay.
    #[inline(always)]
    fn evaluate(&mut self, model: &JerkModel, state: &[f64], dtheta: &[f64], jerk: &[f64]) {
        let (n, torques) = (jerk.len(), &model.disturbances);
        let fading = state[3 * n..].iter().enumerate().map(|(j, &d)| torques.rate(j, d));
        let rates = state[n..3 * n].iter().chain(jerk).copied().chain(fading);
        for ((x, &value), rate) in self.state.iter_mut().zip(state).zip(rates) {
            *x = Dual { value, gradient: [rate] };
        }
        self.evaluation.evaluate(&model.robot, &self.channels, &self.state, dtheta);
    }

    /// Rates of the motor positions' signatures into the rows of the motor velocities.
    #[inline(always)]
    fn signatures(
        &mut self,
        model: &JerkModel,
        tolerances: &[Tolerance],
        dtheta: &[f64],
        stride: usize,
        out: &mut [f64],
    ) {
        let n = self.channels.len();
        let Self { channels, evaluation, state, rates } = self;
        rates.resize(n * stride, Dual::default());
        let Evaluation { motion, wound, .. } = evaluation;
        let at = MotorsAt { links: &state[..2 * n], dtheta, wound };
        motion.signatures(&model.robot, channels, tolerances, at, stride, rates);
        for (out, channel) in out.chunks_exact_mut(stride).zip(&model.channels) {
            let Channel::MotorVelocity(j) = *channel else { continue };
            for (out, rate) in out.iter_mut().zip(&rates[j * stride..]) {
                *out = rate.gradient[0];
            }
        }
    }

    /// θ̇ = H ẋ into the motor velocities.
    #[inline(always)]
    fn write_values(&self, channels: &[Channel], out: &mut Evaluation<f64>) {
        for (i, channel) in channels.iter().enumerate() {
            let Channel::MotorVelocity(j) = *channel else { continue };
            out.prediction[i] = self.evaluation.prediction[j].gradient[0];
        }
    }

    /// ∂θ̇/∂x = Ḣ + H ∂ẋ/∂x into their rows.
    #[inline(always)]
    fn write_rows(&self, model: &JerkModel, out: &mut Evaluation<f64>) {
        let (n, d) = (self.channels.len(), model.dense());
        for (i, channel) in model.channels.iter().enumerate() {
            let Channel::MotorVelocity(j) = *channel else { continue };
            let row = &self.evaluation.jacobian[j * d..][..d];
            for (k, out) in out.jacobian[i * d..][..3 * n].iter_mut().enumerate() {
                // ∂ẋ/∂x shifts by one block: q's rate is q̇, q̇'s is q̈; jerk does not depend on the state.
                *out = row[k].gradient[0] + if k < n { 0.0 } else { row[k - n].value };
            }
            for k in 3 * n..d {
                let fading = model.disturbances.forgetting(k - 3 * n) * row[k].value;
                out.jacobian[i * d + k] = row[k].gradient[0] - fading;
            }
        }
    }
}
