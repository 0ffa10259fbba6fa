//! One sample after the other.

use super::super::encoder::Encoder;
use super::super::schedule::Logic;
use super::super::settings::Gains;
use super::VelocityObserver;
use crate::error::{DesignError, RunError};
use crate::estimate::Status;
use crate::estimate::observer::Start;
use crate::linear::add_scaled;
use crate::scalar::exp_m1;
use crate::simd::Kernel;

/// An observer's step, to be compiled for each instruction set.
pub(super) struct VelocityStep<'a> {
    pub(super) observer: &'a mut VelocityObserver,
    pub(super) q: &'a [f64],
    pub(super) torque: &'a [f64],
}

impl Kernel for VelocityStep<'_> {
    type Output = Result<(), RunError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.observer.take_here(self.q, self.torque)
    }
}

impl VelocityObserver {
    /// One period: predict and correct, let the gain jump, hold the torque, and the acceleration that it gives.
    #[inline(always)]
    fn take_here(&mut self, q: &[f64], torque: &[f64]) -> Result<(), RunError> {
        self.status = 0;
        let regular = if self.samples == 0 { self.begin(q)? } else { self.advance(q) };
        if !regular {
            return Err(RunError::SingularInertia { sample: self.samples });
        }
        // After the correction, as the gain follows the estimated speed; before the torque, which the next period
        // needs.
        self.jump();
        self.hold(torque);
        let Self { dynamics, velocity, torque, acceleration, .. } = self;
        dynamics.acceleration_into(velocity, torque, acceleration);
        self.samples += 1;
        Ok(())
    }

    /// A first sample: no innovation yet; a spring is checked against the period at the posture where it is to work.
    #[cold]
    fn begin(&mut self, q: &[f64]) -> Result<bool, DesignError> {
        if let Some(joint) = q.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        self.position.copy_from_slice(q);
        self.encoders.fill(Encoder::default());
        let regular = self.dynamics.set_position(&self.position, &self.velocity);
        if regular && self.has_spring() {
            let stiffness = self.dynamics.stiffest(&self.settings.spring);
            let limit =
                self.gains.iter().map(|&k| stiffest_stable(k, self.settings.period)).fold(f64::INFINITY, f64::min);
            if stiffness >= limit {
                return Err(DesignError::StiffSpring { stiffness, limit });
            }
            self.pull();
        }
        Ok(regular)
    }

    /// One period on, and corrected; false when the inertia is singular there.
    #[inline(always)]
    fn advance(&mut self, q: &[f64]) -> bool {
        let period = self.settings.period;
        let starts = self.settings.start == Start::Auto && !self.given;
        for j in 0..q.len() {
            let slope = self.acceleration[j] + self.spring[j];
            // The first of Heun's slopes; y itself is predicted, as x̂₁ has no part in the reduced-order observer.
            let predicted = self.position[j] + period * (self.velocity[j] + 0.5 * period * slope);
            let reading = self.encoders[j].read(q[j], predicted, self.settings.wrap[j]);
            self.status |= if reading.wrapped { Status::UNWRAPPED } else { 0 };
            self.status |= if reading.missing { Status::BRIDGED } else { 0 };
            self.position[j] = reading.position;
            self.innovation[j] = reading.innovation;
            self.share[j] = if starts { f64::from(reading.periods) / self.samples as f64 } else { 0.0 };
            self.velocity[j] += period * slope;
        }
        self.correct();
        let regular = self.dynamics.set_position(&self.position, &self.velocity);
        if regular {
            self.refine();
        }
        regular
    }

    /// Lets the innovation change velocity and lag.
    #[inline(always)]
    fn correct(&mut self) {
        if let Some(map) = &mut self.map {
            let most = map.share();
            let changes = map.weigh(&self.position, &self.innovation);
            for (j, (velocity, &change)) in self.velocity.iter_mut().zip(changes).enumerate() {
                let mean = self.share[j] / self.settings.period * self.innovation[j];
                *velocity += if self.share[j] > most { mean } else { change };
            }
            return;
        }
        for j in 0..self.innovation.len() {
            let change = self.weights[j] * self.innovation[j];
            // At a start the mean velocity since then, until the gain follows it faster.
            let mean = self.share[j] / self.settings.period * self.innovation[j];
            self.velocity[j] += if mean.abs() > change.abs() { mean } else { change };
            self.lag[j] += change / self.gains[j];
        }
    }

    /// Heun's second slope: acceleration changes linearly over the period, and the position that was predicted likewise.
    ///
    /// The lag is there already, so that of the spring this is the trapezoidal rule.
    #[inline(always)]
    fn refine(&mut self) {
        let period = self.settings.period;
        self.dynamics.acceleration_into(&self.velocity, &self.torque, &mut self.corrected);
        if self.has_spring() {
            add_scaled(&mut self.acceleration, 1.0, &self.spring);
            self.pull();
            add_scaled(&mut self.corrected, 1.0, &self.spring);
        }
        for j in 0..self.velocity.len() {
            let change = self.corrected[j] - self.acceleration[j];
            // ½ of the change, of which the innovation, had it been known, would have taken off its share of T²/6.
            self.velocity[j] += change * period * (0.5 - self.weights[j] * period / 6.0);
        }
    }

    /// Whether it is the observer of Nicosia and Tomei.
    fn has_spring(&self) -> bool {
        self.settings.spring.iter().any(|&k| k > 0.0)
    }

    /// What the spring adds to the acceleration.
    #[inline(always)]
    fn pull(&mut self) {
        for j in 0..self.spring.len() {
            self.spring[j] = self.settings.spring[j] * self.lag[j];
        }
        self.dynamics.solve(&mut self.spring);
    }

    /// Lets the gain follow the estimated speed.
    #[inline(always)]
    fn jump(&mut self) {
        let Gains::Scheduled(schedule) = &self.settings.gains else { return };
        let speed = self.velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
        let level = schedule.next(self.level, speed, self.since_jump);
        self.since_jump += 1;
        if level == self.level {
            return;
        }
        let (old, new) = (self.gains[0], schedule.gains[level - 1]);
        // The paper's map keeps the inner state z = x̂₂ − k y, so that the estimate jumps by (k₊ − k) y.
        if schedule.logic == Logic::PrintedMap {
            for (velocity, position) in self.velocity.iter_mut().zip(&self.position) {
                *velocity += (new - old) * position;
            }
        }
        (self.level, self.since_jump) = (level, 0);
        self.gains.fill(new);
        self.weigh();
    }

    /// Holds torques; one that is missing stays what it was.
    #[inline(always)]
    fn hold(&mut self, torque: &[f64]) {
        for (held, &new) in self.torque.iter_mut().zip(torque) {
            if new.is_nan() {
                self.status |= Status::BRIDGED;
            } else {
                *held = new;
            }
        }
    }
}

/// Largest λ(M⁻¹K_P) at which the error is stable, sampled with a gain of `gain` [1/s²]: Jury's condition on its two equations.
fn stiffest_stable(gain: f64, period: f64) -> f64 {
    let taken = -exp_m1(-gain * period);
    gain / (period * taken) * (4.0 - 2.0 * taken) / (1.0 - taken / 3.0)
}
