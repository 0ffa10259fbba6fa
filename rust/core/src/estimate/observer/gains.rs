//! One joint's linear model, and the observer's gains in closed form.

use super::poles::Poles;
use crate::robot::Drive;
use nalgebra::{DMatrix, DVector};

/// The linear model of one joint that an observer runs on. The measurement is always the first state, θ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointModel {
    /// State (θ, q, θ̇, q̇), driven by torque and link acceleration (eqs. (4)–(5)).
    Elastic,
    /// The same and a slowly varying bias b of the measured link acceleration: q̈ = measured − b.
    ElasticWithBias,
    /// The link follows the motor: state (θ, θ̇, θ̈), with no input.
    Rigid,
}

impl JointModel {
    /// Number of states, and so of poles.
    pub fn order(self) -> usize {
        match self {
            Self::Elastic => 4,
            Self::ElasticWithBias => 5,
            Self::Rigid => 3,
        }
    }

    /// Continuous-time A (order × order) and inputs (order × 2: torque, then link acceleration).
    /// The motor's viscous friction is part of A.
    pub(super) fn matrices(self, drive: &Drive) -> (DMatrix<f64>, DMatrix<f64>) {
        let n = self.order();
        let (mut a, mut input) = (DMatrix::zeros(n, n), DMatrix::zeros(n, 2));
        if self == Self::Rigid {
            (a[(0, 1)], a[(1, 2)]) = (1.0, 1.0);
            return (a, input);
        }
        let Drive { stiffness, damping, motor_inertia, motor_friction, .. } = drive;
        let row = [-stiffness, *stiffness, -(damping + motor_friction.viscous), *damping];
        (a[(0, 2)], a[(1, 3)]) = (1.0, 1.0);
        for (j, entry) in row.iter().enumerate() {
            a[(2, j)] = entry / motor_inertia;
        }
        (input[(2, 0)], input[(3, 1)]) = (1.0 / motor_inertia, 1.0);
        if self == Self::ElasticWithBias {
            a[(3, 4)] = -1.0;
        }
        (a, input)
    }
}

/// Continuous-time observer gains L (order) that give one joint's error dynamics the `poles`.
///
/// De Luca, Schröder and Thümmel (2007), Remark 3, here with the motor's viscous friction in the model and, for
/// [`JointModel::ElasticWithBias`], a fifth pole: with a bias state the gain L₄ of the characteristic polynomial
/// becomes L₄ − L₅/λ. `poles` must have been made for `model.order()` poles.
///
/// ```
/// use linkside_core::estimate::observer::{closed_form_gains, Complex, JointModel, Poles};
/// use linkside_core::robot::Drive;
/// let drive = Drive::spring(1.2e5, 60.0, 30.0);
/// let pair = |zeta: f64| [1.0, -1.0].map(|s| 250.0 * Complex::new(-zeta, s * (1.0 - zeta * zeta).sqrt()));
/// let poles = Poles::new(0, &[pair(0.9), pair(0.75)].concat(), 4)?;
/// let gains = closed_form_gains(JointModel::Elastic, &drive, &poles);
/// assert!((gains[1] - 12402.34375).abs() < 1e-6);
/// # Ok::<(), linkside_core::error::DesignError>(())
/// ```
pub fn closed_form_gains(model: JointModel, drive: &Drive, poles: &Poles) -> DVector<f64> {
    let c = poles.polynomial();
    if model == JointModel::Rigid {
        return DVector::from_vec(vec![c[2], c[1], c[0]]);
    }
    let Drive { stiffness: k, damping: d, motor_inertia: b, motor_friction, .. } = drive;
    let drag = (d + motor_friction.viscous) / b;
    let top = c.len() - 1;
    let l1 = c[top - 1] - drag;
    let l3 = c[top - 2] - drag * l1 - k / b;
    let l5 = if top == 5 { -b / k * c[0] } else { 0.0 };
    let l4 = b / k * c[top - 4] + d / k * l5;
    let l2 = b / k * c[top - 3] - d / k * l4;
    let mut gains = vec![l1, l2, l3, l4];
    gains.extend((top == 5).then_some(l5));
    DVector::from_vec(gains)
}
