//! What white noise that acts all the time adds to the elastic-joint model's covariance over a step.

use super::gaussian::Symmetric;
use crate::linear::{self, Part};

/// Nodes on (0, 1), each with its weight.
pub(super) type Nodes = &'static [(f64, f64)];

/// Gauss and Legendre's: exact for the seventh power, the link's own from a motor's white torque.
pub(super) const FOUR: Nodes = &[
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// The same for the ninth power, the link's own from a motor's white jerk.
pub(super) const FIVE: Nodes = &[
    (0.046_910_077_030_668_004, 0.118_463_442_528_094_54),
    (0.230_765_344_947_158_45, 0.239_314_335_249_683_23),
    (0.5, 0.284_444_444_444_444_44),
    (0.769_234_655_052_841_6, 0.239_314_335_249_683_23),
    (0.953_089_922_969_332, 0.118_463_442_528_094_54),
];

/// Q = ∫ e^(As) L Lᵀ e^(As)ᵀ ds over a step, and Ψ = ∫ e^(As) ds b for inputs b that are constant over it.
///
/// Over a substep by a quadrature, whose factor is positive by construction, then by doubling: Q ← Q + Φ Q Φᵀ. (One
/// exponential of twice the size, Van Loan 1978, holds −A and breaks down where damping is stiff.)
#[derive(Clone, Debug)]
pub(super) struct StepNoise {
    /// States that noise drives, and its density.
    sources: Vec<(usize, f64)>,
    /// Where in a substep the quadrature looks at it.
    nodes: Nodes,
    /// States from this one on are moved by noise of their own alone.
    moving: usize,
    /// Q.
    covariance: Symmetric,
    /// One row for each node and source, of the quadrature's factor.
    rows: Vec<f64>,
    /// ∫ e^(As)ᵀ ds over the substep.
    integral: Vec<f64>,
    /// Ψ, one row an input; torques are the first.
    inputs: Vec<f64>,
    /// Scratch: one input's rate, or Φ Ψ.
    moved: Vec<f64>,
}

impl StepNoise {
    /// For `dense` states, those from `moving` on by themselves, that noise drives at `sources` with these densities, and this
    /// many `inputs`.
    pub(super) fn new(
        (dense, moving): (usize, usize),
        sources: Vec<(usize, f64)>,
        nodes: Nodes,
        inputs: usize,
    ) -> Self {
        let covariance = Symmetric::zeros(dense);
        let stride = covariance.stride;
        Self {
            rows: vec![0.0; nodes.len() * sources.len() * stride],
            integral: vec![0.0; stride * stride],
            inputs: vec![0.0; inputs * stride],
            moved: vec![0.0; inputs * stride],
            moving,
            sources,
            nodes,
            covariance,
        }
    }

    /// From now on noise drives `state` with this density.
    #[inline(always)]
    pub(super) fn set_density(&mut self, state: usize, density: f64) {
        for source in self.sources.iter_mut().filter(|(driven, _)| *driven == state) {
            source.1 = density;
        }
    }

    /// At the end of the step `state` is another one, independent of all, of this variance.
    #[inline(always)]
    pub(super) fn replace(&mut self, state: usize, variance: f64) {
        for k in 0..self.covariance.n {
            self.covariance.put(state, k, 0.0);
        }
        self.covariance.put(state, state, variance);
    }

    /// The term of order zero, the identity.
    #[inline(always)]
    pub(super) fn begin(&mut self) {
        let stride = self.covariance.stride;
        self.rows.fill(0.0);
        for (at, row) in self.rows.chunks_exact_mut(stride).enumerate() {
            let (state, density) = self.sources[at % self.sources.len()];
            row[state] = density;
        }
        self.integral.fill(0.0);
        (0..self.covariance.n).for_each(|i| self.integral[i * (stride + 1)] = 1.0);
    }

    /// Takes (A h)ᵏ/k! of the substep h, `turned`.
    #[inline(always)]
    pub(super) fn term(&mut self, k: usize, turned: &[f64]) {
        let (d, stride) = (self.covariance.n, self.covariance.stride);
        // ∫₀¹ sᵏ ds = 1/(k + 1).
        linear::add_scaled(&mut self.integral, 1.0 / (k + 1) as f64, turned);
        // e^(A x h) = Σ xᵏ (A h)ᵏ/k! at each node x: the exponential's own terms serve all nodes.
        for ((x, _), rows) in self.nodes.iter().zip(self.rows.chunks_exact_mut(self.sources.len() * stride)) {
            let power = x.powi(k as i32);
            for (row, (state, density)) in rows.chunks_exact_mut(stride).zip(&self.sources) {
                linear::add_scaled(&mut row[..d], density * power, &turned[state * stride..]);
            }
        }
    }

    /// After the last term: Q of the substep `h` [s], and Ψ of the rates b that `rate` writes for each input.
    #[inline(always)]
    pub(super) fn substep(&mut self, h: f64, mut rate: impl FnMut(usize, &mut [f64])) {
        let Self { sources, moving, covariance, rows, integral, inputs, moved, nodes } = self;
        let Symmetric { n: d, stride, ref mut data } = *covariance;
        for (rows, (_, weight)) in rows.chunks_exact_mut(sources.len() * stride).zip(*nodes) {
            let root = (h * weight).sqrt();
            rows.iter_mut().for_each(|x| *x *= root);
        }
        data.fill(0.0);
        linear::add_symmetric_part(rows, rows, Part { stride, columns: *moving }, data);
        for (at, row) in rows.chunks_exact(stride).enumerate() {
            let state = sources[at % sources.len()].0;
            if state >= *moving {
                linear::add_scaled(&mut data[state * stride..][..d], row[state], row);
            }
        }
        covariance.turn_rows(*moving);
        for (j, out) in inputs.chunks_exact_mut(stride).enumerate() {
            let by = &mut moved[..d];
            by.fill(0.0);
            rate(j, by);
            out.fill(0.0);
            for (by, row) in by.iter().zip(integral.chunks_exact(stride)).filter(|(by, _)| **by != 0.0) {
                linear::add_scaled(out, h * by, row);
            }
        }
    }

    /// From a substep to two of them, Φ being over the first and `turned` its transpose.
    #[inline(always)]
    pub(super) fn double(&mut self, phi: &[f64], turned: &[f64], wide: &mut [f64]) {
        let Self { moving, covariance, inputs, moved, .. } = self;
        let Symmetric { n: d, stride, ref mut data } = *covariance;
        let part = Part { stride, columns: *moving };
        let turned = &turned[..d * stride];
        // Q Φᵀ, and Φ Q Φᵀ by its transpose.
        linear::product_part(&data[..d * stride], stride, turned, part, wide);
        linear::add_symmetric_part(wide, turned, part, data);
        for i in *moving..d {
            let own = phi[i * (stride + 1)];
            let (row, product) = (&mut data[i * stride..][..d], &wide[i * stride..]);
            linear::add_scaled(&mut row[..*moving], own, product);
            (*moving..d).for_each(|k| row[k] += own * row[k] * phi[k * (stride + 1)]);
        }
        covariance.turn_rows(*moving);
        linear::product_part(inputs, stride, turned, part, moved);
        for (input, moved) in inputs.chunks_exact_mut(stride).zip(moved.chunks_exact(stride)) {
            linear::add_scaled(&mut input[..*moving], 1.0, moved);
            (*moving..d).for_each(|i| input[i] += phi[i * (stride + 1)] * input[i]);
        }
    }

    /// Q with torques of these `variances`.
    #[inline(always)]
    pub(super) fn add_torques(&mut self, variances: &[f64]) {
        let Self { covariance: Symmetric { stride, data, .. }, inputs, moved, .. } = self;
        let rows = variances.len() * *stride;
        let (inputs, weighted) = (&inputs[..rows], &mut moved[..rows]);
        for ((to, from), variance) in
            weighted.chunks_exact_mut(*stride).zip(inputs.chunks_exact(*stride)).zip(variances)
        {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = variance * from);
        }
        linear::add_symmetric(weighted, inputs, *stride, data);
    }

    /// Q with a covariance more.
    #[inline(always)]
    pub(super) fn add(&mut self, more: &Symmetric) {
        linear::add_scaled(&mut self.covariance.data, 1.0, &more.data);
    }

    /// Room for further inputs, up to this many.
    pub(super) fn set_inputs(&mut self, inputs: usize) {
        self.inputs = vec![0.0; inputs * self.covariance.stride];
        self.moved = self.inputs.clone();
    }

    /// Ψ of each input from the `first` on, a padded row each.
    #[inline(always)]
    pub(super) fn responses(&self, first: usize) -> impl Iterator<Item = &[f64]> {
        self.inputs.chunks_exact(self.covariance.stride).skip(first)
    }

    /// Q.
    pub(super) fn covariance(&self) -> &Symmetric {
        &self.covariance
    }
}
