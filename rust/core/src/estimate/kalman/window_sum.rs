//! Sums over the last samples.

use super::isolation::Squares;

/// The sum over a window that moves on with each sample: of a few additions a sample, and none of them ever taken back, as a
/// difference would drift.
///
/// Samples come in blocks of a window's length. Of the block before the present one there are the sums from each sample to
/// its end.
#[derive(Clone, Debug)]
pub(super) struct WindowSum {
    /// The present block's samples so far, and what the last block sums up to from there on.
    block: Vec<[Squares; 2]>,
    /// Samples of the present block, and their sum.
    taken: usize,
    present: [Squares; 2],
}

impl WindowSum {
    /// Over this many samples.
    pub(super) fn new(length: usize) -> Self {
        Self { block: vec![Default::default(); length], taken: 0, present: Default::default() }
    }

    /// Before the first sample.
    pub(super) fn clear(&mut self) {
        self.block.fill(Default::default());
        (self.taken, self.present) = (0, Default::default());
    }

    /// Takes a sample; gives the sum of the last ones.
    #[inline(always)]
    pub(super) fn take(&mut self, sample: [Squares; 2]) -> [Squares; 2] {
        if self.taken == self.block.len() {
            let mut sum = Default::default();
            for own in self.block.iter_mut().rev() {
                join(&mut sum, own);
                *own = sum;
            }
            (self.taken, self.present) = (0, Default::default());
        }
        join(&mut self.present, &sample);
        self.block[self.taken] = sample;
        self.taken += 1;
        let mut sum = self.present;
        if let Some(before) = self.block.get(self.taken) {
            join(&mut sum, before);
        }
        sum
    }
}

#[inline(always)]
fn join(sum: &mut [Squares; 2], other: &[Squares; 2]) {
    for (sum, other) in sum.iter_mut().zip(other) {
        sum.join(other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_sum_of_the_last_samples(
            length in 1_usize..9,
            samples in proptest::collection::vec((0.0..9.0, 0.0..1.0), 0..40),
        ) {
            let of = |&(sum, count): &(f64, f64)| [Squares { sum, count }, Squares { sum: 2.0 * sum, count: 1.0 }];
            let mut sums = WindowSum::new(length);
            for (i, sample) in samples.iter().enumerate() {
                let [own, other] = sums.take(of(sample));
                let last = &samples[(i + 1).saturating_sub(length)..=i];
                let sum: f64 = last.iter().map(|x| x.0).sum();
                prop_assert!((own.sum - sum).abs() < 1e-12 && (other.sum - 2.0 * sum).abs() < 1e-12);
                prop_assert!((own.count - last.iter().map(|x| x.1).sum::<f64>()).abs() < 1e-12);
                prop_assert_eq!(other.count, last.len() as f64);
            }
        }
    }
}
