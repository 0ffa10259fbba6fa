//! The error of one joint's estimate: its covariance by noise, and how it goes with numbers that are not known exactly.
//!
//! Theorem 1 of De Luca, Schröder and Thümmel (2007) has the error e = x − x̂ obey linear dynamics of known gains, whatever
//! the links do. In discrete time, with the gain g that a sample's motor position was used with,
//! e ← (1 − g C)(Φ e + H u) − g v: u is what torque and acceleration are off by, v what the reading is off by. Noise makes a
//! covariance of it. What a number of the robot is off by lasts, so that its effects add up: it makes a column ∂e/∂p, which
//! the same dynamics carry along, driven by ∂u/∂p at the estimate.

use super::late::JointCovariance;
use super::matrix::{self, JointMatrix};
use super::sampled::{JointState, ORDER, Sampled};
use crate::linear::LANES;
use core::ops::Range;

/// A correction leaves at least this share of an innovation.
const LEAST: f64 = 1e-6;

/// What drives a joint's error, in the order of layouts: what its motor position reads too much [rad], what its motor feels more than
/// the model has it [N m], and what its link is accelerated more than measured [rad/s²].
const INPUTS: usize = 3;
const TORQUE: usize = 1;

/// How a joint's state was corrected at a sample.
#[derive(Clone, Copy, Debug)]
pub(super) enum Used {
    /// By the gain of the poles.
    Poles,
    /// By another one.
    Gain(JointState),
    /// Not at all.
    Nothing,
}

/// What some samples do to the error of a joint.
#[derive(Clone, Copy, Debug)]
struct ErrorStep {
    /// (1 − g C) Φ, of several samples their product.
    error: JointMatrix,
    /// What a unit of each input that is held meanwhile adds.
    inputs: [JointState; INPUTS],
    /// The covariance that noise of readings and torques adds, and a unit variance of the acceleration's, independent from sample
    /// to sample.
    noise: JointMatrix,
    shaken: JointMatrix,
}

impl ErrorStep {
    /// Of a sample at which an innovation was used with `gain`, with variances of readings and of torques.
    fn of(joint: &Sampled, gain: &JointState, variances: [f64; 2]) -> Self {
        let corrected = |x: &JointState| core::array::from_fn(|i| x[i] - gain[i] * x[0]);
        let (phi, [torque, acceleration]) = (joint.transition(), joint.held());
        let inputs = [gain.map(|g| -g), corrected(torque), corrected(acceleration)];
        let error = core::array::from_fn(|i| core::array::from_fn(|j| phi[i][j] - gain[i] * phi[0][j]));
        let [reading, torque, shaken] = inputs.map(|input| matrix::square(&input));
        let mut noise = JointMatrix::default();
        matrix::add_scaled(&mut noise, variances[0], &reading);
        matrix::add_scaled(&mut noise, variances[1], &torque);
        Self { error, inputs, noise, shaken }
    }

    /// Of `times` such samples.
    fn repeated(&self, times: u32) -> Self {
        let mut all = *self;
        for _ in 1..times {
            for (input, once) in all.inputs.iter_mut().zip(&self.inputs) {
                *input = matrix::apply(&self.error, input);
                input.iter_mut().zip(once).for_each(|(all, once)| *all += once);
            }
            for (noise, once) in [(&mut all.noise, &self.noise), (&mut all.shaken, &self.shaken)] {
                *noise = matrix::congruence(&self.error, noise);
                matrix::add_scaled(noise, 1.0, once);
            }
            all.error = matrix::multiply(&self.error, &all.error);
        }
        all
    }
}

/// Where the columns of each input are, all multiples of [`LANES`].
pub(super) type Layout = [Range<usize>; INPUTS];

/// See the [module](self).
#[derive(Clone, Debug)]
pub(super) struct JointError {
    /// States of the joint's model, and which of them is its link's position.
    order: usize,
    link: usize,
    layout: Layout,
    stride: usize,
    /// ∂e/∂p (order × stride), each number in units of its standard deviation.
    columns: Vec<f64>,
    /// ∂u/∂p and ∂v/∂p as they were last computed, and as they now are (stride).
    drive: Vec<f64>,
    pub(super) next: Vec<f64>,
    /// Covariance by noise, and the variances of that: of readings and torques, and of the acceleration.
    noise: JointCovariance,
    variances: [f64; 2],
    pub(super) shaking: f64,
    /// One sample corrected by the poles, and as many as are taken at once.
    once: ErrorStep,
    often: ErrorStep,
    every: u32,
    /// Such samples that have not been accounted for.
    pending: u32,
    /// One over the share of an innovation that the last correction left of it, and that the poles' one does.
    magnified: f64,
    usual: f64,
}

impl JointError {
    /// Of a joint whose samples are taken `every` so many at once; `variances` of the noise of readings and of torques.
    pub(super) fn new(
        joint: &Sampled,
        [order, link]: [usize; 2],
        (layout, stride): (Layout, usize),
        every: u32,
        variances: [f64; 2],
    ) -> Self {
        let once = ErrorStep::of(joint, joint.gain(), variances);
        let usual = 1.0 / (1.0 - joint.gain()[0]).max(LEAST);
        Self {
            order,
            link,
            stride,
            columns: vec![0.0; order * stride],
            drive: vec![0.0; stride],
            next: vec![0.0; stride],
            noise: JointCovariance::default(),
            variances,
            shaking: 0.0,
            often: once.repeated(every),
            once,
            every,
            pending: 0,
            magnified: usual,
            usual,
            layout,
        }
    }

    /// At the first sample: known to `spread`, by noise, and to what `column` shifts the link by for unit errors (stride).
    pub(super) fn begin(&mut self, spread: JointCovariance, shift: impl Fn(usize) -> f64) {
        self.noise = spread;
        self.pending = 0;
        self.columns.fill(0.0);
        for column in 0..self.stride {
            self.columns[self.link * self.stride + column] = shift(column);
        }
    }

    /// What is driven from the first sample on.
    pub(super) fn hold(&mut self) {
        self.drive.copy_from_slice(&self.next);
    }

    /// One sample on.
    #[inline(always)]
    pub(super) fn take(&mut self, joint: &Sampled, used: &Used) {
        match used {
            Used::Poles => {
                self.pending += 1;
                self.magnified = self.usual;
            }
            Used::Gain(gain) => self.take_apart(joint, gain),
            Used::Nothing => self.take_apart(joint, &JointState::default()),
        }
    }

    /// One with another gain, and those that wait before it.
    fn take_apart(&mut self, joint: &Sampled, gain: &JointState) {
        self.catch_up();
        let step = ErrorStep::of(joint, gain, self.variances);
        self.advance(&step);
        self.magnified = 1.0 / (1.0 - gain[0]).max(LEAST);
    }

    /// All samples so far, with what drove them on a straight line from what it was to what it now is.
    #[inline(always)]
    pub(super) fn close(&mut self) {
        self.drive.iter_mut().zip(&self.next).for_each(|(mean, next)| *mean = 0.5 * (*mean + next));
        self.catch_up();
        self.hold();
    }

    #[inline(always)]
    fn catch_up(&mut self) {
        if self.pending == self.every {
            let step = self.often;
            self.advance(&step);
        } else {
            let step = self.once;
            (0..self.pending).for_each(|_| self.advance(&step));
        }
        self.pending = 0;
    }

    #[inline(always)]
    fn advance(&mut self, step: &ErrorStep) {
        match self.order {
            3 => self.carry::<3>(step),
            4 => self.carry::<4>(step),
            _ => self.carry::<ORDER>(step),
        }
    }

    /// The same for a model of `N` states.
    #[inline(always)]
    fn carry<const N: usize>(&mut self, step: &ErrorStep) {
        let error: [[f64; N]; N] = core::array::from_fn(|i| core::array::from_fn(|k| step.error[i][k]));
        for (range, input) in self.layout.iter().zip(&step.inputs) {
            let input: [f64; N] = core::array::from_fn(|i| input[i]);
            carry_columns(&error, &input, &self.drive, &mut self.columns, self.stride, range.clone());
        }
        let mut half = [[0.0; N]; N];
        for i in 0..N {
            for k in 0..N {
                (0..N).for_each(|j| half[i][j] += error[i][k] * self.noise[k][j]);
            }
        }
        for i in 0..N {
            for j in i..N {
                let mut sum = step.noise[i][j] + self.shaking * step.shaken[i][j];
                (0..N).for_each(|k| sum += half[i][k] * error[j][k]);
                (self.noise[i][j], self.noise[j][i]) = (sum, sum);
            }
        }
    }

    /// By how much one standard deviation of each number moves the link (stride) [rad].
    #[inline(always)]
    pub(super) fn of_link(&self) -> &[f64] {
        &self.columns[self.link * self.stride..][..self.stride]
    }

    /// The link's variance by noise [rad²].
    #[inline(always)]
    pub(super) fn noise(&self) -> f64 {
        self.noise[self.link][self.link].max(0.0)
    }

    /// Mean square of what a unit step of torque makes of innovations [(rad/(N m))²], over `samples` from its beginning.
    pub(super) fn shock(&self, samples: usize) -> f64 {
        let (mut x, mut sum) = (JointState::default(), 0.0);
        for _ in 0..samples {
            let before = matrix::apply(&self.once.error, &x);
            x = core::array::from_fn(|i| before[i] + self.once.inputs[TORQUE][i]);
            sum += (x[0] * self.usual).powi(2);
        }
        sum / samples as f64
    }

    /// Variance of an innovation: by the numbers, and by noise [rad²].
    ///
    /// An innovation that was used with the gain g left (1 − g₁) of itself in the error of θ, less what the reading was off by.
    #[inline(always)]
    pub(super) fn surprise(&self) -> f64 {
        let [readings, ..] = &self.layout;
        let of = |(k, x): (usize, &f64)| {
            let reading = if readings.contains(&k) { self.drive[k] } else { 0.0 };
            (x + reading).powi(2)
        };
        let known: f64 = self.columns[..self.stride].iter().enumerate().map(of).sum();
        // P₁₁ = (1 − g₁)² P⁻₁₁ + g₁² r, and the innovation's variance P⁻₁₁ + r.
        let (gain, [reading, _]) = (1.0 - 1.0 / self.magnified, self.variances);
        let before = (self.noise[0][0] - gain * gain * reading).max(0.0);
        (known + before) * self.magnified * self.magnified + reading
    }
}

/// Columns of a range through the error's dynamics, [`LANES`] at a time.
#[inline(always)]
fn carry_columns<const N: usize>(
    error: &[[f64; N]; N],
    input: &[f64; N],
    drive: &[f64],
    columns: &mut [f64],
    stride: usize,
    range: Range<usize>,
) {
    for at in range.step_by(LANES) {
        let mut x = [[0.0; LANES]; N];
        for (i, x) in x.iter_mut().enumerate() {
            x.copy_from_slice(&columns[i * stride + at..][..LANES]);
        }
        let mut held = [0.0; LANES];
        held.copy_from_slice(&drive[at..][..LANES]);
        for i in 0..N {
            let out = &mut columns[i * stride + at..][..LANES];
            for l in 0..LANES {
                let mut sum = input[i] * held[l];
                for (k, x) in x.iter().enumerate() {
                    sum += error[i][k] * x[l];
                }
                out[l] = sum;
            }
        }
    }
}
