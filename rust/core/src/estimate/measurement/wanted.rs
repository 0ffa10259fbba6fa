//! What is wanted of a channel: its value, or derivatives with it, and where they go.

use crate::linear;
use crate::scalar::Scalar;

/// Takes a channel's value and derivatives in the links' motion (q, q̇, q̈); rows are zero before.
///
/// All hooks but [`value`](Self::value) do nothing where values alone are wanted, and are then optimised away with all
/// that is computed for them.
pub(crate) trait Wanted<T: Scalar> {
    /// h, without bias.
    fn value(&mut self, row: usize, value: T);

    /// ∂h/∂(q, q̇, q̈) of one joint; once for each joint of a row.
    #[inline(always)]
    fn columns(&mut self, _row: usize, _joint: usize, _by: [T; 3]) {}

    /// The same times `factor`.
    #[inline(always)]
    fn scaled(&mut self, row: usize, joint: usize, factor: T, by: [T; 3]) {
        self.columns(row, joint, by.map(|entry| factor * entry));
    }

    /// Adds to ∂h/∂(q, q̇) of one joint.
    #[inline(always)]
    fn add(&mut self, _row: usize, _joint: usize, _by: [T; 2]) {}

    /// ∂h by what the transmission of one joint gives its link.
    #[inline(always)]
    fn torque(&mut self, _row: usize, _joint: usize, _by: T) {}

    /// ∂h in an entry of the state that is not the links' motion.
    #[inline(always)]
    fn entry(&mut self, _row: usize, _index: usize, _by: T) {}
}

/// Values alone.
pub(crate) struct Values<'a, T>(pub(crate) &'a mut [T]);

impl<T: Scalar> Wanted<T> for Values<'_, T> {
    #[inline(always)]
    fn value(&mut self, row: usize, value: T) {
        self.0[row] = value;
    }
}

/// Values and the whole Jacobian in (q, q̇, q̈) and what follows them, rows × `width`.
pub(crate) struct Jacobian<'a, T> {
    /// h (rows).
    pub(crate) prediction: &'a mut [T],
    /// ∂h/∂(q, q̇, q̈).
    pub(crate) rows: &'a mut [T],
    /// n.
    pub(crate) joints: usize,
    pub(crate) width: usize,
    /// ∂h by what the transmission of the row's joint gives its link (rows); empty if not wanted.
    pub(crate) by_torque: &'a mut [T],
    /// Torques and wrenches from outside in the state, and what these are to links; none where there are none.
    pub(crate) outside: OutsideColumns<'a, T>,
}

/// What of the state acts on links from outside.
#[derive(Clone, Copy, Default)]
pub(crate) struct OutsideColumns<'a, T> {
    /// Whether a torque on each link follows (q, q̇, q̈).
    pub(crate) torques: bool,
    /// What each joint's torque gains by each number of a wrench (n × numbers); these are the last of the state.
    pub(crate) map: &'a [T],
}

impl<T: Scalar> Wanted<T> for Jacobian<'_, T> {
    #[inline(always)]
    fn value(&mut self, row: usize, value: T) {
        self.prediction[row] = value;
    }

    #[inline(always)]
    fn columns(&mut self, row: usize, joint: usize, by: [T; 3]) {
        let n = self.joints;
        for (part, entry) in by.into_iter().enumerate() {
            self.rows[row * self.width + part * n + joint] += entry;
        }
    }

    #[inline(always)]
    fn add(&mut self, row: usize, joint: usize, by: [T; 2]) {
        let n = self.joints;
        for (part, entry) in by.into_iter().enumerate() {
            self.rows[row * self.width + part * n + joint] += entry;
        }
    }

    /// What acts on the link from outside is taken off what its transmission has to give.
    #[inline(always)]
    fn torque(&mut self, row: usize, joint: usize, by: T) {
        if let Some(out) = self.by_torque.get_mut(row) {
            *out = by;
        }
        let (n, OutsideColumns { torques, map }) = (self.joints, self.outside);
        let row = &mut self.rows[row * self.width..][..self.width];
        if torques {
            row[3 * n + joint] = -by;
        }
        let numbers = map.len() / n;
        let last = self.width - numbers;
        for (out, &entry) in row[last..].iter_mut().zip(&map[joint * numbers..]) {
            *out -= by * entry;
        }
    }

    #[inline(always)]
    fn entry(&mut self, row: usize, index: usize, by: T) {
        self.rows[row * self.width + index] += by;
    }
}

/// Values, and the Jacobian in a state of `dense` entries that begins with (q, q̇) and moves q̈ by `ddq_by` (n × dense).
pub(crate) struct Chained<'a> {
    /// h (rows).
    pub(crate) prediction: &'a mut [f64],
    /// ∂h/∂x (rows × dense).
    pub(crate) rows: &'a mut [f64],
    /// n, and the length of what of the state channels depend on.
    pub(crate) joints: usize,
    pub(crate) dense: usize,
    /// ∂q̈/∂x.
    pub(crate) ddq_by: &'a [f64],
}

impl Wanted<f64> for Chained<'_> {
    #[inline(always)]
    fn value(&mut self, row: usize, value: f64) {
        self.prediction[row] = value;
    }

    #[inline(always)]
    fn columns(&mut self, row: usize, joint: usize, [q, dq, ddq]: [f64; 3]) {
        // The chain rule: ∂h/∂x = ∂h/∂(q, q̇) and, by way of the accelerations, ∂h/∂q̈ ∂q̈/∂x.
        self.add(row, joint, [q, dq]);
        let d = self.dense;
        linear::add_scaled(&mut self.rows[row * d..][..d], ddq, &self.ddq_by[joint * d..][..d]);
    }

    #[inline(always)]
    fn add(&mut self, row: usize, joint: usize, [q, dq]: [f64; 2]) {
        self.rows[row * self.dense + joint] += q;
        self.rows[row * self.dense + self.joints + joint] += dq;
    }

    #[inline(always)]
    fn entry(&mut self, row: usize, index: usize, by: f64) {
        self.rows[row * self.dense + index] += by;
    }
}
