//! Values out of the bytes that a fuzzer changes. What is missing is zero, so that every input means something.

/// Bytes that are taken one after the other.
pub struct Bytes<'a>(pub &'a [u8]);

impl<'a> Bytes<'a> {
    /// Whether all are taken.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The next `count`, or as many as are left.
    pub fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        taken
    }

    /// A block with its length (two bytes) before it.
    pub fn block(&mut self) -> &'a [u8] {
        let length = u16::from_le_bytes(self.array());
        self.take(length.into())
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        self.take(1).first().copied().unwrap_or(0)
    }

    /// A number below `end`.
    pub fn below(&mut self, end: usize) -> usize {
        usize::from(self.byte()) % end.max(1)
    }

    /// True or not.
    pub fn flag(&mut self) -> bool {
        self.byte() & 1 == 1
    }

    /// A number: mostly plain ones, now and then what no sensor should say, or any pattern of bits.
    pub fn number(&mut self) -> f64 {
        const ODD: [f64; 12] =
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, 1e308, -1e308, 5e-324, 1e160, -1e20, 1e-300, 1e9];
        match self.byte() {
            kind @ 0..12 => ODD[usize::from(kind)],
            12 => f64::from_bits(u64::from_le_bytes(self.array())),
            _ => f64::from(i16::from_le_bytes(self.array())) / 4096.0,
        }
    }

    /// Some numbers.
    pub fn numbers(&mut self, count: usize) -> Vec<f64> {
        (0..count).map(|_| self.number()).collect()
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut array = [0; N];
        let taken = self.take(N);
        array[..taken.len()].copy_from_slice(taken);
        array
    }
}
