//! From accelerometer readings to joint accelerations: least squares, weighted by the sensors' noise.
//!
//! Readings are a = T_A(q) q̈ + W_A(q, q̇). Householder reflections bring the whitened T_A to a triangle R; where the smallest singular value of
//! R is large enough, which its inverse tells without computing it, q̈ is solved from R, else singular vectors say which
//! combinations are to be damped.

use crate::dynamics::Kinematics;
use crate::linear::{LANES, add_scaled, dot};
use crate::robot::Robot;

/// How well the sensors saw the joints at a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observability {
    /// Every joint acceleration is determined.
    Full,
    /// Some combination is determined so badly that it was damped.
    Damped,
    /// Some combination is not seen at all.
    Unobservable,
}

/// A combination of accelerations with a hundredth of the accepted certainty counts as not seen.
const UNOBSERVABLE: f64 = 1e-2;

/// T_A(q) and W_A(q, q̇) of eqs. (8)–(11) in De Luca, Schröder and Thümmel (2007), and their inverse.
///
/// Rows are divided by their noise, so that a singular value σ of the map means a standard deviation of 1/σ rad/s² of
/// that combination of accelerations. Combinations with σ < ε are damped: 1/σ becomes σ/ε², which is the weighted
/// estimate with prior variance (ε² − σ²)⁻¹; it meets 1/σ at ε and vanishes at a singular posture. Good
/// combinations stay exact.
///
/// ```
/// use linkside_core::dynamics::Kinematics;
/// use linkside_core::estimate::observer::{AccelerationMap, Observability};
///
/// let robot = linkside_core::demo::arm()?;
/// let mut kinematics = Kinematics::new(&robot.tree);
/// kinematics.set_motion(&robot.tree, &[0.0], &[2.0], &[0.0]);
/// // At the tip, a metre out: 3 rad/s² are 3 m/s² across, 2 rad/s pull 4 m/s² inwards, and gravity is there as well.
/// let mut ddq = [0.0];
/// let found = AccelerationMap::new(&robot, 10.0).solve(&robot, &kinematics, &[-4.0, 3.0, 9.81], &mut ddq);
/// assert!(found == Observability::Full && (ddq[0] - 3.0).abs() < 1e-12);
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug)]
pub struct AccelerationMap {
    /// 1/noise of each channel.
    weights: Vec<f64>,
    /// Which column of the map each joint has; none for a rigid joint.
    columns: Vec<Option<usize>>,
    /// Elastic joints, whose accelerations are looked for.
    unknowns: usize,
    /// ε.
    threshold: f64,
    /// Rows of a column, padded.
    stride: usize,
    /// Columns of the whitened T_A, overwritten by its triangular factor, and last the whitened reading less what is
    /// known.
    map: Vec<f64>,
    /// A column's part in the triangle, while it is a reflection.
    above: Vec<f64>,
    /// Square scratch: inverse of the triangle, by rows, or right singular vectors.
    square: Vec<f64>,
    /// What the prior lacks of q̈ (unknowns).
    solution: Vec<f64>,
    /// Whether the last solution was damped.
    damped: bool,
}

impl AccelerationMap {
    /// For the elastic joints of `robot`; combinations whose standard deviation exceeds `worst` [rad/s²] are damped.
    pub fn new(robot: &Robot, worst: f64) -> Self {
        let sensors = &robot.accelerometers;
        let weights: Vec<f64> = sensors.iter().flat_map(|s| vec![1.0 / s.noise_std; s.axes.len()]).collect();
        let mut unknowns = 0;
        let mut number = |elastic: bool| {
            unknowns += usize::from(elastic);
            elastic.then(|| unknowns - 1)
        };
        let columns = robot.drives.iter().map(|d| number(d.elastic)).collect();
        // Fewer channels than unknowns leave rows of zeros, and directions that are not seen.
        let stride = weights.len().max(unknowns).next_multiple_of(LANES);
        Self {
            columns,
            unknowns,
            threshold: 1.0 / worst,
            stride,
            map: vec![0.0; (unknowns + 1) * stride],
            above: vec![0.0; unknowns],
            square: vec![0.0; unknowns * unknowns],
            solution: vec![0.0; unknowns],
            damped: false,
            weights,
        }
    }

    /// Joint accelerations that explain `reading` (one a channel, NaN where missing) [m/s²].
    ///
    /// `kinematics` holds the posture and the velocities, with the accelerations of rigid joints and zero for elastic
    /// ones. `ddq` (n) holds the prior on entry, for what is not seen, and the estimate on return; entries of rigid
    /// joints are left alone.
    #[inline(always)]
    pub fn solve(
        &mut self,
        robot: &Robot,
        kinematics: &Kinematics<f64>,
        reading: &[f64],
        ddq: &mut [f64],
    ) -> Observability {
        self.load(robot, kinematics, reading, ddq);
        let observability = self.invert();
        for (joint, column) in self.columns.iter().enumerate() {
            if let Some(c) = *column {
                ddq[joint] += self.solution[c];
            }
        }
        observability
    }

    /// The damped inverse itself at `q`, at rest (n × channels, row-major): by how much q̈ of each joint grows with each
    /// reading; zero for rigid joints. For who analyses a loop; [`solve`](Self::solve) never forms it.
    pub fn inverse(robot: &Robot, q: &[f64], worst: f64) -> Vec<f64> {
        let (n, channels) = (robot.len(), robot.acceleration_channels());
        let (mut map, mut kinematics, rest) = (Self::new(robot, worst), Kinematics::new(&robot.tree), vec![0.0; n]);
        kinematics.set(&robot.tree, q, &rest, &rest);
        let mut out = vec![0.0; n * channels];
        for channel in 0..channels {
            // One unit more than nothing in this reading; the others do not move.
            map.load(robot, &kinematics, &vec![0.0; channels], &rest);
            let rhs = &mut map.map[map.unknowns * map.stride..];
            rhs.fill(0.0);
            rhs[channel] = map.weights[channel];
            map.invert();
            for (joint, column) in map.columns.iter().enumerate() {
                out[joint * channels + channel] = column.map_or(0.0, |c| map.solution[c]);
            }
        }
        out
    }

    /// The solution of what is loaded: exactly where that is safe, else damped.
    #[inline(always)]
    fn invert(&mut self) -> Observability {
        self.triangularise();
        self.damped = !self.invert_triangle();
        if !self.damped {
            self.back_substitute();
            Observability::Full
        } else {
            self.solve_damped()
        }
    }

    /// Which unknown the acceleration of a joint is; none of a rigid one.
    #[inline(always)]
    pub(super) fn column(&self, joint: usize) -> Option<usize> {
        self.columns[joint]
    }

    /// C of the last solution, which is C Tᵀ of the whitened reading (unknowns²), and into `open` the variance of each unknown
    /// that damping left open.
    ///
    /// C = R⁻¹R⁻ᵀ, or of singular vectors v with σ < ε the sum of v vᵀ/ε². The prior's variance of such a combination is
    /// (ε² − σ²)⁻¹, of which (1 − σ²/ε²)² stays.
    #[inline(always)]
    pub(super) fn covariance_into(&self, out: &mut [f64], open: &mut [f64]) {
        let (m, stride, square) = (self.unknowns, self.stride, &self.square);
        open.fill(0.0);
        if !self.damped {
            for i in 0..m {
                for j in i..m {
                    // Upper triangular: row i begins with its diagonal.
                    let sum = dot(&square[i * m + j..][..m - j], &square[j * m + j..][..m - j]);
                    (out[i * m + j], out[j * m + i]) = (sum, sum);
                }
            }
            return;
        }
        out.fill(0.0);
        let least = self.threshold * self.threshold;
        for (column, vector) in self.map.chunks_exact(stride).zip(square.chunks_exact(m)) {
            let squared = dot(column, column);
            for (i, x) in vector.iter().enumerate() {
                add_scaled(&mut out[i * m..][..m], x / squared.max(least), vector);
                open[i] += x * x * (least - squared).max(0.0) / (least * least);
            }
        }
    }

    /// Whitened map, and whitened reading less W_A and what the prior already explains.
    #[inline(always)]
    fn load(&mut self, robot: &Robot, kinematics: &Kinematics<f64>, reading: &[f64], prior: &[f64]) {
        let stride = self.stride;
        self.map.fill(0.0);
        let (columns, rhs) = self.map.split_at_mut(self.unknowns * stride);
        let mut row = 0;
        for sensor in &robot.accelerometers {
            let bias = kinematics.specific_force(&sensor.frame);
            for (r, &axis) in (row..).zip(&sensor.axes) {
                rhs[r] = if reading[r].is_nan() { 0.0 } else { (reading[r] - bias.0[axis]) * self.weights[r] };
            }
            kinematics.acceleration_map(&robot.tree, &sensor.frame, |joint, column| {
                let Some(c) = self.columns[joint] else { return };
                // A missing axis is a row of zeros: it says nothing, and its neighbours go on.
                for (r, &axis) in (row..).zip(&sensor.axes) {
                    if !reading[r].is_nan() {
                        let entry = column.0[axis] * self.weights[r];
                        columns[c * stride + r] = entry;
                        rhs[r] -= entry * prior[joint];
                    }
                }
            });
            row += sensor.axes.len();
        }
    }

    /// Householder reflections: the map becomes upper triangular, the right-hand side, its last column, follows.
    #[inline(always)]
    fn triangularise(&mut self) {
        let stride = self.stride;
        for k in 0..self.unknowns {
            let (head, rest) = self.map.split_at_mut((k + 1) * stride);
            let column = &mut head[k * stride..];
            // What is above the diagonal belongs to the triangle, and not to the reflection.
            self.above[..k].copy_from_slice(&column[..k]);
            column[..k].fill(0.0);
            let squared = dot(column, column);
            if squared > 0.0 {
                let pivot = column[k];
                let norm = squared.sqrt().copysign(-pivot);
                column[k] = pivot - norm;
                let scale = 1.0 / (norm * column[k]);
                for other in rest.chunks_exact_mut(stride) {
                    add_scaled(other, dot(column, other) * scale, column);
                }
                column[k] = norm;
            }
            column[..k].copy_from_slice(&self.above[..k]);
        }
    }

    /// Inverts the triangle; true when that proves every singular value to be above the threshold, σ ≥ 1/‖R⁻¹‖.
    #[inline(always)]
    fn invert_triangle(&mut self) -> bool {
        let (m, stride) = (self.unknowns, self.stride);
        let mut squared = 0.0;
        for j in 0..m {
            let pivot = 1.0 / self.map[j * stride + j];
            self.square[j * m + j] = pivot;
            squared += pivot * pivot;
            for i in (0..j).rev() {
                let mut sum = 0.0;
                for k in i + 1..=j {
                    sum += self.map[k * stride + i] * self.square[k * m + j];
                }
                let entry = -sum * self.square[i * m + i];
                self.square[i * m + j] = entry;
                squared += entry * entry;
            }
        }
        // The cheap proof, good in nearly all samples; singular values are computed only where it fails.
        squared * self.threshold * self.threshold <= 1.0
    }

    /// R⁻¹ Qᵀ b, with the inverse that proved that nothing is damped.
    #[inline(always)]
    fn back_substitute(&mut self) {
        let (m, rhs) = (self.unknowns, self.unknowns * self.stride);
        for i in 0..m {
            self.solution[i] = (i..m).map(|j| self.square[i * m + j] * self.map[rhs + j]).sum();
        }
    }

    /// Singular value by singular value: one-sided Jacobi rotations turn the triangle's columns orthogonal.
    #[cold]
    fn solve_damped(&mut self) -> Observability {
        let (m, stride) = (self.unknowns, self.stride);
        self.square.fill(0.0);
        for c in 0..m {
            self.square[c * m + c] = 1.0;
            self.map[c * stride + c + 1..][..stride - c - 1].fill(0.0); // what is left of the reflections
        }
        self.rotate_to_orthogonal_columns();
        self.solution.fill(0.0);
        let (columns, rhs) = self.map.split_at(m * stride);
        let mut least = f64::INFINITY;
        for (c, column) in columns.chunks_exact(stride).enumerate() {
            // Rows of the right-hand side beyond the triangle are what no acceleration explains.
            let (squared, along) = (dot(column, column), dot(&column[..m], &rhs[..m]));
            // σ ≥ ε: the least-squares solution; below, σ/ε² in place of 1/σ.
            let floor = squared.max(self.threshold * self.threshold);
            add_scaled(&mut self.solution, along / floor, &self.square[c * m..][..m]);
            least = least.min(squared.sqrt());
        }
        if least >= self.threshold {
            Observability::Full
        } else if least >= UNOBSERVABLE * self.threshold {
            Observability::Damped
        } else {
            Observability::Unobservable
        }
    }

    /// Turns pairs of columns, of the map and of the right singular vectors alike, until no two share a direction.
    fn rotate_to_orthogonal_columns(&mut self) {
        let (m, stride) = (self.unknowns, self.stride);
        for _sweep in 0..30 {
            let mut largest: f64 = 0.0;
            for p in 0..m {
                for q in p + 1..m {
                    let (a, b) = (&self.map[p * stride..][..stride], &self.map[q * stride..][..stride]);
                    let (alpha, beta, gamma) = (dot(a, a), dot(b, b), dot(a, b));
                    if gamma == 0.0 || gamma * gamma <= 1e-30 * alpha * beta {
                        continue;
                    }
                    largest = largest.max(gamma * gamma / (alpha * beta));
                    let zeta = (beta - alpha) / (2.0 * gamma);
                    // The smaller of the two rotations that make the columns orthogonal (Golub and Van Loan 2013,
                    // section 8.6).
                    let tan = zeta.signum() / (zeta.abs() + (zeta * zeta + 1.0).sqrt());
                    rotate(&mut self.map, stride, p, q, tan);
                    rotate(&mut self.square, m, p, q, tan);
                }
            }
            if largest < 1e-28 {
                return;
            }
        }
    }
}

/// Turns columns p < q of `width` numbers by the angle whose tangent is `tan`.
fn rotate(matrix: &mut [f64], width: usize, p: usize, q: usize, tan: f64) {
    let cos = 1.0 / (tan * tan + 1.0).sqrt();
    let sin = cos * tan;
    let (head, tail) = matrix.split_at_mut(q * width);
    for (a, b) in head[p * width..][..width].iter_mut().zip(&mut tail[..width]) {
        (*a, *b) = (cos * *a - sin * *b, sin * *a + cos * *b);
    }
}
