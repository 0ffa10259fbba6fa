//! Φ = e^(A h) of the elastic-joint model over a step of time, with the noise that enters meanwhile, and products with both.
//!
//! A has the structure of a second-order system: rows of q and θ are unit vectors, so that a product with it costs the rows of
//! accelerations alone, and a motor's acceleration depends on few states. States that nothing but noise moves (disturbances,
//! wrenches, accelerations of motors that jerk moves) stand last: their rows of Φ have the diagonal alone, and rows of products
//! with them are multiples. Of what is symmetric one half is computed.

use super::gaussian::Symmetric;
use super::sigma_points::SigmaPoints;
use super::single::SIDE;
use super::step_noise::{Nodes, StepNoise};
use crate::dynamics::{ElasticDynamics, ElasticLayout};
use crate::linear::{self, Part, Real};
use crate::robot::Robot;

/// Φ with Q beside it, and the scratch of what is done with them.
#[derive(Clone, Debug)]
pub(super) struct Exponential {
    /// States of the elastic-joint model, and numbers between rows of the matrices.
    dense: usize,
    stride: usize,
    /// Rows of Φ from this one on have nothing off the diagonal.
    moving: usize,
    /// Φ, and Φᵀ as it was last used.
    phi: Vec<f64>,
    turned: Vec<f64>,
    /// (A h)ᵏ/k!.
    term: Vec<f64>,
    /// Scratch of products, as large as Φ.
    product: Vec<f64>,
    /// P Φᵀ (states × stride).
    wide: Vec<f64>,
    /// Q and the responses to torques, built up beside Φ.
    pub(super) noise: StepNoise,
    /// The root of Q.
    root: Vec<f64>,
    /// Scratch of columns on their way through Φ, and of eight in single precision.
    carried: Vec<f64>,
    single: Vec<[f32; SIDE]>,
}

impl Exponential {
    /// Of a model of so many `states`, of which white noise drives the `sources` with these densities; `nodes` are those of its
    /// quadrature.
    pub(super) fn new(layout: &ElasticLayout, states: usize, (sources, nodes): (Vec<(usize, f64)>, Nodes)) -> Self {
        let (dense, stride) = (layout.dense, layout.dense.next_multiple_of(linear::LANES));
        let moving = first_constant(layout).next_multiple_of(linear::LANES).min(dense);
        let square = || vec![0.0; stride * stride];
        Self {
            dense,
            stride,
            moving,
            phi: square(),
            turned: square(),
            term: square(),
            product: square(),
            wide: vec![0.0; states * stride],
            noise: StepNoise::new((dense, moving), sources, nodes, layout.joints),
            root: square(),
            carried: Vec::new(),
            single: vec![[0.0; SIDE]; moving],
        }
    }

    /// Makes room for beliefs of `states`.
    pub(super) fn widen(&mut self, states: usize) {
        self.wide = vec![0.0; states * self.stride];
    }

    /// Makes room for columns of `stride` numbers.
    pub(super) fn reserve(&mut self, stride: usize) {
        self.carried = vec![0.0; self.dense * stride];
    }

    /// Φ = Σ (A h)ᵏ/k!, k up to `terms`, and what noise does meanwhile, A being where `dynamics` was differentiated.
    #[inline(always)]
    pub(super) fn expand(
        &mut self,
        robot: &Robot,
        layout: &ElasticLayout,
        dynamics: &ElasticDynamics,
        h: f64,
        terms: usize,
    ) {
        let Self { dense: d, stride, moving, phi, turned, term, product, noise, .. } = self;
        // Rows of A that are not zero.
        let rows = if layout.forgetting > 0.0 { *d } else { *moving };
        // k = 0: the identity.
        phi.fill(0.0);
        (0..*d).for_each(|i| phi[i * (*stride + 1)] = 1.0);
        term.fill(0.0);
        noise.begin();
        for k in 1..=terms {
            if k == 1 {
                write(layout, dynamics, *stride, product);
            } else {
                apply(layout, dynamics, &term[..rows * *stride], *stride, product);
            }
            for ((term, value), sum) in term.iter_mut().zip(&product[..rows * *stride]).zip(&mut *phi) {
                *term = value * (h / k as f64);
                *sum += *term;
            }
            linear::transpose(term, *stride, turned);
            noise.term(k, turned);
        }
        // Inputs: torques, then, where parameters count, unit rates of links' and of motors' velocities.
        let n = layout.joints;
        noise.substep(h, |input, rate| match input / n {
            0 => dynamics.rate_by_torque_into(robot, layout, input, rate),
            1 => rate[input] = 1.0,
            _ => rate[layout.dtheta[input - 2 * n]] = 1.0,
        });
    }

    /// Φ ← Φ², `doublings` times.
    #[inline(always)]
    pub(super) fn square(&mut self, doublings: u32) {
        let Self { dense: d, stride, moving, phi, turned, product, wide, noise, .. } = self;
        for _ in 0..doublings {
            linear::transpose(phi, *stride, turned);
            noise.double(phi, turned, &mut wide[..*d * *stride]);
            let rows = ..*moving * *stride;
            linear::product(&phi[rows], *stride, &phi[..*d * *stride], *stride, &mut product[rows]);
            phi[rows].copy_from_slice(&product[rows]);
            (*moving..*d).for_each(|i| phi[i * (*stride + 1)] *= phi[i * (*stride + 1)]);
        }
    }

    /// At the end of the step `state` is another one, independent of all, of this variance.
    #[inline(always)]
    pub(super) fn replace(&mut self, state: usize, variance: f64) {
        self.noise.replace(state, variance);
        self.phi[state * self.stride..][..self.dense].fill(0.0);
    }

    /// From the derivative to the slope of a regression, whose remainder is noise.
    #[inline(always)]
    pub(super) fn correct(&mut self, points: &mut SigmaPoints) {
        points.correct(&mut self.phi[..self.dense * self.stride], self.stride);
        self.noise.add(&points.residual);
    }

    /// P ← Φ P Φᵀ + Q, Φ being the identity beyond its own rows.
    #[inline(always)]
    pub(super) fn propagate(&mut self, p: &mut Symmetric) {
        let Self { dense: d, stride, moving, phi, turned, product, wide, noise, .. } = self;
        let (d, stride, moving, q) = (*d, *stride, *moving, noise.covariance());
        linear::transpose(phi, stride, turned);
        // W = P Φᵀ, and Φ P Φᵀ = Wᵀ Φᵀ: half of it is known by symmetry.
        product.copy_from_slice(&q.data);
        multiply(p, (&turned[..d * stride], Part { stride, columns: moving }), wide, product);
        for (row, sums) in p.data.chunks_exact_mut(p.stride).zip(product.chunks_exact(stride)).take(moving) {
            row[..moving].copy_from_slice(&sums[..moving]);
        }
        for i in moving..p.n {
            let own = if i < d { phi[i * (stride + 1)] } else { 1.0 };
            let (row, product) = (&mut p.data[i * p.stride..][..p.n], &wide[i * stride..][..moving]);
            row[..moving].iter_mut().zip(product).for_each(|(x, product)| *x = own * product);
            (moving..d).for_each(|k| row[k] = own * row[k] * phi[k * (stride + 1)]);
            if i < d {
                row[d..].iter_mut().for_each(|x| *x *= own);
                linear::add_scaled(&mut row[..d], 1.0, q.row(i));
            }
        }
        p.turn_rows(moving);
    }

    /// Φ and Q, row by row without padding.
    #[inline(always)]
    pub(super) fn remember(&self, memory: &mut Vec<f64>) {
        let d = self.dense;
        for matrix in [&self.phi, &self.noise.covariance().data] {
            for row in matrix.chunks_exact(self.stride).take(d) {
                memory.extend_from_slice(&row[..d]);
            }
        }
    }

    /// Rows of the root of Q that [`remember`](Self::remember) wrote.
    #[inline(always)]
    pub(super) fn noise_rows(&mut self, memory: &[f64], rows: &mut [f64], width: usize) {
        let (d, stride) = (self.dense, self.stride);
        for (row, values) in self.root.chunks_exact_mut(stride).zip(memory[d * d..].chunks_exact(d)) {
            row[..d].copy_from_slice(values);
        }
        // Q of a step may be singular, where a state has no noise of its own: such a row is zero.
        linear::upper_factor(&mut self.root, d, stride);
        for (out, row) in rows.chunks_exact_mut(width).zip(self.root.chunks_exact(stride)).take(d) {
            out[..d].copy_from_slice(&row[..d]);
        }
    }

    /// Columns (states × `stride`) through the step: Σ ← Φ Σ.
    #[inline(always)]
    pub(super) fn carry(&mut self, columns: &mut [f64], stride: usize) {
        let Self { dense: d, stride: own, moving, phi, carried, .. } = self;
        let (rows, through) = (*d * stride, *moving * stride);
        carried.resize(rows, 0.0);
        let (phi, diagonal) = phi.split_at(*moving * *own);
        if stride.is_multiple_of(linear::LANES) {
            linear::product(phi, *own, &columns[..rows], stride, &mut carried[..through]);
        } else {
            for (out, factors) in carried.chunks_exact_mut(stride).zip(phi.chunks_exact(*own)) {
                out.fill(0.0);
                for (factor, row) in factors.iter().zip(columns[..rows].chunks_exact(stride)) {
                    linear::add_scaled(out, *factor, row);
                }
            }
        }
        columns[..through].copy_from_slice(&carried[..through]);
        scale((diagonal.get(*moving..).unwrap_or_default(), *own), &mut columns[through..rows], stride);
    }

    /// The same in single precision, eight columns at a time.
    #[inline(always)]
    pub(super) fn carry_single(&mut self, columns: &mut [f32], stride: usize) {
        let Self { dense: d, stride: own, moving, phi, single, .. } = self;
        let (rows, through, tiles) = (*d * stride, *moving * stride, stride / SIDE);
        let (phi, diagonal) = phi.split_at(*moving * *own);
        let eights = columns[..rows].as_chunks_mut::<SIDE>().0;
        for t in 0..tiles {
            for (out, factors) in single.iter_mut().zip(phi.chunks_exact(*own)) {
                let mut sum = [0.0; SIDE];
                for (factor, row) in factors.iter().zip(eights.chunks_exact(tiles)) {
                    let factor = *factor as f32;
                    sum = core::array::from_fn(|e| sum[e] + factor * row[t][e]);
                }
                *out = sum;
            }
            for (row, out) in eights.chunks_exact_mut(tiles).zip(&*single) {
                row[t] = *out;
            }
        }
        scale((diagonal.get(*moving..).unwrap_or_default(), *own), &mut columns[through..rows], stride);
    }

    /// The adjoint of [`carry`](Self::carry) by a step that [`remember`](Self::remember) wrote: Λ ← Φᵀ Λ.
    #[inline(always)]
    pub(super) fn carry_back(&mut self, memory: &[f64], columns: &mut [f64], stride: usize) {
        let d = self.dense;
        self.carried.resize(d * stride, 0.0);
        self.carried.fill(0.0);
        for (row, column) in memory[..d * d].chunks_exact(d).zip(columns.chunks_exact(stride)) {
            for (factor, out) in row.iter().zip(self.carried.chunks_exact_mut(stride)) {
                linear::add_scaled(out, *factor, column);
            }
        }
        columns[..d * stride].copy_from_slice(&self.carried);
    }

    /// The adjoint of a step that [`remember`](Self::remember) wrote: λ ← Φᵀ λ, Λ ← Φᵀ Λ Φ.
    #[inline(always)]
    pub(super) fn retreat(&mut self, memory: &[f64], lambda: &mut [f64], big: &mut Symmetric) {
        let Self { dense: d, stride, phi, product, wide, carried, .. } = self;
        let (d, stride) = (*d, *stride);
        carried.resize(d, 0.0);
        carried.fill(0.0);
        for ((row, values), value) in phi.chunks_exact_mut(stride).zip(memory.chunks_exact(d)).zip(&*lambda).take(d) {
            row[..d].copy_from_slice(values);
            linear::add_scaled(carried, *value, values);
        }
        lambda[..d].copy_from_slice(carried);
        product.fill(0.0);
        multiply(big, (&phi[..d * stride], Part { stride, columns: d }), wide, product);
        for (row, sums) in big.data.chunks_exact_mut(big.stride).zip(product.chunks_exact(stride)).take(d) {
            row[..d].copy_from_slice(&sums[..d]);
        }
        for (row, product) in big.data.chunks_exact_mut(big.stride).zip(wide.chunks_exact(stride)).take(big.n).skip(d) {
            row[..d].copy_from_slice(&product[..d]);
        }
        big.turn_rows(d);
    }
}

/// Each row times its number on the diagonal, of a matrix with rows of `own` numbers that begins there.
#[inline(always)]
fn scale<T: Real>((diagonal, own): (&[f64], usize), rows: &mut [T], stride: usize) {
    for (row, factor) in rows.chunks_exact_mut(stride).zip(diagonal.iter().step_by(own + 1)) {
        row.iter_mut().for_each(|x| *x *= T::of(*factor));
    }
}

/// A.
#[inline(always)]
fn write(layout: &ElasticLayout, dynamics: &ElasticDynamics, stride: usize, out: &mut [f64]) {
    let (n, d) = (layout.joints, layout.dense);
    out.fill(0.0);
    let mut put = |row: usize, values: &[f64]| out[row * stride..][..d].copy_from_slice(values);
    for j in 0..n {
        put(layout.dtheta[j], &dynamics.ddtheta_by[j * d..][..d]);
        put(n + j, &dynamics.ddq_by[j * d..][..d]); // of a rigid joint in the same place
    }
    for j in 0..n {
        out[j * stride + n + j] = 1.0;
        out[layout.theta[j] * stride + layout.dtheta[j]] = 1.0;
    }
    for row in &dynamics.elements {
        row.entries.iter().for_each(|&(k, by)| out[row.state * stride + k] += by);
    }
    for i in layout.link_disturbance.iter().flat_map(|first| *first..first + n) {
        out[i * (stride + 1)] = -layout.forgetting;
    }
}

/// A times `right`, whose further rows are zero, into what [`write`] has left: velocities are copied, accelerations multiplied.
#[inline(always)]
fn apply(layout: &ElasticLayout, dynamics: &ElasticDynamics, right: &[f64], stride: usize, out: &mut [f64]) {
    let (n, d) = (layout.joints, layout.dense);
    linear::product(&dynamics.ddq_by, d, right, stride, &mut out[n * stride..]);
    out[..n * stride].copy_from_slice(&right[n * stride..2 * n * stride]);
    let row = |i: usize| i * stride..(i + 1) * stride;
    // A motor's acceleration depends on few states, unless it is coupled to all links.
    for j in (0..n).filter(|&j| layout.theta[j] >= 2 * n) {
        let own = &mut out[row(layout.dtheta[j])];
        own.fill(0.0);
        let slopes = dynamics.ddtheta_by[j * d..][..d].iter().zip(right.chunks_exact(stride));
        slopes.filter(|(by, _)| **by != 0.0).for_each(|(by, right)| linear::add_scaled(own, *by, right));
        out[row(layout.theta[j])].copy_from_slice(&right[row(layout.dtheta[j])]);
    }
    for element in &dynamics.elements {
        let own = &mut out[row(element.state)];
        own.fill(0.0);
        element.entries.iter().for_each(|&(k, by)| linear::add_scaled(own, by, &right[row(k)]));
    }
    for i in layout.link_disturbance.iter().flat_map(|first| *first..first + n).filter(|_| layout.forgetting > 0.0) {
        out[row(i)].copy_from_slice(&right[row(i)]);
        out[row(i)].iter_mut().for_each(|x| *x *= -layout.forgetting);
    }
}

/// `wide` ← M R and `sum` ← `sum` + Rᵀ M R, for that part of R's columns.
#[inline(always)]
fn multiply(m: &Symmetric, (right, part): (&[f64], Part), wide: &mut [f64], sum: &mut [f64]) {
    linear::product_part(&m.data[..m.n * m.stride], m.stride, right, part, wide);
    linear::add_symmetric_part(&wide[..right.len()], right, part, sum);
}

/// The first number of the state that nothing but noise moves.
fn first_constant(layout: &ElasticLayout) -> usize {
    let ElasticLayout { disturbance, motor_acceleration, link_disturbance, wrench, dense, .. } = *layout;
    [disturbance, motor_acceleration, link_disturbance, wrench].into_iter().flatten().min().unwrap_or(dense)
}
