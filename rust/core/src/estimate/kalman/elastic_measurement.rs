//! The elastic-joint model's channels: motors are states, accelerations functions of the state and the torques.

use super::elastic_sensitivity::ElasticSensitivity;
use super::model::{Linearised, Measurement, Report, teaches};
use super::output::FilterOutput;
use super::recording::{KalmanRecording, KalmanSample};
use super::tolerances::Tolerances;
use crate::dynamics::{ElasticDynamics, ElasticLayout};
use crate::error::DesignError;
use crate::estimate::measurement::{Chained, Channel, Elastic, Values, read_all};
use crate::linear;
use crate::robot::Robot;
use std::sync::Arc;

/// Part of the noise of a channel's own from which on the noise of torques in it counts.
const HEARD: f64 = 0.1;

/// See the module.
///
/// h(x) reads links, motors and accelerations off the forward dynamics under the sample's torques. Its Jacobian follows
/// by ∂h/∂x = ∂h/∂(q, q̇) + ∂h/∂q̈ ∂q̈/∂x (`Chained`).
#[derive(Clone, Debug)]
pub struct ElasticMeasurement {
    /// Links, drives and sensors.
    robot: Arc<Robot>,
    /// Where in the state each joint's numbers are.
    layout: ElasticLayout,
    /// Accelerations and derivatives where the channels were last looked at.
    dynamics: ElasticDynamics,
    /// What is measured, in the order of the readings, and which state is its bias.
    channels: Vec<Channel>,
    biases: Vec<Option<usize>>,
    /// Variance of one reading's noise (channels), and of one reading of each motor torque (n).
    reading: Vec<f64>,
    torque: Vec<f64>,
    /// Whether motor torques reach links without a spring in between: what they read then shows at once in other readings.
    direct: bool,
    /// Variances of readings' noise with what that adds (channels).
    variance: Vec<f64>,
    /// Scratch: what each torque does to each channel (channels × n), and how much to all of them (n).
    felt: Vec<f64>,
    sums: Vec<f64>,
    /// h (channels), and ∂h/∂x (channels × dense).
    prediction: Vec<f64>,
    jacobian: Vec<f64>,
    /// Motor torques at the sample.
    tau: Vec<f64>,
    /// ∂q̈/∂p and ∂θ̈/∂p of numbers that are known to a tolerance only.
    pub(super) sensitivity: ElasticSensitivity,
    /// Where the channels are linearised.
    reference: Vec<f64>,
}

impl ElasticMeasurement {
    pub(super) fn new(
        robot: Arc<Robot>,
        layout: ElasticLayout,
        channels: Vec<Channel>,
        biases: Vec<Option<usize>>,
        [reading, torque]: [&[f64]; 2],
    ) -> Self {
        let m = channels.len();
        let squares = |std: &[f64]| std.iter().map(|s| s * s).collect::<Vec<_>>();
        let coupled = !robot.rotors.is_empty() || robot.coupling.iter().any(|&s| s != 0.0);
        Self {
            direct: (coupled || robot.drives.iter().any(|drive| !drive.elastic)) && torque.iter().any(|&s| s > 0.0),
            variance: squares(reading),
            felt: vec![0.0; m * robot.len()],
            sums: vec![0.0; robot.len()],
            torque: squares(torque),
            reading: squares(reading),
            dynamics: ElasticDynamics::new(&robot, &layout),
            prediction: vec![0.0; m],
            jacobian: vec![0.0; m * layout.dense],
            tau: vec![0.0; robot.len()],
            sensitivity: ElasticSensitivity::default(),
            reference: vec![0.0; layout.dense],
            robot,
            layout,
            channels,
            biases,
        }
    }

    /// What the noise of motor torques is to accelerometers and joint torque sensors: of a motor behind a rigid drive, or
    /// coupled to links, it is acceleration at once.
    ///
    /// One motor's noise is in many channels at once, g gᵀ; what each has of it by itself, |gᵢ| Σₖ|gₖ|, is no less than that in
    /// any combination of channels.
    #[inline(always)]
    fn hear_torques(&mut self) {
        let Self { robot, dynamics, channels, reading, torque, variance, felt, sums, .. } = self;
        let n = robot.len();
        felt.fill(0.0);
        sums.fill(0.0);
        for (channel, felt) in channels.iter().zip(felt.chunks_exact_mut(n)) {
            match *channel {
                Channel::Acceleration { sensor, axis } => {
                    dynamics.kinematics.acceleration_map(&robot.tree, &robot.accelerometers[sensor].frame, |j, by| {
                        linear::add_scaled(felt, by.0[axis], &dynamics.ddq_by_tau[j * n..][..n]);
                    });
                }
                Channel::Torque(j) if !robot.drives[j].elastic => {
                    felt[j] = 1.0;
                    linear::add_scaled(felt, -robot.drives[j].motor_inertia, &dynamics.ddq_by_tau[j * n..][..n]);
                    for (k, s) in dynamics.coupling(j) {
                        linear::add_scaled(felt, -s, &dynamics.ddq_by_tau[k * n..][..n]);
                    }
                }
                _ => continue,
            }
            sums.iter_mut().zip(&*felt).for_each(|(sum, by)| *sum += by.abs());
        }
        for ((variance, own), felt) in variance.iter_mut().zip(reading).zip(felt.chunks_exact(n)) {
            let shares = felt.iter().zip(&*sums).zip(&*torque);
            *variance = *own + shares.map(|((by, sum), torque)| by.abs() * sum * torque).sum::<f64>();
        }
    }
}

impl Measurement for ElasticMeasurement {
    #[inline(always)]
    fn dense(&self) -> usize {
        self.layout.dense
    }

    #[inline(always)]
    fn biases(&self) -> &[Option<usize>] {
        &self.biases
    }

    fn channels(&self) -> &[Channel] {
        &self.channels
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        let tau = ("tau", recording.inputs.tau);
        let needed = if self.layout.motor_acceleration.is_some() { &[][..] } else { &[tau][..] };
        recording.expect(self.channels.len(), self.robot.len(), needed)
    }

    #[inline(always)]
    fn take(&mut self, sample: &KalmanSample<'_>, _: bool) {
        for (held, &read) in self.tau.iter_mut().zip(sample.inputs.tau).filter(|(_, read)| !read.is_nan()) {
            *held = read;
        }
    }

    #[inline(always)]
    fn evaluate(&mut self, state: &[f64]) -> &[f64] {
        let Self { robot, layout, dynamics, channels, tau, prediction, .. } = self;
        let n = robot.len();
        dynamics.accelerate(robot, layout, state, tau);
        dynamics.kinematics.set_motion(&robot.tree, &state[..n], &state[n..2 * n], &dynamics.ddq);
        read_all(robot, channels, &Elastic { layout, dynamics, state }, &mut Values(prediction));
        &self.prediction
    }

    #[inline(always)]
    fn linearise(&mut self, reference: &[f64]) {
        self.reference.copy_from_slice(reference);
        let Self { robot, layout, dynamics, channels, tau, prediction, jacobian, .. } = self;
        dynamics.accelerate(robot, layout, reference, tau);
        dynamics.differentiate(robot, layout, reference);
        jacobian.fill(0.0);
        let view = Elastic { layout, dynamics, state: reference };
        let (joints, dense, ddq_by) = (robot.len(), layout.dense, &dynamics.ddq_by);
        read_all(robot, channels, &view, &mut Chained { prediction, rows: jacobian, joints, dense, ddq_by });
        if self.direct {
            self.hear_torques();
        }
    }

    fn tolerances(&self) -> &Tolerances {
        self.sensitivity.tolerances()
    }

    #[inline(always)]
    fn signatures(&mut self, stride: usize, out: &mut [f64]) {
        let Self { robot, layout, dynamics, channels, tau, sensitivity, reference, .. } = self;
        sensitivity.set(robot, layout, dynamics, reference, tau);
        sensitivity.signatures(robot, dynamics, channels, stride, out);
    }

    /// What a torque's noise does is explained by whatever parameter that torque, or the acceleration by it, is multiplied
    /// with: a channel that hears it says nothing of parameters.
    #[inline(always)]
    fn teaches(&self, channel: usize) -> bool {
        teaches(self.channels[channel]) && self.variance[channel] <= (1.0 + HEARD) * self.reading[channel]
    }

    fn start_columns(&mut self, stride: usize, scratch: &mut [f64], columns: &mut [f64]) {
        self.signatures(stride, scratch);
        let Self { robot, layout, dynamics, channels, tau, sensitivity, reference, .. } = self;
        sensitivity.start_columns(robot, layout, dynamics, reference, tau, columns);
        for (channel, signature) in channels.iter().zip(scratch.chunks_exact(stride)) {
            let Channel::Motor(j) = *channel else { continue };
            linear::add_scaled(&mut columns[j * stride..][..stride], -1.0, signature);
            if robot.drives[j].elastic {
                linear::add_scaled(&mut columns[layout.theta[j] * stride..][..stride], -1.0, signature);
            }
        }
    }

    #[inline(always)]
    fn motor_velocity(&self, j: usize) -> Option<usize> {
        self.robot.drives[j].elastic.then(|| self.layout.dtheta[j])
    }

    #[inline(always)]
    fn swings(&self, out: &mut [f64]) {
        let Self { robot, layout, dynamics, reference, .. } = self;
        for (j, (out, drive)) in out.iter_mut().zip(&robot.drives).enumerate() {
            let torsion = drive.torsion_between(reference[layout.theta[j]], reference[j]);
            let inertia = dynamics.inertia(robot, j) + drive.motor_inertia;
            *out = if drive.elastic { (inertia / drive.tangent_stiffness(torsion)).max(0.0).sqrt() } else { 0.0 };
        }
    }

    #[inline(always)]
    fn linearised(&self) -> Linearised<'_> {
        Linearised { prediction: &self.prediction, jacobian: &self.jacobian }
    }

    fn linearised_mut(&mut self) -> (&mut [f64], &mut [f64]) {
        (&mut self.prediction, &mut self.jacobian)
    }

    #[inline(always)]
    fn variance(&self, channel: usize) -> f64 {
        self.variance[channel]
    }
}

impl Report for ElasticMeasurement {
    fn memory(&self) -> usize {
        self.robot.len()
    }

    /// The torques at this sample.
    #[inline(always)]
    fn remember(&self, memory: &mut Vec<f64>) {
        memory.extend_from_slice(&self.tau);
    }

    #[inline(always)]
    fn report(&mut self, memory: &[f64], state: &[f64], i: usize, out: &mut FilterOutput) {
        let Self { robot, layout, dynamics, .. } = self;
        let n = robot.len();
        // q̈ is no state here: what is reported follows from the state and the torques at the sample.
        dynamics.accelerate(robot, layout, &state[..layout.dense], memory);
        let row = i * n..(i + 1) * n;
        out.q[row.clone()].copy_from_slice(&state[..n]);
        out.dq[row.clone()].copy_from_slice(&state[n..2 * n]);
        out.ddq[row].copy_from_slice(&dynamics.ddq);
        for j in 0..n {
            out.theta[i * n + j] = state[layout.theta[j]];
            out.dtheta[i * n + j] = state[layout.dtheta[j]];
        }
    }
}
