//! An industrial arm of any number of joints.

use linkside_core::robot::{BodySpec, Drive, Friction, JointKind, Robot, Sensor, Tree};
use linkside_core::spatial::{Mat3, Vec3};

/// An accelerometer on body `body`, at `at` in its frame.
#[derive(Clone, Debug)]
pub(crate) struct Mounting {
    pub(crate) body: usize,
    pub(crate) at: [f64; 3],
    pub(crate) axes: Vec<usize>,
    pub(crate) noise_std: f64,
}

/// A drive of round figures.
pub(crate) fn drive() -> Drive {
    Drive {
        motor_friction: Friction { viscous: 10.0, coulomb: 5.0, ..Friction::default() },
        ..Drive::spring(1.2e5, 60.0, 30.0)
    }
}

/// One joint a drive: first about z, then about y, every third one about x; half a metre apart, with a tool at the end.
pub(crate) fn arm(drives: Vec<Drive>, mountings: &[Mounting]) -> Robot {
    let n = drives.len();
    let specs: Vec<_> = (0..n).map(link).collect();
    let tree = Tree::new(Vec3([0.0, 0.0, -9.81]), &specs).unwrap();
    let frame = |body, at| tree.frame("a frame of the arm", body, &Mat3::IDENTITY, &Vec3(at)).unwrap();
    let sensors = mountings
        .iter()
        .map(|m| Sensor { frame: frame(m.body, m.at), axes: m.axes.clone(), noise_std: m.noise_std })
        .collect();
    let tool = frame(n - 1, [0.5, 0.0, 0.1]);
    Robot::new(tree, drives, vec![0.0; n * n], sensors, vec![], Some(tool)).unwrap()
}

fn link(index: usize) -> BodySpec {
    let axis = match index {
        0 => [0.0, 0.0, 1.0],
        i if i % 3 == 0 => [1.0, 0.0, 0.0],
        _ => [0.0, 1.0, 0.0],
    };
    BodySpec {
        parent: index.checked_sub(1),
        joint: index,
        kind: JointKind::Revolute,
        rotation: Mat3::IDENTITY,
        translation: Vec3([if index == 0 { 0.0 } else { 0.5 }, 0.0, 0.1]),
        axis: Vec3(axis),
        mass: 10.0 / (1.0 + index as f64),
        com: Vec3([0.2, 0.05, 0.0]),
        inertia: Mat3::from_rows([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.15]]),
    }
}
