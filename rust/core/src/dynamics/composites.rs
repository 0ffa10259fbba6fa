//! The mass matrix from composite moments in the bodies' own axes, where a joint's axis is z.

use super::NewtonEuler;
use super::newton_euler::Moving;
use crate::robot::{Body, JointKind, Tree};
use crate::scalar::Scalar;
use crate::spatial::{Inertia, Vec3};

impl<T: Scalar> NewtonEuler<T> {
    /// Mass matrix M(q), n × n, at the positions that were set. Composite rigid bodies (Walker and Orin 1982), O(n · depth).
    #[inline(always)]
    pub fn mass_matrix_into(&mut self, tree: &Tree, mass: &mut [T]) {
        let n = tree.len();
        mass.fill(T::default());
        for (composite, body) in self.composites.iter_mut().zip(&tree.bodies) {
            *composite = Inertia::constant(&body.inertia);
        }
        for (j, outer) in tree.bodies.iter().enumerate().rev() {
            // The momentum that a unit velocity of joint j gives to all it carries, taken towards the base.
            let (mut force, mut moment) = momentum(&self.composites[j], outer.kind);
            let (b, mut i) = (outer.joint, j);
            loop {
                let inner = &tree.bodies[i];
                let entry = outer.share(inner.share(match inner.kind {
                    JointKind::Revolute => moment.0[2],
                    JointKind::Prismatic => force.0[2],
                }));
                mass[inner.joint * n + b] += entry;
                if i != j {
                    mass[b * n + inner.joint] += entry;
                }
                let Some(carrier) = inner.parent else { break };
                (force, moment) = self.bodies[i].hand_over(inner, force, moment);
                i = carrier;
            }
            if let Some(p) = outer.parent {
                let moved = self.bodies[j].hand_over_mass(outer, &self.composites[j]);
                self.composites[p] += moved;
            }
        }
    }
}

/// Force and moment of the momentum that a unit velocity along or about z gives to `mass`.
#[inline(always)]
fn momentum<T: Scalar>(mass: &Inertia<T>, kind: JointKind) -> (Vec3<T>, Vec3<T>) {
    let ([x, y, _], zero) = (mass.first.0, T::default());
    let [xx, _, xz, yy, yz, _] = mass.second.0;
    match kind {
        JointKind::Revolute => (Vec3([-y, x, zero]), Vec3([-xz, -yz, xx + yy])),
        JointKind::Prismatic => (Vec3([zero, zero, mass.mass]), Vec3([y, -x, zero])),
    }
}

impl<T: Scalar> Moving<T> {
    /// Moments of mass in this body's axes, in those of the carrying body and about its origin.
    #[inline(always)]
    fn hand_over_mass(&self, body: &Body, mass: &Inertia<T>) -> Inertia<T> {
        let mut moved = match body.kind {
            JointKind::Revolute => mass.turned_about_z(self.turn),
            JointKind::Prismatic => mass.shifted(&Vec3([T::default(), T::default(), self.turn.0])),
        };
        moved.first = body.rotation.turn(&moved.first);
        moved.second = body.rotation.turn_tensor(&moved.second);
        moved.shifted_by(&body.translation)
    }
}
