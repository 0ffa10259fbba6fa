//! What there is to know about a row of an estimate.

/// What happened at a sample; 0 is good, otherwise a sum of these. All estimators share the bits.
///
/// ```
/// use linkside_core::estimate::Status;
/// let status = Status::BRIDGED | Status::GATED;
/// assert!(status & Status::CONTRADICTED == 0); // still good
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Status;

impl Status {
    /// Some combination of accelerations was damped near a singular posture.
    pub const DAMPED: u8 = 1;
    /// A reading was missing and bridged.
    pub const BRIDGED: u8 = 2;
    /// Some combination of accelerations was not seen at all.
    pub const UNSEEN: u8 = 4;
    /// A reading was left out as an outlier, or counted less than a tenth.
    pub const GATED: u8 = 8;
    /// Not one reading was used: the row is a prediction.
    pub const PREDICTED: u8 = 16;
    /// An encoder wrapped, and its jump was taken out.
    pub const UNWRAPPED: u8 = 32;
    /// Readings contradict the model: do not use the row and its standard deviations.
    pub const CONTRADICTED: u8 = 64;
    /// One channel contradicts the model and all others.
    pub const FAULTY: u8 = 128;

    /// Samples that a filter's start is fitted to.
    pub const START: usize = 32;

    /// Flags the rows before a contradiction that begins among the samples which a start was fitted to: it was fitted to
    /// readings that contradict the model. `rows` follow `before` earlier ones.
    pub(crate) fn doubt_start(rows: &mut [u8], before: usize) {
        let first = Self::START.saturating_sub(before).min(rows.len());
        if let Some(begin) = rows[..first].iter().position(|row| row & Self::CONTRADICTED != 0) {
            rows[..begin].iter_mut().for_each(|row| *row |= Self::CONTRADICTED);
        }
    }
}
