//! What sensors make of the truth.

use super::plant::Plant;
use crate::check::{expect, expect_length};
use crate::error::DesignError;
use crate::estimate::measurement::{Channel, Elastic, Kind, Values, low_pass_or_none, read_all};
use crate::memory::filled;
use crate::random::{Purpose, Stream};
use crate::robot::Robot;
use core::f64::consts::TAU;

/// One channel: low-pass, then delay, bias, noise, quantisation and decimation.
#[derive(Clone, Copy, Debug)]
pub struct SensorModel {
    /// Standard deviation of white noise, in the channel's unit.
    pub noise: f64,
    /// Added to every reading.
    pub bias: f64,
    /// Readings are multiples of this; 0 for none.
    pub resolution: f64,
    /// Age of what is read [s].
    pub delay: f64,
    /// Corner of a low-pass of first order [Hz]; infinite for none.
    pub corner_frequency: f64,
    /// Samples for each reading; the others are NaN.
    pub every: usize,
}

impl SensorModel {
    /// # Errors
    /// A number out of its range.
    pub(super) fn check(&self) -> Result<(), DesignError> {
        for (what, value) in [("noise", self.noise), ("resolution", self.resolution), ("delay", self.delay)] {
            expect(value >= 0.0 && value.is_finite(), what, value, "a finite number of at least 0")?;
        }
        expect(self.bias.is_finite(), "bias", self.bias, "a finite number")?;
        expect(self.corner_frequency > 0.0, "corner_frequency", self.corner_frequency, "greater than 0")?;
        expect(self.every > 0, "every", 0.0, "at least 1")
    }
}

/// Largest delay of a reading, in samples.
const LONGEST_DELAY: f64 = 1e6;

/// One channel's sensor with its past.
#[derive(Clone, Debug)]
struct Reader {
    /// What is wrong with it.
    model: SensorModel,
    /// Of the low-pass' output and input a sample before, and of its input.
    weights: [f64; 3],
    input: f64,
    low_pass: f64,
    /// Ring of the low-pass' output, long enough for the delay, and where the last one is.
    past: Vec<f64>,
    place: usize,
    /// The delay in samples.
    lag: f64,
}

impl Reader {
    fn new(model: SensorModel, period: f64) -> Result<Self, DesignError> {
        let lag = model.delay / period;
        expect(lag <= LONGEST_DELAY, "delay", model.delay, "at most 1000000 samples")?;
        let weights = low_pass_or_none(1.0 / (TAU * model.corner_frequency), period);
        let past = filled(0.0, lag.ceil() as usize + 1, 1)?;
        Ok(Self { model, weights, input: 0.0, low_pass: 0.0, past, place: 0, lag })
    }

    /// What is read of `truth` at `sample`, with the standard normal number `normal`.
    #[inline(always)]
    fn read(&mut self, truth: f64, normal: f64, sample: usize) -> f64 {
        if sample == 0 {
            (self.low_pass, self.input) = (truth, truth);
            self.past.fill(truth);
        }
        let [output, before, now] = self.weights;
        self.low_pass = output * self.low_pass + before * self.input + now * truth;
        self.input = truth;
        let size = self.past.len();
        self.place = if self.place + 1 < size { self.place + 1 } else { 0 };
        self.past[self.place] = self.low_pass;
        if self.model.every > 1 && !sample.is_multiple_of(self.model.every) {
            return f64::NAN;
        }
        let whole = self.lag as usize;
        let back = |samples: usize| {
            let samples = samples.min(size - 1);
            self.past[if samples > self.place { self.place + size - samples } else { self.place - samples }]
        };
        let (near, far) = (back(whole), back(whole + 1));
        let SensorModel { noise, bias, resolution, .. } = self.model;
        // A delay of part of a sample is read on a straight line between two.
        let value = near + (self.lag - whole as f64) * (far - near) + bias;
        let noisy = if noise == 0.0 { value } else { value + noise * normal };
        if resolution == 0.0 { noisy } else { (noisy / resolution).round() * resolution }
    }
}

/// All sensors of a robot.
#[derive(Clone, Debug)]
pub struct Suite {
    /// All kinds on this robot, in the order of [`Kind::SENSORS`].
    channels: Vec<Channel>,
    readers: Vec<Reader>,
    /// Of the noise, and channels that have any.
    seed: u64,
    noisy: Vec<u32>,
    /// Standard normal numbers, and what would be read without faults (channels).
    normals: Vec<f64>,
    truth: Vec<f64>,
    /// The last readings, of all kinds in the order of [`Kind::SENSORS`].
    pub readings: Vec<f64>,
}

impl Suite {
    /// One model a channel, of all kinds in the order of [`Kind::SENSORS`], read every `period` [s].
    ///
    /// # Errors
    /// A model out of range, or not as many as channels.
    pub fn new(robot: &Robot, models: &[SensorModel], period: f64, seed: u64) -> Result<Self, DesignError> {
        let channels = Kind::all_channels(Kind::SENSORS, robot);
        let expected = channels.len();
        expect_length("sensors", models.len(), expected)?;
        for model in models {
            model.check()?;
        }
        let readers = models.iter().map(|&model| Reader::new(model, period)).collect::<Result<_, _>>()?;
        let [normals, truth, readings] = core::array::from_fn(|_| vec![0.0; expected]);
        let noisy = (0..).zip(models).filter(|(_, model)| model.noise > 0.0).map(|(channel, _)| channel).collect();
        Ok(Self { channels, readers, seed, noisy, normals, truth, readings })
    }

    /// Reads everything in `state` of `plant`: its dynamics with the accelerations there, and the kinematics with them.
    #[inline(always)]
    pub(super) fn read(&mut self, robot: &Robot, plant: &Plant, state: &[f64], sample: usize) {
        let view = Elastic { layout: &plant.layout, dynamics: &plant.dynamics, state };
        read_all(robot, &self.channels, &view, &mut Values(&mut self.truth));
        self.draw(sample);
        for (channel, (reader, reading)) in self.readers.iter_mut().zip(&mut self.readings).enumerate() {
            *reading = reader.read(self.truth[channel], self.normals[channel], sample);
        }
    }

    /// A normal number for each channel with noise, eight at a time.
    #[inline(always)]
    fn draw(&mut self, sample: usize) {
        const WIDE: usize = 8;
        let random = Stream::new(self.seed, sample as u32, Purpose::Sensors);
        for channels in self.noisy.chunks(WIDE) {
            let mut items = [0; WIDE];
            items[..channels.len()].copy_from_slice(channels);
            let [numbers, _] = random.normals(items, 0);
            for (&channel, number) in channels.iter().zip(numbers.0) {
                self.normals[channel as usize] = number;
            }
        }
    }
}

/// Joint positions and velocities of links and motors, n each.
#[derive(Clone, Copy, Debug)]
pub struct JointMotion<'a> {
    /// q [rad].
    pub q: &'a [f64],
    /// q̇ [rad/s].
    pub dq: &'a [f64],
    /// θ [rad].
    pub theta: &'a [f64],
    /// θ̇ [rad/s].
    pub dtheta: &'a [f64],
}
