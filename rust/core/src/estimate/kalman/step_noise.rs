//! What white noise that acts all the time adds to the elastic-joint model's covariance over a step.

use super::gaussian::Symmetric;
use crate::linear;

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
    /// Q.
    covariance: Symmetric,
    /// One row for each node and source, of the quadrature's factor.
    rows: Vec<f64>,
    /// ∫ e^(As) ds over the substep.
    integral: Vec<f64>,
    /// Ψ, one row an input; torques are the first.
    inputs: Vec<f64>,
    /// Scratch: one input's rate, or Ψ before a doubling.
    before: Vec<f64>,
}

impl StepNoise {
    /// For `dense` states that noise drives at `sources` with these densities, and this many `inputs`.
    pub(super) fn new(dense: usize, sources: Vec<(usize, f64)>, nodes: Nodes, inputs: usize) -> Self {
        let covariance = Symmetric::zeros(dense);
        let stride = covariance.stride;
        Self {
            rows: vec![0.0; nodes.len() * sources.len() * stride],
            integral: vec![0.0; dense * stride],
            inputs: vec![0.0; inputs * stride],
            before: vec![0.0; stride],
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

    /// Before the first [`term`](Self::term).
    #[inline(always)]
    pub(super) fn clear(&mut self) {
        self.rows.fill(0.0);
        self.integral.fill(0.0);
    }

    /// Takes (A h)ᵏ/k! of the substep h.
    #[inline(always)]
    pub(super) fn term(&mut self, k: usize, term: &[f64]) {
        let (d, stride) = (self.covariance.n, self.covariance.stride);
        // ∫₀¹ sᵏ ds = 1/(k + 1).
        linear::add_scaled(&mut self.integral, 1.0 / (k + 1) as f64, term);
        // e^(A x h) = Σ xᵏ (A h)ᵏ/k! at each node x: the exponential's own terms serve all nodes.
        for (node, (x, _)) in self.nodes.iter().enumerate() {
            let power = x.powi(k as i32);
            for (c, (state, density)) in self.sources.iter().enumerate() {
                let row = &mut self.rows[(node * self.sources.len() + c) * stride..][..d];
                for (i, out) in row.iter_mut().enumerate() {
                    *out += density * power * term[i * stride + state];
                }
            }
        }
    }

    /// After the last term: Q of the substep `h` [s], and Ψ of the rates b that `rate` writes for each input.
    #[inline(always)]
    pub(super) fn substep(&mut self, h: f64, mut rate: impl FnMut(usize, &mut [f64])) {
        let (d, stride, sources) = (self.covariance.n, self.covariance.stride, self.sources.len());
        for (at, row) in self.rows.chunks_exact_mut(stride).enumerate() {
            let root = (h * self.nodes[at / sources].1).sqrt();
            row.iter_mut().for_each(|x| *x *= root);
        }
        self.covariance.data.fill(0.0);
        self.covariance.add_squares(1.0, &self.rows);
        for (j, out) in self.inputs.chunks_exact_mut(stride).enumerate() {
            self.before.fill(0.0);
            rate(j, &mut self.before[..d]);
            for (i, row) in self.integral.chunks_exact(stride).enumerate() {
                out[i] = h * linear::dot(row, &self.before);
            }
        }
    }

    /// From a substep to two of them, Φ being over the first and `turned` its transpose.
    #[inline(always)]
    pub(super) fn double(&mut self, phi: &[f64], turned: &[f64], product: &mut [f64], wide: &mut [f64]) {
        let stride = self.covariance.stride;
        linear::product(phi, stride, &self.covariance.data, stride, product);
        linear::product(product, stride, turned, stride, wide);
        linear::add_scaled(&mut self.covariance.data, 1.0, wide);
        self.covariance.mirror();
        for input in self.inputs.chunks_exact_mut(stride) {
            self.before.copy_from_slice(input);
            for (i, row) in phi.chunks_exact(stride).enumerate() {
                input[i] += linear::dot(row, &self.before);
            }
        }
    }

    /// Q with torques of these `variances`.
    #[inline(always)]
    pub(super) fn add_torques(&mut self, variances: &[f64]) {
        let Self { covariance, inputs, .. } = self;
        for (row, variance) in inputs.chunks_exact(covariance.stride).zip(variances) {
            for (i, x) in row.iter().enumerate().take(covariance.n) {
                linear::add_scaled(&mut covariance.data[i * covariance.stride..], variance * x, row);
            }
        }
    }

    /// Q with a covariance more.
    #[inline(always)]
    pub(super) fn add(&mut self, more: &Symmetric) {
        linear::add_scaled(&mut self.covariance.data, 1.0, &more.data);
    }

    /// Room for further inputs, up to this many.
    pub(super) fn set_inputs(&mut self, inputs: usize) {
        self.inputs = vec![0.0; inputs * self.covariance.stride];
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
