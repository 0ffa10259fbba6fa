//! A motor's torque where it is not read.

/// For how long it is remembered how fast torques change [s].
const MEMORY: f64 = 0.2;
/// Samples since a reading that there was none of: the first one is no change of the torque.
const NEVER: f64 = 1e12;

/// A motor's torque as it was last read, and how far it may be from that.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastTorque {
    pub(super) value: f64,
    /// Noise of a reading [N m].
    std: f64,
    /// By how much it lately changed at most in a sample [N m], and the part of that which is left a sample later.
    pace: f64,
    fading: f64,
    /// Samples without a reading.
    missing: f64,
}

impl LastTorque {
    pub(super) fn new(std: f64, period: f64) -> Self {
        Self { value: 0.0, std, pace: 0.0, fading: 1.0 - (period / MEMORY).min(1.0), missing: NEVER }
    }

    /// Before the first reading.
    pub(super) fn reset(&mut self) {
        (self.value, self.pace, self.missing) = (0.0, 0.0, NEVER);
    }

    /// A sample's torque, NaN where it is missing.
    #[inline(always)]
    pub(super) fn take(&mut self, tau: f64) {
        if tau.is_nan() {
            self.missing += 1.0;
            return;
        }
        let change = ((tau - self.value) / (self.missing + 1.0)).abs();
        self.pace = change.max(self.pace * self.fading);
        (self.value, self.missing) = (tau, 0.0);
    }

    /// How far off it may be while it is not read: it goes on as it went [N m].
    #[inline(always)]
    pub(super) fn doubt(&self) -> f64 {
        let gone = self.missing * self.pace;
        if self.missing > 0.0 { (self.std * self.std + gone * gone).sqrt() } else { 0.0 }
    }
}
