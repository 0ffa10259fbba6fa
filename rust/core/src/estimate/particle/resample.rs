//! Which particles go on: N ancestors in proportion to weights, each method unbiased in the number of copies.

use super::settings::Resampling;
use crate::random::Stream;
use crate::scalar::ln;

/// Writes an ancestor for each of `ancestors`, in order; `weights` gives the weights, which sum to one.
pub(super) fn choose(
    method: Resampling,
    stream: &Stream,
    weights: impl Iterator<Item = f64> + Clone,
    ancestors: &mut [u32],
) {
    let count = ancestors.len();
    match method {
        // One uniform number for all (Carpenter, Clifford and Fearnhead 1999): the least variance, the usual choice.
        Resampling::Systematic => {
            systematic(weights, stream.uniform(0), ancestors);
        }
        // One in each of N strata (Kitagawa 1996).
        Resampling::Stratified => {
            walk(weights, count, ancestors, |k| (k as f64 + stream.uniform(k as u32)) / count as f64);
        }
        // Whole parts without chance, chance for the fractions alone (Liu and Chen 1998).
        Resampling::Residual => residual(stream, weights, ancestors),
        // Independent draws (Gordon, Salmond and Smith 1993): the most variance, for comparison.
        Resampling::Multinomial => multinomial(stream, weights, ancestors),
    }
}

/// For k = 0, 1, …, N − 1 the first particle up to which the weights sum to more than (k + shift)/N.
///
/// Without a branch on how many copies there are of each, which a processor could not foresee.
fn systematic(weights: impl Iterator<Item = f64> + Clone, shift: f64, ancestors: &mut [u32]) {
    let count = ancestors.len();
    let scale = count as f64 / weights.clone().sum::<f64>();
    let (mut sum, mut from) = (0.0, 0);
    ancestors.fill(0);
    weights.enumerate().for_each(|(i, w)| {
        // Whoever has no copies leaves the mark to the next; behind the last copy there is no place for one.
        if let Some(mark) = ancestors.get_mut(from) {
            *mark = i as u32;
        }
        sum += w;
        let end = sum * scale - shift;
        let whole = end as i32; // below 2²², see MOST_PARTICLES
        from = whole as usize + usize::from(f64::from(whole) < end);
    });
    let mut last = 0;
    for ancestor in ancestors {
        last = last.max(*ancestor);
        *ancestor = last;
    }
}

/// Whole copies ⌊N w⌋, and the fractions that are left systematically.
fn residual(stream: &Stream, weights: impl Iterator<Item = f64> + Clone, ancestors: &mut [u32]) {
    let count = ancestors.len();
    let whole = |w: f64| (count as f64 * w).floor();
    let mut taken = 0;
    for (i, w) in weights.clone().enumerate() {
        let copies = (whole(w) as usize).min(count - taken);
        ancestors[taken..taken + copies].fill(i as u32);
        taken += copies;
    }
    let rest = count - taken;
    if rest > 0 {
        let fractions = weights.map(|w| (count as f64 * w - whole(w)) / rest as f64);
        systematic(fractions, stream.uniform(0), &mut ancestors[taken..]);
    }
}

/// Sorted uniform numbers, drawn as sums of exponential ones.
fn multinomial(stream: &Stream, weights: impl Iterator<Item = f64>, ancestors: &mut [u32]) {
    let count = ancestors.len();
    let wait = |k: usize| -ln(stream.uniform(k as u32));
    let whole: f64 = (0..=count).map(wait).sum();
    let mut sum = 0.0;
    walk(weights, count, ancestors, |k| {
        sum += wait(k);
        sum / whole
    });
}

/// For k = 0, 1, …, in increasing order, the first particle up to which the weights sum to more than `point(k)`.
fn walk(
    mut weights: impl Iterator<Item = f64>,
    count: usize,
    ancestors: &mut [u32],
    mut point: impl FnMut(usize) -> f64,
) {
    let (mut ancestor, mut last) = (0, 0);
    let mut sum = weights.next().unwrap_or(1.0);
    for (k, out) in ancestors.iter_mut().enumerate().take(count) {
        let point = point(k);
        while sum <= point {
            // Rounding may leave the sum below one: the last particle with a weight takes what is left.
            let Some(w) = weights.next() else { break };
            ancestor += 1;
            sum += w;
            if w > 0.0 {
                last = ancestor;
            }
        }
        *out = if sum <= point { last } else { ancestor };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    const METHODS: [Resampling; 4] =
        [Resampling::Systematic, Resampling::Stratified, Resampling::Residual, Resampling::Multinomial];

    fn copies(method: Resampling, seed: u64, weights: &[f64]) -> Vec<f64> {
        let mut ancestors = vec![0; weights.len()];
        choose(method, &Stream::new(seed, 0, Purpose::Ancestors), weights.iter().copied(), &mut ancestors);
        let mut out = vec![0.0; weights.len()];
        for a in ancestors {
            out[a as usize] += 1.0;
        }
        out
    }

    #[test]
    fn every_method_is_unbiased() {
        let weights = [0.02, 0.3, 0.0, 0.08, 0.25, 0.35];
        let runs = 20_000;
        for method in METHODS {
            let mut mean = [0.0; 6];
            for seed in 0..runs {
                for (sum, c) in mean.iter_mut().zip(copies(method, seed, &weights)) {
                    *sum += c / runs as f64;
                }
            }
            for (m, w) in mean.iter().zip(weights) {
                // Five standard errors of the noisiest, the multinomial method's.
                let bound = 5.0 * (6.0 * w * (1.0 - w) / runs as f64).sqrt();
                assert!((m - 6.0 * w).abs() <= bound + 1e-12, "{method:?}: {mean:?}");
            }
        }
    }

    #[test]
    fn systematic_and_residual_copies_are_whole_parts_or_one_more() {
        let weights: Vec<f64> = (1..=20).map(|i| f64::from(i) / 210.0).collect();
        for seed in 0..200 {
            for method in [Resampling::Systematic, Resampling::Residual] {
                for (c, w) in copies(method, seed, &weights).iter().zip(&weights) {
                    assert!((c - 20.0 * w).abs() < 1.0 + 1e-12, "{method:?}");
                }
            }
        }
    }

    #[test]
    fn a_particle_without_weight_has_no_offspring() {
        for method in METHODS {
            for seed in 0..100 {
                let few = copies(method, seed, &[0.0, 0.0, 1.0 - 1e-16, 0.0, 0.0]);
                assert_eq!(few, [0.0, 0.0, 5.0, 0.0, 0.0], "{method:?}");
            }
            assert_eq!(copies(method, 0, &[1.0]), [1.0]);
        }
    }
}
