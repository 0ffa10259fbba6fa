//! One step of a block of particles: where they go, and what that does to their weights.

use super::cloud::{Block, Scratch, WIDE, Wide};
use super::density::log_gamma;
use super::sample::ParticleSample;
use super::settings::Proposal;
use super::shared::Shared;
use super::sums::Weigh;
use crate::estimate::kalman::JerkModel;
use crate::linear;
use crate::random::{Purpose, Stream};
use crate::scalar::{Lanes, Scalar, ln};
use crate::simd::{self, Kernel};

/// Moves a block by one sample.
///
/// With a linearisation of its own each particle evaluates all channels and their Jacobian, factorises a 3n × 3n matrix
/// and evaluates the channels again at what it drew; with a shared one it does the last alone.
pub(super) struct Propagate<'a> {
    pub(super) model: &'a JerkModel,
    pub(super) sample: &'a ParticleSample,
    /// None where each particle linearises its own readings.
    pub(super) shared: Option<&'a Shared>,
    pub(super) block: &'a mut Block,
}

impl Kernel for Propagate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, sample, shared, block } = self;
        for group in 0..block.groups() {
            let items = block.items(group);
            load(block, group);
            // Eight particles at a time, one to a lane; their numbers depend on their place in the cloud.
            let increment = block.scratch.step(model, sample, shared, items);
            if !increment.0.iter().all(|x| x.is_finite()) {
                block.scratch.bring_back();
            }
            store(block, group, increment, sample.offset);
        }
        // Places of the last group that no particle has.
        block.log_weights.each_mut()[block.count..].fill(f64::NEG_INFINITY);
        Weigh { block }.run();
    }
}

/// The states of a group's particles into the scratch.
#[inline(always)]
pub(super) fn load(block: &mut Block, group: usize) {
    for (entry, row) in block.scratch.before.iter_mut().zip(&block.state) {
        *entry = Lanes(row.0[group]);
    }
}

/// And back, weights with them: they go on from those before, in multiples of their total.
#[inline(always)]
pub(super) fn store(block: &mut Block, group: usize, increment: Wide, offset: f64) {
    for (entry, row) in block.scratch.after.iter().zip(&mut block.state) {
        row.0[group] = entry.0;
    }
    for (log_weight, more) in block.log_weights.0[group].iter_mut().zip(increment.0) {
        let sum = *log_weight - offset + more;
        *log_weight = if sum.is_finite() { sum } else { f64::NEG_INFINITY };
    }
}

impl Scratch {
    /// From `before` to `after`; returns by how much the logarithms of the weights change.
    #[inline(always)]
    fn step(
        &mut self,
        model: &JerkModel,
        sample: &ParticleSample,
        shared: Option<&Shared>,
        items: [u32; WIDE],
    ) -> Wide {
        let n = model.joints();
        // Random numbers by counter: the same for a particle whatever thread or block works on it.
        let motion = Stream::new(sample.seed, sample.step, Purpose::Process);
        draw(&motion, items, &mut self.normal[..sample.draws]);
        // The mean of p(x | x⁻), then what is random in x.
        self.coast(n, sample);
        self.walk(sample);
        let drawn = self.noise.len();
        // By the process alone p/q = 1; by the linearised readings it is not.
        let mut change = match sample.proposal {
            Proposal::Bootstrap => {
                self.noise.copy_from_slice(&self.normal[..drawn]);
                Wide::default()
            }
            Proposal::Linearised { iterations, tail } => self.propose(model, sample, shared, items, iterations, tail),
        };
        self.apply_noise(sample);
        // Weighed by the exact density at the place that was drawn; linearising serves the choice of q alone.
        self.evaluation.predict(&model.robot, &model.channels, &self.after, &sample.dtheta);
        change += self.weigh_and_learn(model, sample);
        change + self.within_limits(sample)
    }

    /// Zero, or −∞ for particles beyond limits.
    #[inline(always)]
    pub(super) fn within_limits(&self, sample: &ParticleSample) -> Wide {
        let mut change = Wide::default();
        for (j, &(low, high)) in sample.limits.iter().enumerate() {
            let outside = |q: f64| if q < low || q > high { f64::NEG_INFINITY } else { 0.0 };
            change += self.after[j].map(outside);
        }
        change
    }

    /// Particles that went out of the numbers stay where they would be without the readings. They have no weight, but
    /// zero times infinity would be in every sum.
    pub(super) fn bring_back(&mut self) {
        for l in 0..WIDE {
            if self.after.iter().all(|x| x.0[l].is_finite()) {
                continue;
            }
            for (after, before) in self.after.iter_mut().zip(&self.before) {
                after.0[l] = if before.0[l].is_finite() { before.0[l] } else { 0.0 };
            }
        }
    }

    /// Motion without noise: x ← F x + G u (Axelsson, Karlsson and Norrlöf 2012, eq. (10)).
    #[inline(always)]
    pub(super) fn coast(&mut self, n: usize, sample: &ParticleSample) {
        let (dt, half) = (sample.dt, 0.5 * sample.dt * sample.dt);
        for j in 0..n {
            // u is the commanded jerk, held over the step: dt³/6, dt²/2 and dt of it.
            let (dq, ddq, u) = (self.before[n + j], self.before[2 * n + j], sample.jerk[j]);
            self.before[j] += dq * dt + ddq * half + half * dt / 3.0 * u;
            self.before[n + j] += ddq * dt + half * u;
            self.before[2 * n + j] = ddq + dt * u;
        }
        for &(bias, decay) in &sample.decays {
            self.before[bias] = self.before[bias] * decay;
        }
    }

    /// Biases that wander whatever the readings say.
    #[inline(always)]
    fn walk(&mut self, sample: &ParticleSample) {
        for walk in &sample.walks {
            self.before[walk.entry] += self.normal[walk.draw] * walk.std;
        }
    }

    /// Draws the links' noise by the linearised readings; returns log p(w) − log q(w).
    ///
    /// In noise space, by the standard normal numbers of which noise is made: Λ = 1 + AᵀS⁻¹A and ŵ = Λ⁻¹AᵀS⁻¹ε. That
    /// holds for a singular Q as well, whose pseudo-inverse (Axelsson, Karlsson and Norrlöf 2012, eq. (19)) would take
    /// directions without noise for directions in which nothing is known.
    #[inline(always)]
    fn propose(
        &mut self,
        model: &JerkModel,
        sample: &ParticleSample,
        shared: Option<&Shared>,
        items: [u32; WIDE],
        iterations: usize,
        tail: Option<u32>,
    ) -> Wide {
        match shared {
            Some(shared) => self.seek(shared),
            None => self.linearise(model, sample, iterations),
        }
        self.draw_proposal(shared, sample, items, tail)
    }

    /// Draws around `mode`; returns log p(w) − log q(w).
    #[inline(always)]
    pub(super) fn draw_proposal(
        &mut self,
        shared: Option<&Shared>,
        sample: &ParticleSample,
        items: [u32; WIDE],
        tail: Option<u32>,
    ) -> Wide {
        let stretch = tail.map(|dof| stretch(sample, items, dof));
        self.draw_around_mode(shared, stretch.zip(tail))
    }

    /// ŵ into `mode` and L with Λ = L Lᵀ into `factor`, of this particle's own readings.
    #[inline(always)]
    fn linearise(&mut self, model: &JerkModel, sample: &ParticleSample, iterations: usize) {
        let n = self.mode.len();
        self.mode.fill(Wide::default());
        for iteration in 0..iterations {
            // Gauss–Newton towards the most probable increment: linearised at the last one found.
            self.noise.copy_from_slice(&self.mode);
            self.apply_noise(sample);
            self.evaluation.evaluate(&model.robot, &model.channels, &self.after, &sample.dtheta);
            sample.past.mix(model, &mut self.evaluation, &self.after, true);
            self.gather_information(sample, iteration > 0);
            linear::factorise(&mut self.factor, n);
            linear::solve(&self.factor, n, &mut self.mode, 1);
        }
        // Of the last iteration's Λ: the proposal's covariance is Λ⁻¹ there.
        linear::root(&mut self.factor, n);
    }

    /// Λ into `factor` and AᵀS⁻¹(ε + A ŵ) into `mode`, ε taken at ŵ.
    #[inline(always)]
    fn gather_information(&mut self, sample: &ParticleSample, again: bool) {
        let Self { evaluation, after, mode, noise, factor, row, .. } = self;
        let n = mode.len();
        factor.fill(Wide::default());
        mode.fill(Wide::default());
        for j in 0..n {
            // The prior of standard normal numbers is the unit matrix, whatever Q's rank.
            factor[j * n + j] = Wide::constant(1.0);
        }
        for reading in &sample.readings {
            sample.by_noise(&evaluation.jacobian[reading.channel * n..][..n], row);
            let mut error = reading.error(after, &evaluation.prediction);
            let precision = reading.noise.precision(error);
            // Around ŵ ≠ 0 the linear model is y − h(ŵ) + A ŵ = A w.
            if again {
                for (slope, noise) in row.iter().zip(noise.iter()) {
                    error += *slope * *noise;
                }
            }
            for j in 0..n {
                let weighted = row[j] * precision;
                mode[j] += weighted * error;
                for k in 0..=j {
                    factor[j * n + k] += weighted * row[k];
                }
            }
        }
    }

    /// w = ŵ + L⁻ᵀζ with Λ = L Lᵀ, ζ normal or Student's; returns log p(w) − log q(w) but for a constant that is the
    /// same for all particles where ζ is normal.
    #[inline(always)]
    fn draw_around_mode(&mut self, shared: Option<&Shared>, heavy: Option<(Wide, u32)>) -> Wide {
        let n = self.mode.len();
        if let Some((stretch, _)) = heavy {
            self.normal[..n].iter_mut().for_each(|normal| *normal = *normal * stretch);
        }
        // log p(w) − log q(w) = −|w|²/2 + |ζ|²/2 − log det L: q is N(ŵ, Λ⁻¹), or Student's with heavier tails than p's,
        // without which a few particles far out would carry all weight.
        let length = square(&self.normal[..n]);
        let mut change = match heavy {
            None => length * 0.5,
            Some((_, dof)) => student_term(length, f64::from(dof), n),
        };
        self.noise.copy_from_slice(&self.normal[..n]);
        if let Some(shared) = shared {
            shared.unwind(&mut self.noise);
            change += Wide::constant(shared.constant);
        } else {
            unwind(&mut self.noise, &self.factor);
            let diagonal = self.factor.iter().step_by(n + 1);
            change -= diagonal.fold(Wide::constant(1.0), |product, &root| product * root).map(ln);
        }
        for (noise, mode) in self.noise.iter_mut().zip(&self.mode) {
            *noise += *mode;
        }
        change - square(&self.noise) * 0.5
    }

    /// x = x⁻ + G w.
    #[inline(always)]
    fn apply_noise(&mut self, sample: &ParticleSample) {
        let n = sample.factors.len();
        self.after.copy_from_slice(&self.before);
        // The factor of Q, three columns a joint: see `jerk_noise::factor`.
        for (j, [q, dq, ddq]) in sample.factors.iter().enumerate() {
            let [w0, w1, w2] = [self.noise[j], self.noise[n + j], self.noise[2 * n + j]];
            self.after[j] += w0 * q[0] + w1 * q[1] + w2 * q[2];
            self.after[n + j] += w0 * dq[0] + w1 * dq[1];
            self.after[2 * n + j] += w0 * ddq[0];
        }
    }

    /// log p(y | x), and what the biases learn from y.
    #[inline(always)]
    fn weigh_and_learn(&mut self, model: &JerkModel, sample: &ParticleSample) -> Wide {
        let mut change = Wide::default();
        let prompt = sample.readings.len() - sample.past.found.len();
        for (i, reading) in sample.readings.iter().enumerate() {
            if i == prompt {
                // Of the present state, which by now has all of its biases.
                sample.past.mix(model, &mut self.evaluation, &self.after, false);
            }
            let error = reading.error(&self.after, &self.evaluation.prediction);
            change += reading.noise.log_density(error);
            if let Some(bias) = reading.bias {
                // A bias drawn late: towards the innovation, and what that leaves open.
                self.after[bias] += error * reading.gain;
                if reading.rest > 0.0 {
                    self.after[bias] += self.normal[reading.draw] * reading.rest;
                }
            }
        }
        change
    }
}

/// ζ to L⁻ᵀζ.
#[inline(always)]
fn unwind(zeta: &mut [Wide], factor: &[Wide]) {
    let n = zeta.len();
    for j in (0..n).rev() {
        let mut value = zeta[j];
        for k in j + 1..n {
            value -= factor[k * n + j] * zeta[k];
        }
        zeta[j] = value / factor[j * n + j];
    }
}

/// |x|².
#[inline(always)]
fn square(x: &[Wide]) -> Wide {
    x.iter().fold(Wide::default(), |sum, &x| sum + x * x)
}

/// Standard normal numbers, four a draw: half of the group's particles have those of the other half with the sign turned.
///
/// In such antithetic pairs (Hammersley and Morton 1956) chance moves particles and not their mean, and half as many
/// numbers are drawn.
pub(super) fn draw(stream: &Stream, items: [u32; WIDE], out: &mut [Wide]) {
    simd::phase(Draw { stream, items, out });
}

/// [`draw`], a phase of its own: two particle filters and the first cloud share it.
struct Draw<'a> {
    stream: &'a Stream,
    items: [u32; WIDE],
    out: &'a mut [Wide],
}

impl Kernel for Draw<'_> {
    type Output = ();
    const LANES: bool = true;

    #[inline(always)]
    fn run(self) {
        const HALF: usize = WIDE / 2;
        let Self { stream, items, out } = self;
        for (k, four) in out.chunks_mut(4).enumerate() {
            let drawn = stream.normals(items, k as u32);
            for (i, out) in four.iter_mut().enumerate() {
                let half = &drawn[i / 2].0[i % 2 * HALF..][..HALF];
                *out = Lanes(core::array::from_fn(|l| if l < HALF { half[l] } else { -half[l - HALF] }));
            }
        }
    }
}

/// √(ν/χ²) of each particle, χ² of an even ν degrees of freedom being −2 ln of a product of ν/2 uniform numbers.
#[inline(always)]
fn stretch(sample: &ParticleSample, items: [u32; WIDE], dof: u32) -> Wide {
    let stream = Stream::new(sample.seed, sample.step, Purpose::Tail);
    let mut log = Wide::default();
    for k in 0..dof / 2 {
        log += stream.uniforms(items, k)[0].map(ln);
    }
    (Wide::constant(f64::from(dof)) / (log * -2.0)).sqrt()
}

/// −log of Student's density of n dimensions, less the same of the normal one's constant.
#[inline(always)]
fn student_term(square: Wide, dof: f64, n: usize) -> Wide {
    let n = n as f64;
    // Γ((ν+n)/2)/Γ(ν/2) over (ν/2)^(n/2), by recurrence from half-integers.
    let constant = log_gamma(0.5 * (dof + n)) - log_gamma(0.5 * dof) - 0.5 * n * ln(0.5 * dof);
    (square * (1.0 / dof) + 1.0).map(ln) * (0.5 * (dof + n)) + -constant
}
