//! Random numbers that depend on nothing but where they are used.

/// A generator by counter: each (seed, stream, index) has its own number, in whatever order they are asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Random {
    pub(super) seed: u64,
}

impl Random {
    /// A standard normal number (Box and Muller 1958).
    #[inline(always)]
    pub(super) fn normal(self, stream: u64, index: u64) -> f64 {
        let key = mix(mix(self.seed).wrapping_add(stream));
        let bits = |i: u64| mix(key.wrapping_add(2 * index + i)) >> 11;
        // In (0, 1]: the logarithm stays finite.
        let [u, v] = [0, 1].map(|i| (bits(i) + 1) as f64 * (-53.0_f64).exp2());
        (-2.0 * u.ln()).sqrt() * (core::f64::consts::TAU * v).cos()
    }
}

/// The mixing of SplitMix64 (Steele, Lea and Flood 2014).
#[inline(always)]
fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_normal_and_streams_independent() {
        let (random, count) = (Random { seed: 7 }, 200_000_u64);
        let draw = |stream| (0..count).map(move |i| random.normal(stream, i));
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count as f64;
        assert!(mean(&mut draw(0)).abs() < 0.01);
        assert!((mean(&mut draw(0).map(|v| v * v)) - 1.0).abs() < 0.015);
        assert!((mean(&mut draw(0).map(|v| v.powi(4))) - 3.0).abs() < 0.15);
        assert!(mean(&mut draw(0).zip(draw(1)).map(|(a, b)| a * b)).abs() < 0.01);
        assert!(mean(&mut draw(0).zip(draw(0).skip(1)).map(|(a, b)| a * b)).abs() < 0.01);
    }
}
