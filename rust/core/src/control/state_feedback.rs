//! Linear feedback of the whole state.

use super::{Controller, Reference, Refused, RobotState};
use crate::check::{expect_finite, expect_length};
use crate::error::DesignError;

/// τ = τ_d + K_P (x_d − x) with x = (θ, q, θ̇, q̇): eq. (13) of De Luca, Schröder and Thümmel (2007).
#[derive(Clone, Debug)]
pub struct StateFeedback {
    /// (θ, q, θ̇, q̇, τ) wanted, in time.
    reference: Reference,
    /// n × 4n, row-major, on the errors of θ, q, θ̇ and q̇.
    gains: Vec<f64>,
    /// Scratch: what is wanted now, and how far the state is from it.
    desired: Vec<f64>,
    error: Vec<f64>,
}

impl StateFeedback {
    /// `reference` has x_d (4 n) and τ_d (n) a knot; `gains` are K_P (n × 4 n), row-major.
    ///
    /// # Errors
    /// Gains that are not finite, or not as many as the reference asks for.
    pub fn new(reference: Reference, gains: Vec<f64>) -> Result<Self, DesignError> {
        let (what, width) = ("gains", reference.width());
        let n = width / 5;
        expect_length(what, gains.len(), 4 * n * n)?;
        expect_finite(what, &gains)?;
        Ok(Self { reference, gains, desired: vec![0.0; width], error: vec![0.0; 4 * n] })
    }
}

impl Controller for StateFeedback {
    #[inline(always)]
    fn torque(&mut self, t: f64, state: &RobotState, out: &mut [f64]) -> Result<(), Refused> {
        let Self { reference, gains, desired, error } = self;
        reference.at(t, |i, value, _| desired[i] = value);
        let (states, torque) = desired.split_at(error.len());
        let found = [&state.theta, &state.q, &state.dtheta, &state.dq].into_iter().flatten();
        for (error, (wanted, found)) in error.iter_mut().zip(states.iter().zip(found)) {
            *error = wanted - found;
        }
        for (j, row) in gains.chunks_exact(error.len()).enumerate() {
            out[j] = torque[j] + row.iter().zip(&*error).map(|(gain, error)| gain * error).sum::<f64>();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controller(gains: Vec<f64>) -> Result<StateFeedback, DesignError> {
        let values = [[1.0, 2.0, 3.0, 4.0, 10.0], [2.0, 3.0, 4.0, 5.0, 20.0]].concat();
        StateFeedback::new(Reference::new(vec![0.0, 1.0], values, 5)?, gains)
    }

    #[test]
    fn torque_is_that_of_the_law_and_the_last_state_is_held() {
        let mut controller = controller(vec![1.0, 10.0, 100.0, 1000.0]).unwrap();
        let state = RobotState { theta: vec![0.5], q: vec![1.0], dtheta: vec![1.0], dq: vec![3.0] };
        let mut out = [0.0];
        controller.torque(0.0, &state, &mut out).unwrap();
        assert_eq!(out, [10.0 + 0.5 + 10.0 + 200.0 + 1000.0]);
        controller.torque(7.0, &state, &mut out).unwrap();
        assert_eq!(out, [20.0 + 1.5 + 20.0 + 300.0 + 2000.0]);
    }

    #[test]
    fn gains_that_do_not_fit_are_refused() {
        assert_eq!(controller(vec![1.0; 3]).unwrap_err(), DesignError::Length { what: "gains", found: 3, expected: 4 });
        let error = controller(vec![1.0, f64::INFINITY, 0.0, 0.0]).unwrap_err();
        assert_eq!(error.to_string(), "gains is inf, expected finite numbers");
    }
}
