//! What a channel's readings look like by themselves, without a model.

/// Kinds of faults, by how the readings of a channel look where they contradict the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The same reading over and over.
    Stuck,
    /// The same reading over and over, at the end of what the channel ever read.
    Saturated,
    /// Nothing but zero.
    Dead,
    /// A jump by about a whole turn.
    Wrap,
    /// A step that stays.
    Step,
    /// The sign is turned.
    Flipped,
    /// Readings are too large, or too small, by a factor.
    Gain,
    /// None of these.
    Unknown,
}

/// Repetitions of a reading, to the last bit, from which a channel that used to change is stuck.
pub(super) const RUN: u32 = 8;
/// Readings that tell how often a channel repeats itself.
const LEARNT: u32 = 64;

/// One channel's readings so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Signal {
    last: f64,
    /// How often the last reading has come in a row, and the longest such row before.
    pub(super) run: u32,
    longest: u32,
    taken: u32,
    largest: f64,
    /// Since a fault was found: Σ y ŷ, Σ ŷ², and their counts.
    product: f64,
    power: f64,
}

impl Signal {
    pub(super) const NEW: Self =
        Self { last: f64::NAN, run: 0, longest: 1, taken: 0, largest: 0.0, product: 0.0, power: 0.0 };

    #[inline(always)]
    pub(super) fn take(&mut self, reading: f64, predicted: f64) {
        if reading == self.last {
            self.run += 1;
        } else {
            if self.run < RUN {
                self.longest = self.longest.max(self.run);
            }
            self.run = 1;
        }
        self.last = reading;
        self.taken += 1;
        self.largest = self.largest.max(reading.abs());
        self.product = 0.9 * self.product + reading * predicted;
        self.power = 0.9 * self.power + predicted * predicted;
    }

    /// Whether a channel that hardly ever repeats itself does.
    #[inline(always)]
    pub(super) fn is_stuck(&self) -> bool {
        self.run >= RUN.max(4 * self.longest) && self.taken > LEARNT + self.run
    }

    /// What the readings look like, after a jump of `size` where one was seen.
    pub(super) fn kind(&self, size: f64, turns: bool) -> Kind {
        let turn = (size.abs() / core::f64::consts::TAU).round();
        if turns && turn >= 1.0 && (size.abs() - turn * core::f64::consts::TAU).abs() < 0.1 {
            return Kind::Wrap;
        }
        if self.run >= RUN / 2 {
            let at_end = self.last.abs() >= self.largest * (1.0 - 1e-9);
            return match (self.last == 0.0, at_end) {
                (true, _) => Kind::Dead,
                (false, true) => Kind::Saturated,
                _ => Kind::Stuck,
            };
        }
        let factor = self.product / self.power.max(f64::MIN_POSITIVE);
        match factor {
            f if (f + 1.0).abs() < 0.2 => Kind::Flipped,
            f if f.abs() < 0.02 => Kind::Dead,
            _ => Kind::Step,
        }
    }
}
