//! A description to try things on; the examples of this documentation run on it.

use crate::description::{Body, Description, Drive, Method, Observer, Robot, Sensor};

const UPRIGHT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The arm of [`linkside_core::demo::arm`], without its tool, and an observer at 1 kHz.
///
/// ```
/// let estimator = linkside_compiled::Estimator::new(linkside_compiled::demo::observer())?;
/// assert_eq!((estimator.method(), estimator.period()), ("observer", Some(1e-3)));
/// # Ok::<(), linkside_compiled::description::BuildError>(())
/// ```
pub fn observer() -> Description {
    let poles = [-90.0, -100.0, -110.0, -120.0].map(|pole| [pole, 0.0]).to_vec();
    Description {
        writer: concat!("linkside ", env!("CARGO_PKG_VERSION")).into(),
        joints: vec!["joint".into()],
        accelerations: ["x", "y", "z"].map(|axis| format!("tip_{axis}")).to_vec(),
        rates: vec![],
        robot: robot(),
        estimator: Method::Observer(Observer {
            period: 1e-3,
            poles: vec![poles],
            bias: false,
            predictor: false,
            joint_accelerations: false,
            worst_acceleration_std: 10.0,
            rest: true,
            start: None,
            uncertainty: None,
        }),
    }
}

fn robot() -> Robot {
    let link = Body {
        parent: -1,
        joint: 0,
        prismatic: false,
        rotation: UPRIGHT,
        translation: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        mass: 5.0,
        com: [0.5, 0.0, 0.0],
        inertia: [[0.01, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.4]],
    };
    let tip = [1.0, 0.0, 0.0];
    Robot {
        gravity: [0.0, 0.0, -9.81],
        bodies: vec![link],
        drives: vec![drive()],
        coupling: vec![vec![0.0]],
        accelerometers: vec![Sensor {
            body: 0,
            rotation: UPRIGHT,
            translation: tip,
            axes: vec![0, 1, 2],
            noise_std: 0.05,
        }],
        gyroscopes: vec![],
        trackers: vec![],
        tool: None,
        rotors: vec![],
        counterbalances: vec![],
        gearing: (vec![], vec![]),
        followers: vec![],
        wrenches: vec![],
    }
}

fn drive() -> Drive {
    Drive {
        elastic: true,
        stiffness: 1.2e4,
        damping: 20.0,
        motor_inertia: 3.0,
        cubic_stiffness: 0.0,
        soft_windup_stiffness: 0.0,
        soft_windup_shape: 0.0,
        curve: vec![],
        curve_straight: false,
        gap: [0.0, 0.5, 1.0],
        ripple: vec![],
        encoder_lines: vec![],
        hysteresis: vec![],
        friction_viscous: 0.0,
        friction_coulomb: 0.0,
        friction_stribeck: 0.0,
        friction_stribeck_velocity: 1.0,
        friction_asymmetry: 0.0,
        gear_loss: [0.0, 0.0, 1.0],
        link_friction: [0.0; 6],
        bearing: [0.0, 0.0, 0.0, 1.0, 0.0],
        bearing_loss: [0.0, 0.0, 1.0],
    }
}
