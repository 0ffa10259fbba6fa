//! How far off an observer can get by what is bounded: the ultimate bound of its error, from its gains.

use super::gains::JointModel;
use super::poles::Poles;
use super::sampled::Sampled;
use super::settings::Form;
use crate::robot::Drive;
use nalgebra::{DMatrix, DVector, RowDVector};

/// Pieces of a period in which a torque may change as it likes.
const PIECES: usize = 32;
/// Part of an error after which nothing more is to be expected of it.
const OVER: f64 = 1e-13;
/// More samples than any error lasts.
const LONGEST: usize = 10_000_000;

/// What one joint's position and velocity can be off by at most, for a unit of what each is disturbed by.
///
/// The error is a linear system, so that its largest peak under a disturbance of size one, whatever its course, is the sum of its impulse
/// response without signs, the L₁ norm (Dahleh and Pearson 1987). It holds once the start has decayed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UltimateBound {
    /// Link position and velocity by a torque on the motor that the model lacks, at any time [rad/(N m), rad/s/(N m)].
    pub torque: [f64; 2],
    /// By an error of the measured acceleration at each sample [s², s].
    pub acceleration: [f64; 2],
    /// By an error of the motor position at each sample [1, 1/s].
    pub reading: [f64; 2],
}

impl UltimateBound {
    /// Of the observer that [`Sampled::new`] makes of the same, as `form` reports it.
    ///
    /// ```
    /// use linkside_core::estimate::observer::{Complex, Form, JointModel, Poles, UltimateBound};
    /// use linkside_core::robot::Drive;
    /// let drive = Drive::spring(1.2e5, 60.0, 30.0);
    /// let pole = |re: f64| Complex::new(re, 0.0);
    /// let poles = Poles::new(0, &[pole(-200.0), pole(-220.0), pole(-240.0), pole(-260.0)], 4)?;
    /// let bound = UltimateBound::new(JointModel::Elastic, &drive, &poles, 5e-4, Form::Current);
    /// assert!(bound.torque[0] >= 1.0 / 1.2e5); // a torque that lasts twists the spring
    /// assert!(bound.reading[0] >= 1.0); // a reading that is off by as much takes the link along
    /// # Ok::<(), linkside_core::error::DesignError>(())
    /// ```
    pub fn new(model: JointModel, drive: &Drive, poles: &Poles, h: f64, form: Form) -> Self {
        let n = model.order();
        let [phi, held, ramp, gain] = Sampled::new(model, drive, poles, h).matrices(n);
        let phi = DMatrix::from_row_slice(n, n, &phi);
        let column = |values: &[f64]| RowDVector::from_fn(n, |_, i| values[2 * i + 1]);
        let (late, early) = (column(&ramp), column(&held) - column(&ramp));
        let mut corrected = DMatrix::identity(n, n);
        corrected.column_mut(0).iter_mut().zip(&gain).for_each(|(entry, gain)| *entry -= gain);
        let read = RowDVector::from_iterator(n, (&phi * DVector::from_column_slice(&gain)).iter().copied());
        let (next, torques) = (&phi * &corrected, pieces(model, drive, h));
        let states = if model == JointModel::Rigid { [0, 1] } else { [1, 3] };
        let mut bound = Self { torque: [0.0; 2], acceleration: [0.0; 2], reading: [0.0; 2] };
        for (k, state) in states.into_iter().enumerate() {
            let current = form == Form::Current;
            // What takes an error before a correction to what is reported then, and at each later sample.
            let mut row = if current { corrected.row(state).into_owned() } else { unit(n, state) };
            let (first, mut before) = (row.norm(), RowDVector::zeros(n));
            bound.reading[k] = if current { gain[state].abs() } else { 0.0 };
            for _ in 0..LONGEST {
                bound.torque[k] += torques.iter().map(|piece| row.dot(piece).abs()).sum::<f64>();
                // An acceleration is part of its own prediction, and of the next.
                bound.acceleration[k] += (row.dot(&late) + before.dot(&early)).abs();
                bound.reading[k] += row.dot(&read).abs();
                before.copy_from(&row);
                row = &row * &next;
                if row.norm() <= OVER * first {
                    break;
                }
            }
        }
        bound
    }
}

/// A row of zeros with a one.
fn unit(n: usize, at: usize) -> RowDVector<f64> {
    RowDVector::from_fn(n, |_, i| f64::from(u8::from(i == at)))
}

/// What a torque held over each of the pieces of a period adds by its end.
fn pieces(model: JointModel, drive: &Drive, h: f64) -> Vec<RowDVector<f64>> {
    let (a, input) = model.matrices(drive);
    let n = a.nrows();
    let held = |time: f64| -> RowDVector<f64> {
        let mut augmented = DMatrix::zeros(n + 1, n + 1);
        augmented.view_mut((0, 0), (n, n)).copy_from(&(&a * time));
        augmented.view_mut((0, n), (n, 1)).copy_from(&(input.column(0) * time));
        RowDVector::from_iterator(n, augmented.exp().view((0, n), (n, 1)).iter().copied())
    };
    let ends: Vec<_> = (0..=PIECES).map(|i| held(h * i as f64 / PIECES as f64)).collect();
    ends.windows(2).map(|pair| &pair[1] - &pair[0]).collect()
}
