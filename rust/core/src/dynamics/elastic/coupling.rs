//! The inertia that motors and links share.

use crate::linear;
use crate::robot::{Robot, Tree};
use crate::scalar::Scalar;

/// S of the equations of motion: constant, or of motors that links carry as posture has it.
#[derive(Clone, Debug)]
pub(super) struct Coupling<T> {
    /// n × n, the entry of link i and motor j in row i.
    matrix: Vec<T>,
    /// Motor j couples only to this many links, the first ones.
    reach: Vec<usize>,
    /// Where links carry motors.
    pub(super) rotors: Option<Rotors<T>>,
}

/// The tree in which each rotor is one more body behind all links, and how all of them move.
///
/// A rotor is round: its angle matters to nothing.
#[derive(Clone, Debug)]
pub(super) struct Rotors<T> {
    /// Links, then rotors.
    pub(super) tree: Tree,
    /// Of every body's joint.
    pub(super) position: Vec<T>,
    pub(super) velocity: Vec<T>,
    pub(super) acceleration: Vec<T>,
}

impl<T: Scalar> Coupling<T> {
    pub(super) fn new(robot: &Robot) -> Self {
        let n = robot.len();
        let carried = |j: usize| robot.rotors.iter().any(|rotor| rotor.motor == j);
        let last = |j: usize| (0..j).rfind(|&i| robot.coupling[i * n + j] != 0.0).map_or(0, |i| i + 1);
        let room = || vec![T::default(); n + robot.rotors.len()];
        let rotors = || Rotors {
            tree: robot.tree.with_rotors(&robot.rotors, &robot.drives),
            position: room(),
            velocity: room(),
            acceleration: room(),
        };
        Self {
            matrix: robot.coupling.iter().map(|&s| T::constant(s)).collect(),
            reach: (0..n).map(|j| if carried(j) { n } else { last(j) }).collect(),
            rotors: (!robot.rotors.is_empty()).then(rotors),
        }
    }

    /// Links that motor `j` may couple to, with S.
    #[inline(always)]
    pub(super) fn links(&self, j: usize) -> impl Iterator<Item = (usize, T)> + '_ {
        let n = self.reach.len();
        (0..self.reach[j]).map(move |i| (i, self.matrix[i * n + j]))
    }

    /// As [`links`](Self::links), without those of no inertia.
    #[inline(always)]
    pub(super) fn coupled(&self, j: usize) -> impl Iterator<Item = (usize, T)> + '_ {
        self.links(j).filter(|(_, s)| *s != T::default())
    }

    /// Row `j` of Sᵀ q̈.
    #[inline(always)]
    pub(super) fn pull(&self, j: usize, ddq: &[T]) -> T {
        self.links(j).fold(T::default(), |sum, (i, s)| sum + s * ddq[i])
    }

    /// `row` −= row `j` of Sᵀ times `links`, which has rows of `row`'s length.
    #[inline(always)]
    pub(super) fn subtract_pull(&self, j: usize, links: &[T], row: &mut [T]) {
        let width = row.len();
        for (i, s) in self.links(j) {
            linear::add_scaled(row, -s, &links[i * width..][..width]);
        }
    }

    /// Of the mass matrix of links and rotors, the rotors' part into S and that of the links to the front.
    #[inline(always)]
    pub(super) fn take(&mut self, robot: &Robot, mass: &mut [T]) {
        if self.rotors.is_none() {
            return;
        }
        let n = robot.len();
        let bodies = n + robot.rotors.len();
        for (row, rotor) in mass[n * bodies..].chunks_exact(bodies).zip(&robot.rotors) {
            for (i, &entry) in row[..n].iter().enumerate() {
                // A rotor turns `ratio` times as fast as the motor's coordinate, reflected through the gear: S = ratio
                // · M(link, rotor).
                self.matrix[i * n + rotor.motor] = entry * rotor.ratio;
            }
        }
        for i in 1..n {
            mass.copy_within(i * bodies..i * bodies + n, i * n);
        }
    }
}
