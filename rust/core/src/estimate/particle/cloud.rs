//! Where the particles are kept: blocks of fixed size, a row of numbers for each entry of the state.

use super::rao_blackwell::{Densities, covariance_entries};
use super::settings::Marginalised;
use crate::error::DesignError;
use crate::estimate::kalman::JerkModel;
use crate::estimate::measurement::Evaluation;
use crate::memory::{filled, room};
use crate::parallel;
use crate::scalar::Lanes;

/// Particles a block. Sums are formed by block, then over blocks in order, whatever thread each was on.
pub(super) const BLOCK: usize = 512;
/// Particles that go through a kernel together.
pub(super) const WIDE: usize = 8;

/// One number of each particle of a group.
pub(super) type Wide = Lanes<WIDE>;

/// A number of each particle of a block, by groups of [`WIDE`].
///
/// One group more than there are particles: rows a whole page apart would all want the same few lines of the cache.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct ParticleRow(pub(super) [[f64; WIDE]; BLOCK / WIDE + 1]);

impl ParticleRow {
    /// The same for all.
    fn of(value: f64) -> Self {
        Self([[value; WIDE]; BLOCK / WIDE + 1])
    }

    /// Particle by particle.
    #[inline(always)]
    pub(super) fn each(&self) -> &[f64] {
        self.0.as_flattened()
    }

    /// The numbers one after the other, for writing.
    #[inline(always)]
    pub(super) fn each_mut(&mut self) -> &mut [f64] {
        self.0.as_flattened_mut()
    }
}

/// Some particles, and the scratch to move them.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Number of the first particle.
    pub(super) first: usize,
    /// Particles in use.
    pub(super) count: usize,
    /// Entries of the state; after them, where accelerations are marginalised, of a covariance.
    pub(super) state: Vec<ParticleRow>,
    /// Logarithms of weights, −∞ for what is not in use.
    pub(super) log_weights: ParticleRow,
    /// Weights as multiples of the block's largest.
    pub(super) weights: ParticleRow,
    /// Of the weighted particles.
    pub(super) sums: Sums,
    /// Room for a group on its way, of this block's thread alone.
    pub(super) scratch: Scratch,
    /// There where accelerations are marginalised.
    pub(super) densities: Option<Box<Densities>>,
}

/// Sums over a block, weights as multiples of its largest.
#[derive(Clone, Debug)]
pub(super) struct Sums {
    /// The largest logarithm of a weight, and whose it is.
    pub(super) largest: f64,
    pub(super) best: usize,
    /// Σ w and Σ w².
    pub(super) weight: f64,
    pub(super) square: f64,
    /// Of each entry of the state.
    pub(super) state: Vec<f64>,
    /// Of products of two entries' deviations, upper triangle by rows.
    pub(super) products: Vec<f64>,
}

/// Room for [`WIDE`] particles on their way.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    /// h and its Jacobian at the particles.
    pub(super) evaluation: Evaluation<Wide>,
    /// q, q̇, q̈ and biases before the noise, and after it.
    pub(super) before: Vec<Wide>,
    pub(super) after: Vec<Wide>,
    /// Standard normal numbers, and those of them, or near the proposal's mode, that are the links' noise.
    pub(super) normal: Vec<Wide>,
    pub(super) noise: Vec<Wide>,
    /// Mode of the proposal.
    pub(super) mode: Vec<Wide>,
    /// Factor of its information matrix, by rows.
    pub(super) factor: Vec<Wide>,
    /// How a reading changes with the noise.
    pub(super) row: Vec<Wide>,
}

impl Scratch {
    /// For a proposal of `drawn` numbers.
    pub(super) fn new(model: &JerkModel, drawn: usize) -> Self {
        let room = |size| vec![Wide::default(); size];
        let states = model.states();
        Self {
            evaluation: Evaluation::new(&model.robot, model.channels()),
            before: room(states),
            after: room(states),
            normal: room(states + 1),
            noise: room(drawn),
            mode: room(drawn),
            factor: room(drawn * drawn),
            row: room(drawn),
        }
    }
}

impl Block {
    fn new(model: &JerkModel, marginalised: Marginalised, first: usize, count: usize) -> Result<Self, DesignError> {
        let (d, n) = (model.states(), model.joints());
        let accelerations = marginalised == Marginalised::Accelerations;
        let (more, drawn) = if accelerations { (covariance_entries(model), 2 * n) } else { (0, 3 * n) };
        Ok(Self {
            first,
            count,
            state: filled(ParticleRow::of(0.0), d + more, 1)?,
            log_weights: ParticleRow::of(f64::NEG_INFINITY),
            weights: ParticleRow::of(0.0),
            sums: Sums {
                largest: f64::NEG_INFINITY,
                best: 0,
                weight: 0.0,
                square: 0.0,
                state: vec![0.0; d],
                products: vec![0.0; d * (d + 1) / 2],
            },
            scratch: Scratch::new(model, drawn),
            densities: accelerations.then(|| Box::new(Densities::new(model))),
        })
    }

    /// Groups of [`WIDE`] that hold a particle in use.
    #[inline(always)]
    pub(super) fn groups(&self) -> usize {
        self.count.div_ceil(WIDE)
    }

    /// Numbers of the particles of a group.
    #[inline(always)]
    pub(super) fn items(&self, group: usize) -> [u32; WIDE] {
        let first = (self.first + group * WIDE) as u32;
        core::array::from_fn(|l| first + l as u32)
    }
}

/// All particles.
#[derive(Clone, Debug)]
pub(super) struct Cloud {
    /// [`BLOCK`] particles each, but for the last.
    pub(super) blocks: Vec<Block>,
    /// Where chosen particles are copied to.
    pub(super) next: Vec<Vec<ParticleRow>>,
}

impl Cloud {
    pub(super) fn new(model: &JerkModel, marginalised: Marginalised, particles: usize) -> Result<Self, DesignError> {
        let count = particles.div_ceil(BLOCK);
        let (mut blocks, mut next) = (room(count, 1)?, room(count, 1)?);
        // All at once first, so that what does not fit is refused before any of it is taken, and with its size.
        drop(room::<ParticleRow>(count, 2 * model.states())?);
        for first in (0..particles).step_by(BLOCK) {
            let block = Block::new(model, marginalised, first, BLOCK.min(particles - first))?;
            next.push(filled(ParticleRow::of(0.0), block.state.len(), 1)?);
            blocks.push(block);
        }
        Ok(Self { blocks, next })
    }

    /// Calls `f` with every block, on all threads where `threads` says so.
    pub(super) fn each(&mut self, threads: bool, f: impl Fn(&mut Block) + Sync + Send) {
        let count = if threads { self.blocks.len() } else { 1 };
        parallel::each_short(self.blocks.iter_mut(), count, f);
    }

    /// Entry `d` of particle `i`.
    #[inline(always)]
    pub(super) fn at(&self, i: usize, d: usize) -> f64 {
        self.blocks[i / BLOCK].state[d].each()[i % BLOCK]
    }
}
