//! Positions as encoders give them: some missing, and with jumps where one wraps.

/// What a joint's encoder has said.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Encoder {
    /// What wraps so far have taken away [rad].
    offset: f64,
    /// Samples missing since the last reading.
    missing: u32,
}

/// A reading against what was predicted.
#[derive(Clone, Copy, Debug)]
pub(super) struct EncoderReading {
    /// Position, without wraps; the predicted one where the reading is missing [rad].
    pub(super) position: f64,
    /// How far it is from the predicted one, for each period since the last reading [rad].
    pub(super) innovation: f64,
    /// Periods since the last reading, 0 where this one is missing.
    pub(super) periods: u32,
    /// The encoder wrapped.
    pub(super) wrapped: bool,
    /// The reading is missing.
    pub(super) missing: bool,
}

impl Encoder {
    /// Samples missing since the last reading.
    pub(super) fn missing(&self) -> u32 {
        self.missing
    }

    /// Takes a reading, NaN where it is missing, of an encoder that wraps after `turn`.
    #[inline(always)]
    pub(super) fn read(&mut self, reading: f64, predicted: f64, turn: f64) -> EncoderReading {
        if reading.is_nan() {
            self.missing = self.missing.saturating_add(1);
            return EncoderReading { position: predicted, innovation: 0.0, periods: 0, wrapped: false, missing: true };
        }
        let turns = ((predicted - reading - self.offset) / turn).round();
        let wrapped = turns != 0.0;
        if wrapped {
            self.offset += turns * turn;
        }
        let position = reading + self.offset;
        let periods = self.missing.saturating_add(1);
        let innovation = (position - predicted) / f64::from(periods);
        self.missing = 0;
        EncoderReading { position, innovation, periods, wrapped, missing: false }
    }
}
