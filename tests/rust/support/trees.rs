//! Random robots.

use super::State;
use linkside_core::robot::{
    Anchor, BodySpec, Counterbalance, Frame, GasSpring, JointKind, Strut, TorqueHarmonic, TorqueSeries, Tree,
};
use linkside_core::spatial::{Mat3, Vec3};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::RngSeed;

/// At most so many bodies.
pub(crate) const MOST: usize = 8;

/// A tree, a sensor on it, and states to put it in.
#[derive(Clone, Debug)]
pub(crate) struct Case {
    pub(crate) gravity: Vec3<f64>,
    pub(crate) specs: Vec<BodySpec>,
    pub(crate) tree: Tree,
    pub(crate) mounting: Mounting,
    pub(crate) states: [State<f64>; 8],
}

/// A frame on a body, as a modeller describes it.
#[derive(Clone, Debug)]
pub(crate) struct Mounting {
    pub(crate) body: usize,
    pub(crate) rotation: Mat3<f64>,
    pub(crate) translation: Vec3<f64>,
}

impl Case {
    /// The first state.
    pub(crate) fn state(&self) -> &State<f64> {
        &self.states[0]
    }

    /// The sensor.
    pub(crate) fn frame(&self) -> Frame {
        let Mounting { body, rotation, translation } = &self.mounting;
        self.frame_at(*body, rotation, translation)
    }

    /// Any other frame.
    pub(crate) fn frame_at(&self, body: usize, rotation: &Mat3<f64>, translation: &Vec3<f64>) -> Frame {
        self.tree.frame("probe", body, rotation, translation).unwrap()
    }
}

/// The same robots in every run.
pub(crate) fn config() -> ProptestConfig {
    ProptestConfig { rng_seed: RngSeed::Fixed(0), cases: 1000, failure_persistence: None, ..ProptestConfig::default() }
}

/// Vectors with entries up to `most`.
pub(crate) fn vectors(most: f64) -> impl Strategy<Value = Vec3<f64>> {
    prop::array::uniform3(-most..most).prop_map(Vec3)
}

/// Unit vectors, along an axis of coordinates as often as not.
fn axes() -> impl Strategy<Value = Vec3<f64>> {
    let coordinate = (0..3_usize, prop::bool::ANY).prop_map(|(k, negative)| {
        let mut axis = Vec3([0.0; 3]);
        axis.0[k] = if negative { -1.0 } else { 1.0 };
        axis
    });
    let any = vectors(1.0).prop_filter("too short to have a direction", |v| v.norm() > 0.1);
    prop_oneof![coordinate, any.prop_map(|v| v * (1.0 / v.norm()))]
}

/// Orientation and position.
fn poses() -> impl Strategy<Value = (Mat3<f64>, Vec3<f64>)> {
    (axes(), -3.0..3.0_f64, vectors(0.5)).prop_map(|(z, angle, p)| (Mat3::z_to(&z).turn_about_z(angle.sin_cos()), p))
}

/// A rotational inertia that some distribution of mass has: tr(Σ)·1 − Σ, Σ = A Aᵀ + 0.01·1.
fn inertias() -> impl Strategy<Value = Mat3<f64>> {
    prop::array::uniform3(vectors(0.3)).prop_map(|rows| {
        let spread = |i: usize, j: usize| rows[i].dot(&rows[j]) + if i == j { 0.01 } else { 0.0 };
        let trace = spread(0, 0) + spread(1, 1) + spread(2, 2);
        let entry = |i, j| if i == j { trace - spread(i, j) } else { -spread(i, j) };
        Mat3::from_rows(core::array::from_fn(|i| core::array::from_fn(|j| entry(i, j))))
    })
}

/// Body `index` of a tree, carried by one before it or by the base.
pub(crate) fn rigid_body(index: usize) -> impl Strategy<Value = BodySpec> {
    let kind = prop_oneof![Just(JointKind::Revolute), Just(JointKind::Prismatic)];
    (0..=index, kind, poses(), axes(), 0.1..5.0, vectors(0.3), inertias()).prop_map(
        move |(carrier, kind, (rotation, translation), axis, mass, com, inertia)| BodySpec {
            parent: carrier.checked_sub(1),
            joint: index,
            kind,
            rotation,
            translation,
            axis,
            mass,
            com,
            inertia,
        },
    )
}

fn trees(n: usize) -> impl Strategy<Value = Vec<BodySpec>> {
    let bodies: Vec<_> = (0..n).map(rigid_body).collect();
    let order = Just((0..n).collect::<Vec<_>>()).prop_shuffle();
    (bodies, order).prop_map(|(mut bodies, order)| {
        for (body, joint) in bodies.iter_mut().zip(order) {
            body.joint = joint;
        }
        bodies
    })
}

fn states(n: usize) -> impl Strategy<Value = State<f64>> {
    let signal = || prop::collection::vec(-3.0..3.0, n);
    (signal(), signal(), signal()).prop_map(|(q, dq, ddq)| State { q, dq, ddq })
}

/// Branched trees of one to eight bodies, joints numbered in any order, under gravity in any direction.
pub(crate) fn cases() -> impl Strategy<Value = Case> {
    (1..=MOST)
        .prop_flat_map(|n| {
            let states = prop::array::uniform8(states(n));
            (vectors(10.0), trees(n), any::<Index>(), poses(), states)
        })
        .prop_map(|(gravity, specs, body, (rotation, translation), states)| {
            let tree = Tree::new(gravity, &specs).unwrap();
            let mounting = Mounting { body: body.index(specs.len()), rotation, translation };
            Case { gravity, specs, tree, mounting, states }
        })
}

/// Such trees with counterbalances: springs and gas between any two bodies, series on joints that turn.
pub(crate) fn balanced_cases() -> impl Strategy<Value = Case> {
    let struts = (any::<(Index, Index, bool)>(), vectors(0.7), vectors(0.7), -1.0..1.0_f64);
    let gas = (1.0..2.0_f64, prop::bool::ANY);
    let wave = (0..7_u32, -2.0..2.0_f64, -2.0..2.0_f64);
    (cases(), prop::collection::vec((struts, gas), 1..4), prop::collection::vec(wave, 1..4)).prop_map(
        |(case, struts, waves)| {
            let between = |((bodies, near, far, length), (exponent, pulls)): (_, (f64, bool))| {
                let (first, second, grounded): (Index, Index, bool) = bodies;
                let [first, second] = [first, second].map(|i| i.index(case.specs.len()));
                let second = Some(second).filter(|&other| !grounded && other != first);
                let ends = [Anchor { body: Some(first), point: near }, Anchor { body: second, point: far }];
                let (volume, area) = (0.2, 2e-3); // enough of it for the longest way
                let gas = GasSpring { pressure: 1e4, volume, length: 1.0, area, exponent, ambient: 1e3, pulls };
                let strut = if exponent < 1.4 { Strut::Gas(gas) } else { Strut::Spring { stiffness: 30.0, length } };
                Counterbalance::Between { ends, strut }
            };
            let mut all: Vec<_> = struts.into_iter().map(between).collect();
            let turns = case.specs.iter().filter(|body| body.kind == JointKind::Revolute);
            let joints: Vec<_> = turns.map(|body| body.joint).take(2).collect();
            if !joints.is_empty() {
                let harmonic = |(order, cosine, sine)| TorqueHarmonic { order, cosine, sine };
                let series = TorqueSeries(waves.into_iter().map(harmonic).collect());
                all.push(Counterbalance::Turning { joints, series });
            }
            let tree = case.tree.clone().with_counterbalances(&all).unwrap();
            Case { tree, ..case }
        },
    )
}
