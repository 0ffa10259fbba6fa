//! The process of the jerk-driven model: links moved by commanded and random jerk, biases that wander.

use super::disturbance::{hold, hold_wrenches};
use super::gaussian::{Gaussian, Symmetric};
use super::jerk::{JerkModel, JerkNoise};
use super::model::Process;
use super::recording::{KalmanRecording, KalmanSample};
use crate::error::DesignError;
use crate::estimate::observer::Rest;
use crate::linear::Real;
use crate::robot::Robot;

/// See the module.
///
/// x₊ = F x + G u + w with a chain of three integrators a joint (Axelsson, Karlsson and Norrlöf 2012, eqs. (9) and
/// (10)), u the commanded jerk, and w the exact integral of white jerk over the step, so that a density holds at any
/// rate.
#[derive(Clone, Debug)]
pub struct JerkProcess {
    /// Channels and biases.
    pub(crate) model: JerkModel,
    /// Densities, walks and initial uncertainties.
    pub(crate) noise: JerkNoise,
    /// Finds where links hang at a first sample.
    pub(super) rest: Rest,
}

impl JerkProcess {
    /// Columns (states × `stride`) through a step of `dt`, in either precision.
    #[inline(always)]
    fn advance<T: Real>(&self, columns: &mut [T], stride: usize, dt: f64) {
        let size = self.model.joints() * stride;
        let (q, rest) = columns.split_at_mut(size);
        let (dq, ddq) = rest.split_at_mut(size);
        let (step, half) = (T::of(dt), T::of(0.5 * dt * dt));
        // F is the identity but for q += dt q̇ + dt²/2 q̈ and q̇ += dt q̈: a chain of integrators (eqs. (9) and (10)).
        for i in 0..size {
            q[i] += step * dq[i] + half * ddq[i];
            dq[i] += step * ddq[i];
        }
        self.model.drift(&self.noise).carry(columns, stride, dt);
        self.model.disturbances.drift().carry(columns, stride, dt);
    }
}

impl Process for JerkProcess {
    fn robot(&self) -> &Robot {
        &self.model.robot
    }

    #[inline(always)]
    fn states(&self) -> usize {
        self.model.states()
    }

    fn check(&self, recording: &KalmanRecording<'_>) -> Result<(), DesignError> {
        recording.expect(self.model.channels(), self.model.joints(), &[("jerk", recording.inputs.jerk)])
    }

    fn start(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) -> Result<(), DesignError> {
        let theta = &sample.readings[..self.model.joints()];
        if let Some(joint) = theta.iter().position(|x| x.is_nan()) {
            return Err(DesignError::NoStart { joint });
        }
        let q = self.rest.find(&self.model.robot, theta)?;
        self.model.begin(q, &self.noise, belief);
        if let Some(first) = self.link_disturbance() {
            hold(&self.model.robot, theta, first, belief);
        }
        if let Some(first) = self.model.disturbances.wrench() {
            hold_wrenches(&self.model.robot, theta, first, belief);
        }
        Ok(())
    }

    #[inline(always)]
    fn wrench(&self) -> Option<usize> {
        self.model.disturbances.wrench()
    }

    #[inline(always)]
    fn link_disturbance(&self) -> Option<usize> {
        self.model.disturbances.first()
    }

    #[inline(always)]
    fn predict(&mut self, sample: &KalmanSample<'_>, belief: &mut Gaussian) {
        self.model.predict(belief, &self.noise, sample.dt, sample.inputs.jerk);
    }

    #[inline(always)]
    fn carry(&mut self, columns: &mut [f64], stride: usize, dt: f64) {
        self.advance(columns, stride, dt);
    }

    #[inline(always)]
    fn carry_single(&mut self, columns: &mut [f32], stride: usize, dt: f64) {
        self.advance(columns, stride, dt);
    }

    #[inline(always)]
    fn carry_back(&mut self, _: &[f64], columns: &mut [f64], stride: usize, dt: f64) {
        let size = self.model.joints() * stride;
        let (q, rest) = columns.split_at_mut(size);
        let (dq, ddq) = rest.split_at_mut(size);
        // Fᵀ runs the chain the other way: what is said of q says dt of it of q̇ and dt²/2 of q̈.
        for i in 0..size {
            ddq[i] += dt * dq[i] + 0.5 * dt * dt * q[i];
            dq[i] += dt * q[i];
        }
        self.model.drift(&self.noise).carry(columns, stride, dt);
        self.model.disturbances.drift().carry(columns, stride, dt);
    }

    fn memory(&self) -> usize {
        0
    }

    #[inline(always)]
    fn remember(&self, _: &mut Vec<f64>) {}

    #[inline(always)]
    fn noise_rows(&mut self, _: &[f64], dt: f64, rows: &mut [f64], stride: usize) {
        self.model.noise_rows(rows, stride, &self.noise, dt);
    }

    #[inline(always)]
    fn retreat(&mut self, _: &[f64], dt: f64, lambda: &mut [f64], big: &mut Symmetric) {
        self.model.retreat(lambda, big, &self.noise, dt);
    }
}
