//! Dynamics of robots with any masses and places, at any states.

use super::bytes::Bytes;
use linkside_core::dynamics::{Batch, DrivenStates, States, check_inertia};
use linkside_core::robot::{BodySpec, Drive, JointKind, Robot, Tree};
use linkside_core::spatial::{Mat3, Vec3};
use std::sync::Arc;

/// A tree of up to six joints.
fn robot(bytes: &mut Bytes<'_>) -> Option<Robot> {
    let count = bytes.below(7);
    let plain = bytes.flag();
    let mut number = |usual: f64| if plain || bytes.flag() { usual } else { bytes.number() };
    let mut vector = |usual: [f64; 3]| Vec3(usual.map(&mut number));
    let specs: Vec<_> = (0..count)
        .map(|index| {
            let inertia = vector([0.1, 0.2, 0.15]).0;
            let [mass, parent, joint] = vector([2.0, index as f64 - 1.0, index as f64]).0;
            BodySpec {
                parent: (parent >= 0.0).then_some(parent as usize),
                joint: joint as usize,
                kind: if inertia[0] > 1.0 { JointKind::Prismatic } else { JointKind::Revolute },
                rotation: Mat3::IDENTITY,
                translation: vector([0.3, 0.0, 0.1]),
                axis: vector([0.0, 1.0, 0.0]),
                mass,
                com: vector([0.1, 0.0, 0.05]),
                inertia: Mat3::from_rows([[inertia[0], 0.0, 0.0], [0.0, inertia[1], 0.0], [0.0, 0.0, inertia[2]]]),
            }
        })
        .collect();
    let tree = Tree::new(vector([0.0, 0.0, -9.81]), &specs).ok()?;
    let drives = vec![Drive::spring(1e5, 50.0, 3.0); count];
    Robot::new(tree, drives, vec![0.0; count * count], vec![], vec![], None).ok()
}

/// Torques, matrices and accelerations; where inertia and state are plain, the mass matrix is symmetric.
pub fn dynamics(data: &[u8]) {
    let mut bytes = Bytes(data);
    let Some(robot) = robot(&mut bytes) else { return };
    let n = robot.len();
    let sound = check_inertia(&robot).is_ok();
    let [q, dq, ddq, theta, dtheta] = [(); 5].map(|()| bytes.numbers(n));
    let states = States { q: &q, dq: &dq, ddq: &ddq };
    let mut batch = Batch::new(Arc::new(robot));
    let (mut torque, mut matrix) = (vec![0.0; n], vec![0.0; n * n]);
    batch.inverse_dynamics(states, &mut torque);
    batch.gravity_torque(&q, &mut torque);
    batch.coriolis_matrix(&q, &dq, &mut matrix);
    batch.mass_matrix(&q, &mut matrix);
    let finite = matrix.iter().all(|x| x.is_finite());
    assert!(!finite || (0..n).all(|i| (0..i).all(|j| matrix[i * n + j] == matrix[j * n + i])));
    assert!(!(sound && finite) || (0..n).all(|i| matrix[i * n + i] >= 0.0), "a mass matrix of {matrix:?} at {q:?}");
    let mut derivatives = vec![0.0; 3 * n * n];
    batch.inverse_dynamics_derivatives(states, &mut derivatives);
    let driven = DrivenStates { q: &q, dq: &dq, theta: &theta, dtheta: &dtheta, tau: &ddq };
    batch.forward_dynamics(driven, &mut vec![0.0; 4 * n]);
}
