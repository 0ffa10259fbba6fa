//! What a Kalman filter asks of a model: a process, and the channels that measure it, each a part of its own.
//!
//! | who | asks for |
//! | --- | --- |
//! | the filter | [`start`](Process::start), [`predict`](Process::predict), [`linearise`](Measurement::linearise), [`variance`](Measurement::variance), [`report`](Report::report) |
//! | the smoother | [`remember`](Process::remember) on the way out; [`retreat`](Process::retreat) and [`noise_rows`](Process::noise_rows) on the way back |
//! | parameters known to a tolerance | [`signatures`](Measurement::signatures), and their columns through [`carry`](Process::carry) and [`drive`](Process::drive) |
//! | a filter that needs h alone | [`evaluate`](Measurement::evaluate) |
//!
//! [`Paired`](super::Paired) joins a process and a measurement to a [`Model`], and puts the states of late sensors behind them. A process of
//! another kind, or another set of channels, is one file that implements its trait.

use super::gaussian::{Gaussian, Symmetric};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample};
use super::sigma_points::SigmaRule;
use super::tolerances::Tolerances;
use crate::error::DesignError;
use crate::estimate::measurement::Channel;
use crate::linear;
use crate::robot::Robot;

/// How the state moves: f, Q, and the adjoint that a smoother needs.
///
/// The state begins with the link positions (n).
///
/// A filter asks for [`start`](Self::start) and [`predict`](Self::predict); the rest serves the smoother, which goes
/// through the same steps backwards, and parameters, whose columns are propagated too. All in place, without allocating.
pub trait Process: Clone + Send + Sync {
    /// The robot.
    fn robot(&self) -> &Robot;

    /// Number of states.
    fn states(&self) -> usize;

    /// Makes room for beliefs of `states`, of which those that are not its own stay as they are.
    fn widen(&mut self, _states: usize) {}

    /// From now on goes by sigma points where it is not linear; none: by derivatives.
    fn set_points(&mut self, _rule: Option<SigmaRule>) {}

    /// Whether a recording has the signals that drive the process, in arrays that fit.
    ///
    /// # Errors
    /// Wrong lengths.
    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError>;

    /// The belief at a recording's first sample, at rest.
    ///
    /// # Errors
    /// A first sample without a motor position that it needs, or no static equilibrium.
    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError>;

    /// Takes over a first sample at which the belief is known.
    fn resume(&mut self, _sample: &KalmanSample<'_>, _belief: &Gaussian) {}

    /// Whether a signal that drives the process was missing at the sample last predicted to, and was bridged.
    fn bridged(&self) -> bool {
        false
    }

    /// The first of the links' disturbance torques in the state, which has one a joint or none.
    #[inline(always)]
    fn link_disturbance(&self) -> Option<usize> {
        None
    }

    /// The first number of the varying wrenches in the state.
    #[inline(always)]
    fn wrench(&self) -> Option<usize> {
        None
    }

    /// Time update from the sample before: x ← f(x), P ← F P Fᵀ + Q.
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian);

    /// Columns (states × `stride`) through the step last predicted: Σ ← F Σ.
    fn carry(&mut self, columns: &mut [f64], stride: usize, dt: f64);

    /// The same in single precision.
    fn carry_single(&mut self, columns: &mut [f32], stride: usize, dt: f64);

    /// What parameters do over the step last predicted: Σ ← Σ + ∂f/∂p, one column a tolerance.
    fn drive(&mut self, _columns: &mut [f64], _stride: usize) {}

    /// The adjoint of [`carry`](Self::carry): Λ ← Fᵀ Λ; of a process on which parameters count.
    fn carry_back(&mut self, _memory: &[f64], _columns: &mut [f64], _stride: usize, _dt: f64) {}

    /// How many numbers [`remember`](Self::remember) writes.
    fn memory(&self) -> usize;

    /// What [`retreat`](Self::retreat) needs of this sample.
    fn remember(&self, memory: &mut Vec<f64>);

    /// Writes rows Gᵀ with G Gᵀ = Q of [`predict`](Self::predict), at most one a state, `stride` apart, into `rows`, which
    /// are zero.
    fn noise_rows(&mut self, memory: &[f64], dt: f64, rows: &mut [f64], stride: usize);

    /// The adjoint of [`predict`](Self::predict) without its noise: λ ← Fᵀ λ, Λ ← Fᵀ Λ F.
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric);
}

/// What is read in a state: h, its derivatives, and the variances of the noise.
///
/// Channels depend on the state's first [`dense`](Self::dense) entries, and each may have one further state that is its
/// bias.
///
/// What a channel reads is in [`measurement`](crate::estimate::measurement); here it meets a state and its noise.
pub trait Measurement: Clone + Send + Sync {
    /// Number of leading states on which channels may depend by more than a bias.
    fn dense(&self) -> usize;

    /// The state that is each channel's bias (channels).
    fn biases(&self) -> &[Option<usize>];

    /// Whether a recording has the signals that channels depend on beside the state, in arrays that fit.
    ///
    /// # Errors
    /// Wrong lengths.
    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError>;

    /// Takes over those signals of a sample, of a recording's `first` or of a later one.
    fn take(&mut self, sample: &KalmanSample<'_>, first: bool);

    /// h alone, without bias (channels), at a state's first [`dense`](Self::dense) entries.
    fn evaluate(&mut self, state: &[f64]) -> &[f64];

    /// Lets what depends on the past, and is no state, follow to the estimate of the last sample, before time goes on; `anew` at
    /// a first sample.
    fn follow(&mut self, _state: &[f64], _anew: bool) {}

    /// h and its derivatives.
    fn linearise(&mut self, reference: &[f64]);

    /// What [`linearise`](Self::linearise) found.
    fn linearised(&self) -> Linearised<'_>;

    /// The same, predictions and derivatives, to be replaced by those of a regression.
    fn linearised_mut(&mut self) -> (&mut [f64], &mut [f64]);

    /// Variance of a channel's noise, where the channels were linearised.
    fn variance(&self, channel: usize) -> f64;

    /// What the channels are.
    fn channels(&self) -> &[Channel];

    /// Numbers of the robot that are known to a tolerance only, and count in covariances; none unless asked for.
    fn tolerances(&self) -> &Tolerances;

    /// Whether a channel's present reading may say something of those numbers.
    fn teaches(&self, channel: usize) -> bool {
        teaches(self.channels()[channel])
    }

    /// ∂h/∂p where the channels were linearised (channels × `stride`).
    fn signatures(&mut self, _stride: usize, _out: &mut [f64]) {}

    /// Σ of a first sample (states × `stride`), links being where motors' readings and the predicted torsion put them;
    /// `scratch` is as `out` of [`signatures`](Self::signatures).
    fn start_columns(&mut self, stride: usize, scratch: &mut [f64], columns: &mut [f64]) {
        self.signatures(stride, scratch);
        for (channel, signature) in self.channels().iter().zip(scratch.chunks_exact(stride)) {
            if let Channel::Motor(joint) = *channel {
                linear::add_scaled(&mut columns[joint * stride..][..stride], -1.0, signature);
            }
        }
    }

    /// √(Mⱼⱼ/φ′) of each joint where the channels were linearised (n) [s/rad]: by it a link that swings on its spring is behind
    /// its velocity; 0 of a rigid joint.
    fn swings(&self, _out: &mut [f64]) {}

    /// The state that is the velocity of joint `j`'s motor behind a spring, of a model that has it.
    fn motor_velocity(&self, _j: usize) -> Option<usize> {
        None
    }
}

/// Whether a channel may say something of parameters. A motor's reading says it only by way of how smoothly links are taken
/// to move, which is a guess.
#[inline(always)]
pub(super) fn teaches(channel: Channel) -> bool {
    !matches!(channel, Channel::Motor(_) | Channel::MotorVelocity(_) | Channel::Position { .. })
}

/// What an estimate says of links and motors.
pub trait Report {
    /// How many numbers [`remember`](Self::remember) writes.
    fn memory(&self) -> usize;

    /// What [`report`](Self::report) needs of this sample.
    fn remember(&self, memory: &mut Vec<f64>);

    /// Writes links and motors at `state` into row `i`.
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput);
}

/// A process and the channels that measure it, as filter and smoother see them.
pub trait Model: Clone + Send + Sync {
    /// The robot.
    fn robot(&self) -> &Robot;

    /// Number of states.
    fn states(&self) -> usize;

    /// Number of states, but for those of late sensors, which follow them.
    fn own_states(&self) -> usize;

    /// See [`Measurement::dense`].
    fn dense(&self) -> usize;

    /// See [`Measurement::biases`].
    fn biases(&self) -> &[Option<usize>];

    /// Number of channels.
    fn channels(&self) -> usize {
        self.biases().len()
    }

    /// Whether a recording has all that the model needs, in arrays that fit.
    ///
    /// # Errors
    /// Wrong lengths.
    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError>;

    /// See [`Process::start`].
    ///
    /// # Errors
    /// As there.
    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError>;

    /// Takes over a first sample at which the belief is known.
    fn resume(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian);

    /// See [`Process::predict`].
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian);

    /// Predicts the channels of the sample last predicted to, and their derivatives; see [`Measurement::linearise`].
    fn linearise(&mut self, reference: &[f64]);

    /// From now on goes by sigma points in place of derivatives where it can; none: by derivatives.
    fn set_points(&mut self, rule: Option<SigmaRule>);

    /// Whether it goes by sigma points.
    fn has_points(&self) -> bool;

    /// As [`linearise`](Self::linearise), by the regression on a belief of this mean and covariance.
    fn regress(&mut self, reference: &[f64], covariance: &Symmetric);

    /// Covariance of what the regression leaves of the channels (channels × channels), where there is one.
    fn residual(&self) -> Option<&Symmetric>;

    /// What [`linearise`](Self::linearise) found, or [`regress`](Self::regress).
    fn linearised(&self) -> Linearised<'_>;

    /// See [`Measurement::variance`].
    fn variance(&self, channel: usize) -> f64;

    /// Whether what drives the model was missing at the sample last predicted to, and was bridged.
    fn bridged(&self) -> bool {
        false
    }

    /// See [`Process::link_disturbance`].
    fn link_disturbance(&self) -> Option<usize> {
        None
    }

    /// See [`Process::wrench`].
    fn wrench(&self) -> Option<usize> {
        None
    }

    /// Number of leading states whose standard deviations are reported, or have one that is among them.
    fn reported(&self) -> usize {
        let wrenches = self.wrench().map_or(0, |first| first + self.robot().wrench_states());
        wrenches.max(self.link_disturbance().unwrap_or(0) + self.robot().len())
    }

    /// How many numbers [`remember`](Self::remember) writes.
    fn memory(&self) -> usize;

    /// What [`report`](Self::report) and [`retreat`](Self::retreat) need of this sample.
    fn remember(&self, memory: &mut Vec<f64>);

    /// See [`Process::noise_rows`].
    fn noise_rows(&mut self, memory: &[f64], dt: f64, rows: &mut [f64], stride: usize);

    /// The adjoint of what late sensors do at the end of a step: λ ← Tᵀ λ, Λ ← Tᵀ Λ T.
    fn retreat_sensors(&mut self, memory: &[f64], lambda: &mut [f64], big: &mut Symmetric);

    /// See [`Process::retreat`]; after [`retreat_sensors`](Self::retreat_sensors).
    fn retreat(&mut self, memory: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric);

    /// See [`Measurement::channels`].
    fn channel_kinds(&self) -> &[Channel];

    /// See [`Measurement::tolerances`].
    fn tolerances(&self) -> &Tolerances;

    /// See [`Measurement::teaches`].
    fn teaches(&self, channel: usize) -> bool;

    /// Columns (states × `stride`, one a tolerance) through the step last predicted: Σ ← F Σ + ∂f/∂p.
    fn carry(&mut self, columns: &mut [f64], stride: usize, dt: f64);

    /// The same without what parameters do: Σ ← F Σ.
    fn carry_noise_free(&mut self, columns: &mut [f64], stride: usize, dt: f64);

    /// The same in single precision.
    fn carry_single(&mut self, columns: &mut [f32], stride: usize, dt: f64);

    /// The adjoint of what F does in [`carry`](Self::carry): Λ ← Fᵀ Λ.
    #[inline(always)]
    fn carry_back(&mut self, memory: &[f64], columns: &mut [f64], stride: usize, dt: f64) {
        self.carry_back_sensors(memory, columns, stride);
        self.carry_back_process(memory, columns, stride, dt);
    }

    /// Its part by late sensors, which moved last: between the two is where noise entered.
    fn carry_back_sensors(&mut self, memory: &[f64], columns: &mut [f64], stride: usize);

    /// Its part by the process.
    fn carry_back_process(&mut self, memory: &[f64], columns: &mut [f64], stride: usize, dt: f64);

    /// See [`Measurement::signatures`].
    fn signatures(&mut self, stride: usize, out: &mut [f64]);

    /// See [`Measurement::swings`].
    fn swings(&self, out: &mut [f64]);

    /// See [`Measurement::motor_velocity`].
    fn motor_velocity(&self, j: usize) -> Option<usize>;

    /// See [`Measurement::start_columns`].
    fn start_columns(&mut self, stride: usize, scratch: &mut [f64], columns: &mut [f64]);

    /// See [`Report::report`].
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput);
}

/// Channels at one state.
#[derive(Clone, Copy, Debug)]
pub struct Linearised<'a> {
    /// Predictions, without bias (channels).
    pub prediction: &'a [f64],
    /// Their derivatives, channels × dense, row-major.
    pub jacobian: &'a [f64],
}
