//! From accelerometer readings to joint accelerations: least squares, weighted by the sensors' noise.

use crate::dynamics::Kinematics;
use crate::robot::Robot;

/// How well the sensors saw the joints at a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// Every joint acceleration is determined.
    Clear,
    /// Some combination is determined so badly that it was damped.
    Damped,
    /// Some combination is not seen at all.
    Blind,
}

/// A combination of accelerations with a hundredth of the accepted certainty counts as not seen.
const BLIND: f64 = 1e-2;

/// T_A(q) and W_A(q, q̇) of eqs. (8)–(11) in De Luca, Schröder and Thümmel (2007), and their inverse.
///
/// Rows are divided by their noise, so that a singular value σ of the map means a standard deviation of 1/σ rad/s² of
/// that combination of accelerations. Combinations with σ < ε are damped: 1/σ becomes σ/ε², which is the weighted
/// estimate with prior variance (ε² − σ²)⁻¹; it meets 1/σ at ε and vanishes at a singular posture. Good
/// combinations stay exact.
#[derive(Clone, Debug)]
pub struct AccelerationMap {
    /// 1/noise of each channel.
    weights: Vec<f64>,
    /// Which column of the map each joint has; none for a rigid joint.
    columns: Vec<Option<usize>>,
    unknowns: usize,
    /// ε.
    threshold: f64,
    /// Whitened T_A, channels × unknowns, overwritten by its triangular factor.
    map: Vec<f64>,
    /// Whitened reading less what is known.
    rhs: Vec<f64>,
    /// Square scratch: inverse of the triangle, or right singular vectors.
    square: Vec<f64>,
    solution: Vec<f64>,
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
        let channels = weights.len();
        Self {
            columns,
            unknowns,
            threshold: 1.0 / worst,
            map: vec![0.0; channels * unknowns],
            rhs: vec![0.0; channels],
            square: vec![0.0; unknowns * unknowns],
            solution: vec![0.0; unknowns],
            weights,
        }
    }

    /// Joint accelerations that explain `reading` (one a channel, NaN where missing) [m/s²].
    ///
    /// `kinematics` holds the posture and the velocities, with the accelerations of rigid joints and zero for elastic
    /// ones. `ddq` (n) holds the prior on entry, for what is not seen, and the estimate on return; entries of rigid
    /// joints are left alone.
    #[inline]
    pub fn solve(&mut self, robot: &Robot, kinematics: &Kinematics<f64>, reading: &[f64], ddq: &mut [f64]) -> Sight {
        self.load(robot, kinematics, reading, ddq);
        self.triangularise();
        let sight = if self.invert_triangle() {
            self.back_substitute();
            Sight::Clear
        } else {
            self.damped()
        };
        for (joint, column) in self.columns.iter().enumerate() {
            if let Some(c) = *column {
                ddq[joint] += self.solution[c];
            }
        }
        sight
    }

    /// Whitened map, and whitened reading less W_A and what the prior already explains.
    #[inline(always)]
    fn load(&mut self, robot: &Robot, kinematics: &Kinematics<f64>, reading: &[f64], prior: &[f64]) {
        let m = self.unknowns;
        self.map.fill(0.0);
        let mut row = 0;
        for sensor in &robot.accelerometers {
            let bias = kinematics.specific_force(&sensor.frame);
            for (r, &axis) in sensor.axes.iter().enumerate() {
                let value = reading[row + r];
                self.rhs[row + r] = if value.is_nan() { 0.0 } else { (value - bias.0[axis]) * self.weights[row + r] };
            }
            kinematics.acceleration_map(&robot.tree, &sensor.frame, |joint, column| {
                let Some(c) = self.columns[joint] else { return };
                for (r, &axis) in sensor.axes.iter().enumerate() {
                    if !reading[row + r].is_nan() {
                        let entry = column.0[axis] * self.weights[row + r];
                        self.map[(row + r) * m + c] = entry;
                        self.rhs[row + r] -= entry * prior[joint];
                    }
                }
            });
            row += sensor.axes.len();
        }
    }

    /// Householder reflections: the map becomes upper triangular, the right-hand side follows.
    #[inline(always)]
    fn triangularise(&mut self) {
        let (rows, m) = (self.rhs.len(), self.unknowns);
        for k in 0..m {
            let squared: f64 = (k..rows).map(|i| self.map[i * m + k] * self.map[i * m + k]).sum();
            if squared == 0.0 {
                continue;
            }
            let pivot = self.map[k * m + k];
            let norm = squared.sqrt().copysign(-pivot);
            // The reflection's vector is the column less norm·e_k; its own diagonal entry is kept aside.
            let head = pivot - norm;
            let scale = 1.0 / (norm * head);
            for j in k + 1..m {
                let mut dot = head * self.map[k * m + j];
                for i in k + 1..rows {
                    dot += self.map[i * m + k] * self.map[i * m + j];
                }
                let factor = dot * scale;
                self.map[k * m + j] += factor * head;
                for i in k + 1..rows {
                    self.map[i * m + j] += factor * self.map[i * m + k];
                }
            }
            let mut dot = head * self.rhs[k];
            for i in k + 1..rows {
                dot += self.map[i * m + k] * self.rhs[i];
            }
            let factor = dot * scale;
            self.rhs[k] += factor * head;
            for i in k + 1..rows {
                self.rhs[i] += factor * self.map[i * m + k];
            }
            self.map[k * m + k] = norm;
        }
    }

    /// Inverts the triangle; true when that proves every singular value to be above the threshold, σ ≥ 1/‖R⁻¹‖.
    #[inline(always)]
    fn invert_triangle(&mut self) -> bool {
        let m = self.unknowns;
        let mut squared = 0.0;
        for j in 0..m {
            let pivot = 1.0 / self.map[j * m + j];
            self.square[j * m + j] = pivot;
            squared += pivot * pivot;
            for i in (0..j).rev() {
                let mut sum = 0.0;
                for k in i + 1..=j {
                    sum += self.map[i * m + k] * self.square[k * m + j];
                }
                let entry = -sum * self.square[i * m + i];
                self.square[i * m + j] = entry;
                squared += entry * entry;
            }
        }
        squared * self.threshold * self.threshold <= 1.0
    }

    #[inline(always)]
    fn back_substitute(&mut self) {
        let m = self.unknowns;
        for i in (0..m).rev() {
            let mut sum = self.rhs[i];
            for j in i + 1..m {
                sum -= self.map[i * m + j] * self.solution[j];
            }
            self.solution[i] = sum * self.square[i * m + i];
        }
    }

    /// Singular value by singular value: one-sided Jacobi rotations turn the triangle's columns orthogonal.
    #[cold]
    fn damped(&mut self) -> Sight {
        let m = self.unknowns;
        self.square.fill(0.0);
        for i in 0..m {
            self.square[i * m + i] = 1.0;
            for j in 0..i {
                self.map[i * m + j] = 0.0; // what is left of the reflections
            }
        }
        self.rotate_to_orthogonal_columns();
        self.solution.fill(0.0);
        let mut least = f64::INFINITY;
        for c in 0..m {
            let column = |i: usize| self.map[i * m + c];
            let squared: f64 = (0..m).map(|i| column(i) * column(i)).sum();
            let along: f64 = (0..m).map(|i| column(i) * self.rhs[i]).sum();
            let floor = squared.max(self.threshold * self.threshold);
            for i in 0..m {
                self.solution[i] += self.square[i * m + c] * along / floor;
            }
            least = least.min(squared.sqrt());
        }
        if least >= self.threshold {
            Sight::Clear
        } else if least >= BLIND * self.threshold {
            Sight::Damped
        } else {
            Sight::Blind
        }
    }

    fn rotate_to_orthogonal_columns(&mut self) {
        let m = self.unknowns;
        for _sweep in 0..30 {
            let mut largest: f64 = 0.0;
            for p in 0..m {
                for q in p + 1..m {
                    let dot = |a: usize, b: usize| (0..m).map(|i| self.map[i * m + a] * self.map[i * m + b]).sum();
                    let (alpha, beta, gamma): (f64, f64, f64) = (dot(p, p), dot(q, q), dot(p, q));
                    if gamma == 0.0 || gamma * gamma <= 1e-30 * alpha * beta {
                        continue;
                    }
                    largest = largest.max(gamma * gamma / (alpha * beta));
                    let zeta = (beta - alpha) / (2.0 * gamma);
                    let tan = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                    let cos = 1.0 / tan.hypot(1.0);
                    let sin = cos * tan;
                    for matrix in [&mut self.map, &mut self.square] {
                        for i in 0..m {
                            let (a, b) = (matrix[i * m + p], matrix[i * m + q]);
                            matrix[i * m + p] = cos * a - sin * b;
                            matrix[i * m + q] = sin * a + cos * b;
                        }
                    }
                }
            }
            if largest < 1e-28 {
                return;
            }
        }
    }
}
