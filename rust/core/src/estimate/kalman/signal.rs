//! What a channel's readings look like by themselves, without a model.

/// Kinds of faults, by how the readings of a channel look where they contradict the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The same reading over and over.
    Stuck,
    /// The same reading over and over, at the end of what the channel ever read.
    Saturated,
    /// Nothing but zero.
    Dead,
    /// A jump by about a whole turn.
    Wrap,
    /// A step that stays, of zero or of scale.
    Step,
    /// The sign is turned.
    Flipped,
    /// None of these.
    Unknown,
}

/// Repetitions of a reading, to the last bit, from which a channel that used to change is stuck.
pub(super) const RUN: u32 = 8;
/// Standard deviations of a reading by which its prediction moves on while it is stuck.
const MOVED: f64 = 6.0;

/// One channel's readings so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Signal {
    last: f64,
    /// How often the last reading has come in a row, and how far its prediction has moved meanwhile.
    pub(super) run: u32,
    from: f64,
    moved: f64,
    largest: f64,
    /// Σ y ŷ and Σ ŷ² of the latest readings.
    product: f64,
    power: f64,
}

impl Signal {
    pub(super) const NEW: Self =
        Self { last: f64::NAN, run: 0, from: 0.0, moved: 0.0, largest: 0.0, product: 0.0, power: 0.0 };

    #[inline(always)]
    pub(super) fn take(&mut self, reading: f64, predicted: f64) {
        if reading == self.last {
            self.run += 1;
        } else {
            (self.run, self.from) = (1, predicted);
        }
        self.moved = (predicted - self.from).abs();
        self.last = reading;
        self.largest = self.largest.max(reading.abs());
        self.product = 0.9 * self.product + reading * predicted;
        self.power = 0.9 * self.power + predicted * predicted;
    }

    /// Whether readings of this noise stay where they are while the prediction moves on.
    #[inline(always)]
    pub(super) fn is_stuck(&self, variance: f64) -> bool {
        self.run >= RUN && self.moved * self.moved > MOVED * MOVED * variance
    }

    /// What the readings look like `elapsed` samples after a jump of `size`; infinite where that is not known any more.
    pub(super) fn fault(&self, size: f64, turns: bool, elapsed: u64) -> Fault {
        let turn = (size.abs() / core::f64::consts::TAU).round();
        if turns && turn >= 1.0 && (size.abs() - turn * core::f64::consts::TAU).abs() < 0.1 {
            return Fault::Wrap;
        }
        if self.last == 0.0 {
            return Fault::Dead;
        }
        if u64::from(self.run) > elapsed + 1 {
            let at_end = self.last.abs() >= self.largest * (1.0 - 1e-9);
            return if at_end { Fault::Saturated } else { Fault::Stuck };
        }
        let onset = self.last / (self.last - size);
        let lasting = self.product / self.power.max(f64::MIN_POSITIVE);
        if (onset + 1.0).abs() < 0.1 || (lasting + 1.0).abs() < 0.2 { Fault::Flipped } else { Fault::Step }
    }
}
