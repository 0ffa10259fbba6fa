use super::*;
use crate::scalar::{Dual, Lanes};

fn drive() -> Drive {
    Drive {
        cubic_stiffness: 3e4,
        soft_windup: SoftWindup { stiffness: 120.0, shape: 800.0 },
        motor_friction: Friction {
            viscous: 0.1,
            coulomb: 2.0,
            stribeck: 1.5,
            stribeck_velocity: 0.05,
            asymmetry: -0.7,
        },
        link_friction: [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
        bearing_friction: Friction { viscous: 0.3, coulomb: 1.0, asymmetry: 0.2, ..Friction::default() },
        ..Drive::spring(500.0, 1.0, 1.0)
    }
}

/// Drives with every law of a spring.
fn drives() -> [Drive; 4] {
    let backlash = Backlash { half_gap: 2e-3, slope: 0.02, rounding: 3e-4 };
    let curve = SpringCurve::new(&[[0.01, 6.0], [0.1, 90.0]], Interpolation::Monotone).unwrap();
    let table = Drive { curve, ..drive() };
    [drive(), Drive { backlash, ..drive() }, table.clone(), Drive { backlash, ..table }]
}

#[test]
fn slopes_are_the_derivatives_of_the_laws() {
    for (d, x) in drives().iter().flat_map(|d| [-0.3, -0.01, 0.0, 1e-3, 0.2].map(|x| (d, x))) {
        let v = Dual::<1>::variable(x, 0);
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * (1.0 + a.abs()), "{x}: {a} {b}");
        near(d.spring_torque(v).gradient[0], d.tangent_stiffness(x));
        near(d.link_friction(v).0.gradient[0], d.link_friction(x).1);
        near(d.motor_friction(v).0.gradient[0], d.motor_friction(x).1);
        near(d.nonlinear_torque(x) + d.stiffness * x, d.spring_torque(x));
        let torque = d.spring_torque(v);
        near(d.torsion(torque).value, x);
        near(d.torsion(torque).gradient[0], 1.0);
    }
}

/// Rates with derivatives give torsions with those: δ(K, c, τ) of φ(δ; K, c) = τ has δ_K = −φ_K/φ′.
#[test]
fn torsions_have_the_derivatives_of_rates() {
    for (d, x) in drives()[..2].iter().flat_map(|d| [-0.3, 1e-3, 0.05].map(|x| (d, x))) {
        let rates = SpringRates { stiffness: Dual::<3>::variable(d.stiffness, 0), cubic: Dual::variable(3e4, 1) };
        let (torsion, compliance) = d.twist(rates, Dual::variable(d.spring_torque(x), 2));
        let (engaged, slope) = (d.backlash.engaged(x), d.tangent_stiffness(x));
        let expected = [-engaged / slope, -d.hardening(x) / slope, 1.0 / slope];
        assert!((torsion.value - x).abs() < 1e-12 && (compliance.value * slope - 1.0).abs() < 1e-12);
        for (found, expected) in torsion.gradient.iter().zip(expected) {
            assert!((found - expected).abs() <= 1e-10 * expected.abs(), "{x}: {found} {expected}");
        }
    }
}

/// The least slope on a fine grid, for wind-ups that are missing and that are added.
#[test]
fn the_softest_torsion_is_found() {
    for (k, shape, cubic) in [(300.0, 800.0, 3e4), (-900.0, 800.0, 0.0), (-900.0, 800.0, 3e4), (-9.0, 80.0, 3e5)] {
        let d = Drive { soft_windup: SoftWindup { stiffness: k, shape }, cubic_stiffness: cubic, ..drive() };
        let grid = (0..20_000).map(|i| d.tangent_stiffness(1e-5 * f64::from(i)));
        let least = grid.fold(f64::INFINITY, f64::min);
        assert!((d.soft_windup.least_slope(d.stiffness, cubic) - least).abs() < 1e-5 * d.stiffness, "{k} {least}");
    }
}

#[test]
fn a_spring_that_gives_way_is_refused() {
    let windup = |stiffness, shape| Drive { soft_windup: SoftWindup { stiffness, shape }, ..drive() }.check("it");
    assert!(windup(499.0, 800.0).is_ok() && windup(-1000.0, 800.0).is_ok());
    for (stiffness, shape) in [(501.0, 800.0), (-2000.0, 2e5)] {
        let error = windup(stiffness, shape).unwrap_err().to_string();
        assert!(error.contains("least tangent stiffness of it") && error.contains("must rise"), "{error}");
    }
    assert!(windup(10.0, -1.0).unwrap_err().to_string().contains("soft wind-up's shape of it is -1"));
    let cubic = Drive { cubic_stiffness: -1.0, ..drive() }.check("it").unwrap_err();
    assert!(cubic.to_string().contains("cubic stiffness of it is -1, expected at least 0"));
    let stribeck = Friction { stribeck: 1.0, ..Friction::default() };
    let error = Drive { motor_friction: stribeck, ..drive() }.check("it").unwrap_err();
    assert!(error.to_string().contains("Stribeck velocity of it is 0, expected greater than 0"));
}

#[test]
fn lanes_hold_the_bits_of_one_number() {
    let (drives, x) = (drives(), [-0.3, -0.001, 0.02, 0.7]);
    let v = Lanes(x);
    for (d, i) in drives.iter().flat_map(|d| [0, 1, 2, 3].map(|i| (d, i))) {
        assert_eq!(d.torsion(v).0[i], d.torsion(x[i]));
        assert_eq!(d.link_friction(v).0.0[i], d.link_friction(x[i]).0);
        assert_eq!(d.dry_friction(v).0[i], d.dry_friction(x[i]));
    }
}
