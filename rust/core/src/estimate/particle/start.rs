//! The first cloud.

use super::cloud::{BLOCK, Cloud, WIDE};
use super::proposal::draw;
use super::random::{Purpose, Stream};
use crate::estimate::kalman::Gaussian;

/// Draws particles from a belief of independent entries; from entry `spread` on they sit at the mean.
pub(super) fn scatter(cloud: &mut Cloud, belief: &Gaussian, spread: usize, seed: u64) {
    let stream = Stream::new(seed, 0, Purpose::Start);
    let even = -(cloud.blocks.iter().map(|b| b.count).sum::<usize>() as f64).ln();
    for block in &mut cloud.blocks {
        for group in 0..block.groups() {
            let items = block.items(group);
            draw(&stream, items, 0, &mut block.scratch.normal[..spread]);
            for (d, row) in block.state.chunks_exact_mut(BLOCK).enumerate() {
                let std = if d < spread { belief.covariance.at(d, d).sqrt() } else { 0.0 };
                let normal = block.scratch.normal[d].0;
                row.as_chunks_mut::<WIDE>().0[group] = normal.map(|z| belief.mean[d] + if d < spread { std * z } else { 0.0 });
            }
        }
        block.log_weights[..block.count].fill(even);
    }
}
