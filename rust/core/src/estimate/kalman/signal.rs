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
    /// A motor's position that goes off from where its measured velocity brings it.
    Drift,
    /// None of these: innovations that lean to one side for long.
    Correlated,
    /// None of these.
    Unknown,
}

impl Fault {
    /// Whether readings do not follow the robot any more.
    pub(super) fn repeats(self) -> bool {
        matches!(self, Self::Stuck | Self::Saturated | Self::Dead)
    }
}

/// Repetitions of a reading, to the last bit, from which a channel that used to change is stuck.
pub(super) const RUN: u32 = 8;
/// Standard deviations of a reading by which its prediction moves on while it is stuck.
const MOVED: f64 = 6.0;
/// Changes of a reading after which its scatter is known.
const KNOWN: u32 = 32;
/// Steps of a reading, in its scatter, below which it does not come [`RUN`] times by chance: once in 10⁹.
const FINE: f64 = 0.2;
/// Part of the noise that a channel should have below which its scatter is not noise.
const QUIET: f64 = 0.3;

/// Standard deviations of a position by which its motor must turn to show that it is stuck.
const TURNED: f64 = 20.0;
/// A motor turns that is faster than this [rad/s or m/s]: a tachometer's zero error is less.
const TURNS: f64 = 0.02;

/// How far a motor has turned by its velocity while its position stayed the same, to the last bit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turned {
    by: f64,
    /// In so many samples.
    pub(super) samples: u32,
}

impl Turned {
    /// Takes a velocity, NaN where missing, `dt` after the one before; `run` is how often the position has come in a row.
    #[inline(always)]
    pub(super) fn take(&mut self, run: u32, speed: f64, dt: f64) {
        if run > 1 && speed.abs() > TURNS {
            *self = Self { by: self.by + speed * dt, samples: self.samples + 1 };
        } else {
            *self = Self::default();
        }
    }

    /// Whether a position of this variance is stuck.
    #[inline(always)]
    pub(super) fn is_stuck(self, variance: f64) -> bool {
        self.samples >= RUN && self.by * self.by > TURNED * TURNED * variance
    }
}

/// One channel's readings so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Signal {
    /// The last reading; NaN before the first.
    last: f64,
    /// How often the last reading has come in a row, and how far its prediction has moved meanwhile.
    pub(crate) run: u32,
    /// Prediction when this run began, and how far it has moved since.
    from: f64,
    moved: f64,
    /// Of all readings, without sign: the end of the range, as far as is known.
    largest: f64,
    /// Σ y ŷ and Σ ŷ² of the latest readings.
    product: f64,
    power: f64,
    /// Reading less prediction before, changes so far, mean square of what it changes by, least change of the reading,
    /// and longest run before this one.
    off: f64,
    changes: u32,
    scatter: f64,
    step: f64,
    longest: u32,
}

impl Signal {
    /// Before the first reading.
    pub(crate) const NEW: Self = Self {
        last: f64::NAN,
        run: 0,
        from: 0.0,
        moved: 0.0,
        largest: 0.0,
        product: 0.0,
        power: 0.0,
        off: 0.0,
        changes: 0,
        scatter: 0.0,
        step: f64::INFINITY,
        longest: 0,
    };

    /// Takes a reading and its prediction. Equal to the last bit is the same reading: noise would not do that.
    #[inline(always)]
    pub(crate) fn take(&mut self, reading: f64, predicted: f64) {
        if reading == self.last {
            self.run += 1;
        } else {
            self.change(reading, predicted);
            (self.run, self.from) = (1, predicted);
        }
        self.off = reading - predicted;
        self.moved = (predicted - self.from).abs();
        self.last = reading;
        self.largest = self.largest.max(reading.abs());
        // Of the last ten readings or so: a turned sign makes Σ y ŷ negative, whatever the size.
        self.product = 0.9 * self.product + reading * predicted;
        self.power = 0.9 * self.power + predicted * predicted;
    }

    /// Takes note of how readings change from one to the next.
    #[inline(always)]
    fn change(&mut self, reading: f64, predicted: f64) {
        self.longest = self.longest.max(self.run);
        if !self.last.is_nan() {
            self.changes += 1;
            self.step = self.step.min((reading - self.last).abs());
            let change = reading - predicted - self.off;
            self.scatter += (change * change - self.scatter) / f64::from(self.changes.min(KNOWN));
        }
    }

    /// Whether readings of this noise stay where they are while the prediction moves on, or while they used to scatter.
    #[inline(always)]
    pub(crate) fn is_stuck(&self, variance: f64) -> bool {
        let scatter = 0.5 * self.scatter;
        let noisy = self.changes >= KNOWN
            && scatter > QUIET * QUIET * variance
            && self.step * self.step < FINE * FINE * scatter
            && self.run > 2 * self.longest;
        self.run >= RUN && (noisy || self.moved * self.moved > MOVED * MOVED * variance)
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
        // y/(y − jump) is the ratio to what was expected: −1 where the sign turned at the jump.
        let onset = self.last / (self.last - size);
        let lasting = self.product / self.power.max(f64::MIN_POSITIVE);
        if (onset + 1.0).abs() < 0.1 || (lasting + 1.0).abs() < 0.2 { Fault::Flipped } else { Fault::Step }
    }
}
