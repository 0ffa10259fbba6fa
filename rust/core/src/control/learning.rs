//! Iterative learning control: from the errors of one repeat of a motion to the input of the next.
//!
//! Gunnarsson and Norrlöf, "On the design of ILC algorithms using optimization", Automatica 37, 2001: the next input
//! minimises ‖e‖² + ‖v‖² + ‖v − v_j‖², each with its weight, for a model e_{j+1} = e_j − G (v − v_j). The lifted matrix G
//! is never formed: the change of v is the disturbance that a linear smoother finds from e, by a filter's pass and an
//! adjoint one back, in time proportional to the length of the motion.

use crate::check::{expect_each, expect_finite, expect_length};
use crate::error::{DesignError, RunError};
use crate::interrupt::Watch;
use crate::linear::{add_scaled, dot, factorise, solve};

/// Part of the largest eigenvalue of MᵀM that may be left open.
const CLOSE: f64 = 1e-4;
/// Most applications of MᵀM.
const MOST: usize = 60;

/// G: how outputs answer inputs, x₊ = A x + B v and y = C x from x = 0, with A of the posture that each sample has.
///
/// ```
/// use linkside_core::control::{LearningLoop, LearningStep};
///
/// // A lag of first order, and a repeat that was 1 mm off throughout.
/// let model = LearningLoop::new(vec![0.9], vec![0; 50], vec![0.1], vec![1.0], 1)?;
/// let step = LearningStep::new(model.clone(), vec![1.0; 50], vec![1e-6], vec![1e-6])?;
/// let v = step.solve(&[1e-3; 50], &[0.0; 50])?;
/// let error: Vec<f64> = model.answer(&v)?.iter().map(|y| 1e-3 - y).collect();
/// assert!(error[1..].iter().all(|e| e.abs() < 1e-5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct LearningLoop {
    /// A about each posture (postures × s × s), and the posture of each sample.
    transition: Vec<f64>,
    posture: Vec<usize>,
    /// Bᵀ and C (n × s).
    entry: Vec<f64>,
    output: Vec<f64>,
    n: usize,
    s: usize,
}

impl LearningLoop {
    /// Of `n` inputs and outputs, with B (s × n) and C (n × s).
    ///
    /// # Errors
    /// Lengths that do not belong together, numbers that are not finite, a posture that is none.
    pub fn new(
        transition: Vec<f64>,
        posture: Vec<usize>,
        entry: Vec<f64>,
        output: Vec<f64>,
        n: usize,
    ) -> Result<Self, DesignError> {
        let s = output.len() / n.max(1);
        let postures = transition.len() / (s * s).max(1);
        expect_length("output", output.len(), n * s)?;
        expect_length("entry", entry.len(), s * n)?;
        expect_length("transition", transition.len(), postures * s * s)?;
        for (what, values) in [("transition", &transition), ("entry", &entry), ("output", &output)] {
            expect_finite(what, values)?;
        }
        if let Some(&beyond) = posture.iter().find(|&&p| p >= postures) {
            return Err(DesignError::Range { what: "posture", value: beyond as f64, expected: "one that is there" });
        }
        let entry = (0..n).flat_map(|j| (0..s).map(move |i| (i, j))).map(|(i, j)| entry[i * n + j]).collect();
        Ok(Self { transition, posture, entry, output, n, s })
    }

    /// Samples.
    fn len(&self) -> usize {
        self.posture.len()
    }

    /// A at a sample.
    fn transition(&self, sample: usize) -> &[f64] {
        &self.transition[self.posture[sample] * self.s * self.s..][..self.s * self.s]
    }

    /// `out = A x` at a sample, plus B v.
    fn advance(&self, sample: usize, x: &[f64], v: &[f64], out: &mut [f64]) {
        for (out, row) in out.iter_mut().zip(self.transition(sample).chunks_exact(self.s)) {
            *out = dot(row, x);
        }
        for (v, column) in v.iter().zip(self.entry.chunks_exact(self.s)) {
            add_scaled(out, *v, column);
        }
    }

    /// `out = Aᵀ r` at a sample.
    fn back(&self, sample: usize, r: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for (r, row) in r.iter().zip(self.transition(sample).chunks_exact(self.s)) {
            add_scaled(out, *r, row);
        }
    }

    /// G v (samples × n).
    ///
    /// # Errors
    /// A wrong length; a request to stop.
    pub fn answer(&self, v: &[f64]) -> Result<Vec<f64>, RunError> {
        expect_length("v", v.len(), self.len() * self.n)?;
        let (mut x, mut next) = (vec![0.0; self.s], vec![0.0; self.s]);
        let mut y = Vec::with_capacity(v.len());
        let watch = Watch::current();
        for (i, v) in v.chunks_exact(self.n).enumerate() {
            stop(&watch, i)?;
            y.extend(self.output.chunks_exact(self.s).map(|row| dot(row, &x)));
            self.advance(i, &x, v, &mut next);
            core::mem::swap(&mut x, &mut next);
        }
        Ok(y)
    }

    /// Gᵀ e (samples × n).
    ///
    /// # Errors
    /// A wrong length; a request to stop.
    pub fn adjoint(&self, e: &[f64]) -> Result<Vec<f64>, RunError> {
        expect_length("e", e.len(), self.len() * self.n)?;
        let (mut r, mut next) = (vec![0.0; self.s], vec![0.0; self.s]);
        let mut v = vec![0.0; e.len()];
        let watch = Watch::current();
        for (i, e) in e.chunks_exact(self.n).enumerate().rev() {
            stop(&watch, i)?;
            for (v, column) in v[i * self.n..].iter_mut().zip(self.entry.chunks_exact(self.s)) {
                *v = dot(column, &r);
            }
            self.back(i, &r, &mut next);
            core::mem::swap(&mut r, &mut next);
            for (e, row) in e.iter().zip(self.output.chunks_exact(self.s)) {
                add_scaled(&mut r, *e, row);
            }
        }
        Ok(v)
    }
}

/// The step for weights W of errors, ρ of inputs and λ of their change: gains that do not depend on what was recorded.
///
/// x₊ = A x + B Δv, Δv ~ N(·, 1/(ρ + λ)), seen through e = C x + N(0, W⁻¹).
#[derive(Clone, Debug)]
pub struct LearningStep {
    model: LearningLoop,
    /// W (samples × n).
    weight: Vec<f64>,
    /// λ, and 1/(ρ + λ) (n).
    change: Vec<f64>,
    variance: Vec<f64>,
    /// Kᵀ, gains of innovations (samples × n × s), and (C P Cᵀ + W⁻¹)⁻¹ (samples × n × n).
    gains: Vec<f64>,
    inverses: Vec<f64>,
}

impl LearningStep {
    /// Runs the covariance along the motion, for `weight` (samples × n), ρ and λ (n).
    ///
    /// # Errors
    /// Wrong lengths; weights below 0; ρ and λ that are not positive together; a request to stop.
    pub fn new(model: LearningLoop, weight: Vec<f64>, roughness: Vec<f64>, change: Vec<f64>) -> Result<Self, RunError> {
        let (n, s, count) = (model.n, model.s, model.len());
        expect_length("weight", weight.len(), count * n)?;
        expect_each("weight", &weight, |w| w.is_finite() && w >= 0.0, "weights of at least 0")?;
        expect_length("roughness", roughness.len(), n)?;
        expect_length("change", change.len(), n)?;
        expect_each("change", &change, |w| w.is_finite() && w >= 0.0, "weights of at least 0")?;
        expect_each("roughness", &roughness, |w| w.is_finite() && w > 0.0, "weights greater than 0")?;
        let variance: Vec<f64> = roughness.iter().zip(&change).map(|(rho, lambda)| 1.0 / (rho + lambda)).collect();
        let mut gains = vec![0.0; count * n * s];
        let mut inverses = vec![0.0; count * n * n];
        let [mut p, mut product] = core::array::from_fn(|_| vec![0.0; s * s]);
        let mut seen = vec![0.0; n * s];
        let mut joint = vec![0.0; n * n];
        let watch = Watch::current();
        for i in 0..count {
            stop(&watch, i)?;
            // 1. C P, and (C P Cᵀ + W⁻¹)⁻¹ as √W (1 + √W C P Cᵀ √W)⁻¹ √W, which stands a weight of zero.
            for (seen, row) in seen.chunks_exact_mut(s).zip(model.output.chunks_exact(s)) {
                for (seen, p) in seen.iter_mut().zip(p.chunks_exact(s)) {
                    *seen = dot(row, p);
                }
            }
            let weight = &weight[i * n..][..n];
            let inverse = &mut inverses[i * n * n..][..n * n];
            for a in 0..n {
                for b in 0..n {
                    let root = (weight[a] * weight[b]).sqrt();
                    let share = root * dot(&model.output[a * s..][..s], &seen[b * s..][..s]);
                    joint[a * n + b] = share + f64::from(a == b);
                    inverse[a * n + b] = if a == b { weight[a].sqrt() } else { 0.0 };
                }
            }
            factorise(&mut joint, n);
            solve(&joint, n, inverse, n);
            for (row, weight) in inverse.chunks_exact_mut(n).zip(weight) {
                row.iter_mut().for_each(|x| *x *= weight.sqrt());
            }
            // 2. The gain, and P ← P − K C P.
            let gain = &mut gains[i * n * s..][..n * s];
            for (gain, row) in gain.chunks_exact_mut(s).zip(inverse.chunks_exact(n)) {
                for (x, seen) in row.iter().zip(seen.chunks_exact(s)) {
                    add_scaled(gain, *x, seen);
                }
            }
            for (gain, seen) in gain.chunks_exact(s).zip(seen.chunks_exact(s)) {
                for (p, g) in p.chunks_exact_mut(s).zip(gain) {
                    add_scaled(p, -g, seen);
                }
            }
            // 3. P ← A P Aᵀ + B Bᵀ/(ρ + λ), symmetric to the last bit.
            let a = model.transition(i);
            product.fill(0.0);
            for (product, row) in product.chunks_exact_mut(s).zip(a.chunks_exact(s)) {
                for (x, p) in row.iter().zip(p.chunks_exact(s)) {
                    add_scaled(product, *x, p);
                }
            }
            for r in 0..s {
                for c in 0..=r {
                    let mut value = dot(&product[r * s..][..s], &a[c * s..][..s]);
                    for (entry, variance) in model.entry.chunks_exact(s).zip(&variance) {
                        value += entry[r] * entry[c] * variance;
                    }
                    (p[r * s + c], p[c * s + r]) = (value, value);
                }
            }
        }
        Ok(Self { model, weight, change, variance, gains, inverses })
    }

    /// The Δv (samples × n) that makes ‖e − G Δv‖² + ‖Δv − mean‖² smallest, in the norms of W and ρ + λ.
    ///
    /// # Errors
    /// Wrong lengths; a request to stop.
    pub fn solve(&self, e: &[f64], mean: &[f64]) -> Result<Vec<f64>, RunError> {
        let Self { model, variance, gains, inverses, .. } = self;
        let (n, s) = (model.n, model.s);
        expect_length("e", e.len(), model.len() * n)?;
        expect_length("mean", mean.len(), model.len() * n)?;
        let [mut x, mut next] = core::array::from_fn(|_| vec![0.0; s]);
        let mut innovations = e.to_vec();
        let watch = Watch::current();
        for (i, innovation) in innovations.chunks_exact_mut(n).enumerate() {
            stop(&watch, i)?;
            for (innovation, row) in innovation.iter_mut().zip(model.output.chunks_exact(s)) {
                *innovation -= dot(row, &x);
            }
            for (innovation, gain) in innovation.iter().zip(gains[i * n * s..].chunks_exact(s)) {
                add_scaled(&mut x, *innovation, gain);
            }
            model.advance(i, &x, &mean[i * n..][..n], &mut next);
            core::mem::swap(&mut x, &mut next);
        }
        // Back: what the innovations from a sample on say of the state before it.
        let (mut r, mut found) = (vec![0.0; s], mean.to_vec());
        for (i, found) in found.chunks_exact_mut(n).enumerate().rev() {
            stop(&watch, i)?;
            for ((found, column), variance) in found.iter_mut().zip(model.entry.chunks_exact(s)).zip(variance) {
                *found += variance * dot(column, &r);
            }
            model.back(i, &r, &mut next);
            core::mem::swap(&mut r, &mut next);
            let (gain, inverse) = (&gains[i * n * s..][..n * s], &inverses[i * n * n..][..n * n]);
            let innovation = &innovations[i * n..][..n];
            next.copy_from_slice(&r);
            for ((row, gain), output) in
                inverse.chunks_exact(n).zip(gain.chunks_exact(s)).zip(model.output.chunks_exact(s))
            {
                add_scaled(&mut next, dot(row, innovation) - dot(gain, &r), output);
            }
            core::mem::swap(&mut r, &mut next);
        }
        Ok(found)
    }

    /// ‖M‖₂, the factor by which a repeat brings v at least nearer to its limit on a robot whose G₀ is `real`, by the
    /// iteration of Lanczos (1950) on MᵀM from `start` (samples × n), with what that leaves open added.
    ///
    /// M = (GᵀWG + ρ + λ)⁻¹ (λ + GᵀW(G − G₀)), in the norm that ρ + λ gives.
    ///
    /// # Errors
    /// Wrong lengths; a request to stop.
    pub fn contraction(&self, real: &LearningLoop, start: &[f64]) -> Result<f64, RunError> {
        expect_length("start", start.len(), self.model.len() * self.model.n)?;
        let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let (mut basis, mut next, mut beta) = (Vec::<Vec<f64>>::new(), start.to_vec(), norm(start));
        // MᵀM in the basis, three diagonals.
        let (mut diagonal, mut beside) = (vec![], vec![]);
        let (mut largest, mut open) = (0.0, 0.0);
        while basis.len() < MOST.min(start.len()) && beta > f64::MIN_POSITIVE {
            next.iter_mut().for_each(|x| *x /= beta);
            let mut image = self.squared(real, next.clone())?;
            diagonal.push(next.iter().zip(&image).map(|(a, b)| a * b).sum::<f64>());
            basis.push(next);
            for _ in 0..2 {
                for v in &basis {
                    let along: f64 = v.iter().zip(&image).map(|(a, b)| a * b).sum();
                    add_scaled(&mut image, -along, v);
                }
            }
            (beta, next) = (norm(&image), image);
            let k = diagonal.len();
            let tridiagonal = nalgebra::DMatrix::from_fn(k, k, |i, j| match i.abs_diff(j) {
                0 => diagonal[i],
                1 => beside[i.min(j)],
                _ => 0.0,
            });
            let eigen = tridiagonal.symmetric_eigen();
            let top = eigen.eigenvalues.imax();
            // An eigenvalue is no further from this one than its residual.
            (largest, open) = (eigen.eigenvalues[top].max(0.0), beta * eigen.eigenvectors[(k - 1, top)].abs());
            if open <= CLOSE * largest {
                break;
            }
            beside.push(beta);
        }
        Ok((largest + open).sqrt())
    }

    /// MᵀM v, in the norm that ρ + λ gives.
    fn squared(&self, real: &LearningLoop, mut v: Vec<f64>) -> Result<Vec<f64>, RunError> {
        self.scale(&mut v, |variance| variance.sqrt());
        let mut moved = self.multiplied(real, &v)?;
        self.scale(&mut moved, |variance| 1.0 / variance);
        let mut turned = self.turned(real, &moved)?;
        self.scale(&mut turned, |variance| variance.sqrt());
        Ok(turned)
    }

    /// M v.
    fn multiplied(&self, real: &LearningLoop, v: &[f64]) -> Result<Vec<f64>, RunError> {
        let mut differs = self.model.answer(v)?;
        add_scaled(&mut differs, -1.0, &real.answer(v)?);
        let mut mean = v.to_vec();
        self.scale(&mut mean, |variance| variance);
        for (mean, change) in mean.iter_mut().zip(self.change.iter().cycle()) {
            *mean *= change;
        }
        self.solve(&differs, &mean)
    }

    /// Mᵀ v.
    fn turned(&self, real: &LearningLoop, v: &[f64]) -> Result<Vec<f64>, RunError> {
        let mut mean = v.to_vec();
        self.scale(&mut mean, |variance| variance);
        let mut solved = self.solve(&vec![0.0; v.len()], &mean)?;
        let mut weighted = self.model.answer(&solved)?;
        weighted.iter_mut().zip(&self.weight).for_each(|(x, w)| *x *= w);
        solved.iter_mut().zip(self.change.iter().cycle()).for_each(|(x, change)| *x *= change);
        add_scaled(&mut solved, 1.0, &self.model.adjoint(&weighted)?);
        add_scaled(&mut solved, -1.0, &real.adjoint(&weighted)?);
        Ok(solved)
    }

    /// Each input's numbers times what its variance gives.
    fn scale(&self, v: &mut [f64], by: impl Fn(f64) -> f64) {
        for (v, variance) in v.iter_mut().zip(self.variance.iter().cycle()) {
            *v *= by(*variance);
        }
    }
}

/// # Errors
/// A request to stop.
fn stop(watch: &Watch, sample: usize) -> Result<(), RunError> {
    if watch.stops() { Err(RunError::Interrupted { sample }) } else { Ok(()) }
}
