//! Links, drives, sensors and what else a robot is made of.

use super::BuildError;
use linkside_core::dynamics::check_inertia;
use linkside_core::error::RobotError;
use linkside_core::robot::{
    self, Acting, Anchor, Backlash, BodySpec, Counterbalance, Frame, Friction, FrictionElement, GasSpring, Harmonic,
    Hysteresis, Interpolation, JointKind, LoadFriction, Ripple, SoftWindup, SpringCurve, Strut, TorqueHarmonic,
    TorqueSeries, Tree, Wrench as CoreWrench,
};
use linkside_core::spatial::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

/// No controller's robot has more joints, or more sensors of a kind.
pub(crate) const MOST_PARTS: usize = 256;

type Rows3 = [[f64; 3]; 3];

/// A robot; see [`linkside_core::robot::Robot`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Acceleration of free fall in the base frame [m/s²].
    pub gravity: [f64; 3],
    /// In topological order.
    pub bodies: Vec<Body>,
    /// One a joint.
    pub drives: Vec<Drive>,
    /// Rows of S (n × n), strictly upper triangular [kg m²].
    pub coupling: Vec<Vec<f64>>,
    /// Specific force.
    pub accelerometers: Vec<Sensor>,
    /// Angular velocity.
    pub gyroscopes: Vec<Sensor>,
    /// Tool centre point.
    pub tool: Option<Place>,
    /// Motors whose rotors links carry.
    pub rotors: Vec<Rotor>,
    /// What carries part of the weight.
    pub counterbalances: Vec<Balance>,
    /// Joints whose motors share gears, and rows of the matrix that says how; none: each has its own.
    #[serde(default)]
    pub gearing: (Vec<usize>, Vec<f64>),
    /// Which joint each body beyond those of joints follows, by which ratio and from which offset.
    #[serde(default)]
    pub followers: Vec<(usize, f64, f64)>,
    /// What acts on links from outside.
    #[serde(default)]
    pub wrenches: Vec<Wrench>,
    /// What sees points of links from beside the robot.
    #[serde(default)]
    pub trackers: Vec<Tracker>,
}

/// A moving body; see [`BodySpec`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // as of `BodySpec`
pub struct Body {
    /// The body that carries it, −1 for the base.
    pub parent: i64,
    pub joint: usize,
    pub prismatic: bool,
    pub rotation: Rows3,
    pub translation: [f64; 3],
    pub axis: [f64; 3],
    pub mass: f64,
    pub com: [f64; 3],
    pub inertia: Rows3,
}

/// What is between a motor and its link; see [`linkside_core::robot::Drive`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // as of `Drive` of the core, and of the laws in it
pub struct Drive {
    pub elastic: bool,
    pub stiffness: f64,
    pub damping: f64,
    pub motor_inertia: f64,
    pub cubic_stiffness: f64,
    pub soft_windup_stiffness: f64,
    pub soft_windup_shape: f64,
    /// Points (torsion, torque); none: the spring is that of the numbers above.
    pub curve: Vec<[f64; 2]>,
    /// Whether straight lines join them.
    pub curve_straight: bool,
    /// Half gap, slope, rounding.
    pub gap: [f64; 3],
    /// Amplitude, frequency, phase of each harmonic.
    pub ripple: Vec<[f64; 3]>,
    /// See [`linkside_core::robot::Drive::encoder_lines`].
    #[serde(default)]
    pub encoder_lines: Vec<f64>,
    /// Stiffness, limit, recoil, rounding of each friction element.
    pub hysteresis: Vec<[f64; 4]>,
    pub friction_viscous: f64,
    pub friction_coulomb: f64,
    pub friction_stribeck: f64,
    pub friction_stribeck_velocity: f64,
    pub friction_asymmetry: f64,
    /// Share lost where it drives, share lost where it is driven, rounding.
    pub gear_loss: [f64; 3],
    pub link_friction: [f64; 6],
    /// Viscous, Coulomb, Stribeck, Stribeck velocity, asymmetry.
    pub bearing: [f64; 5],
    /// As `gear_loss`.
    pub bearing_loss: [f64; 3],
}

/// A point with axes on a body.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // as of `Tree::frame`
pub struct Place {
    pub body: usize,
    pub rotation: Rows3,
    pub translation: [f64; 3],
}

/// A three-axis sensor; see [`linkside_core::robot::Sensor`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // as of `Sensor` of the core
pub struct Sensor {
    pub body: usize,
    pub rotation: Rows3,
    pub translation: [f64; 3],
    pub axes: Vec<usize>,
    pub noise_std: f64,
}

/// A tracker; see [`linkside_core::robot::Tracker`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // as of `Tracker` of the core
pub struct Tracker {
    pub target: Sensor,
    /// Rows of the rotation from its axes to the base frame's.
    pub rotation: Rows3,
    pub origin: [f64; 3],
}

/// A rotor on a link; see [`linkside_core::robot::Rotor`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // as of `Rotor` of the core
pub struct Rotor {
    pub motor: usize,
    pub body: usize,
    pub axis: [f64; 3],
    pub ratio: f64,
}

/// A force and a moment on a link; see [`linkside_core::robot::Wrench`].
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Wrench {
    /// Its frame.
    pub place: Place,
    /// Its numbers; none: it varies.
    pub constant: Option<[f64; 6]>,
    /// Whether a sensor measures it.
    pub measured: bool,
}

/// A strut between two points, or a series of torques on joints; each with what the other has not, empty.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Balance {
    /// Bodies, −1 for the base, and points on them [m].
    pub ends: Vec<(i64, [f64; 3])>,
    /// Stiffness and length.
    pub spring: Option<[f64; 2]>,
    /// Pressure, volume, length, area, exponent, ambient pressure.
    pub gas: Option<[f64; 6]>,
    /// Whether a gas spring pulls.
    pub pulls: bool,
    /// Which joints a series turns.
    pub joints: Vec<usize>,
    /// Order, cosine, sine of each harmonic.
    pub series: Vec<(u32, f64, f64)>,
}

impl Robot {
    /// The robot ready for kernels, with all checks.
    ///
    /// # Errors
    /// Parts that do not fit together, numbers out of range, an inertia that no links have.
    pub fn build(&self) -> Result<robot::Robot, BuildError> {
        let n = self.drives.len();
        let parts = [
            ("joints", n),
            ("bodies", self.bodies.len()),
            ("accelerometers", self.accelerometers.len()),
            ("gyroscopes", self.gyroscopes.len()),
            ("rotors", self.rotors.len()),
            ("counterbalances", self.counterbalances.len()),
            ("wrenches", self.wrenches.len()),
            ("trackers", self.trackers.len()),
        ];
        for (what, found) in parts {
            BuildError::limit(what, found, MOST_PARTS)?;
        }
        for row in &self.coupling {
            if row.len() != n {
                return Err(RobotError::Length { what: "a row of the coupling", found: row.len(), expected: n }.into());
            }
        }
        let specs: Vec<_> = self.bodies.iter().map(Body::spec).collect();
        let tree = Tree::new(Vec3(self.gravity), &specs)?.with_followers(&self.followers)?;
        let place = |kind, sensors: &[Sensor]| sensors.iter().map(|s| s.build(kind, &tree)).collect::<Result<_, _>>();
        let (accelerometers, gyroscopes) =
            (place("accelerometer", &self.accelerometers)?, place("gyroscope", &self.gyroscopes)?);
        let trackers = self.trackers.iter().map(|one| one.build(&tree)).collect::<Result<_, _>>()?;
        let tool = self.tool.as_ref().map(|tool| tool.build("tool", &tree)).transpose()?;
        let drives = self.drives.iter().map(Drive::build).collect::<Result<_, _>>()?;
        let counterbalances: Vec<_> = self.counterbalances.iter().map(Balance::build).collect();
        let wrenches = self.wrenches.iter().map(|one| one.build(&tree)).collect::<Result<_, _>>()?;
        let robot = robot::Robot::new(tree, drives, self.coupling.concat(), accelerometers, gyroscopes, tool)?
            .with_counterbalances(&counterbalances)?
            .with_rotors(self.rotors.iter().map(Rotor::build).collect())?
            .with_gearing(self.gearing.0.clone(), &self.gearing.1)?
            .with_wrenches(wrenches)?
            .with_trackers(trackers)?;
        check_inertia(&robot)?;
        Ok(robot)
    }
}

impl Body {
    fn spec(&self) -> BodySpec {
        BodySpec {
            parent: usize::try_from(self.parent).ok(),
            joint: self.joint,
            kind: if self.prismatic { JointKind::Prismatic } else { JointKind::Revolute },
            rotation: Mat3::from_rows(self.rotation),
            translation: Vec3(self.translation),
            axis: Vec3(self.axis),
            mass: self.mass,
            com: Vec3(self.com),
            inertia: Mat3::from_rows(self.inertia),
        }
    }
}

impl Drive {
    fn build(&self) -> Result<robot::Drive, RobotError> {
        let interpolation = if self.curve_straight { Interpolation::Linear } else { Interpolation::Monotone };
        let none = self.curve.is_empty();
        let curve = if none { SpringCurve::default() } else { SpringCurve::new(&self.curve, interpolation)? };
        let [half_gap, slope, rounding] = self.gap;
        let [viscous, coulomb, stribeck, stribeck_velocity, asymmetry] = self.bearing;
        let load_friction = |[driving, driven, rounding]: [f64; 3]| LoadFriction { driving, driven, rounding };
        let element =
            |&[stiffness, limit, recoil, rounding]: &[f64; 4]| FrictionElement { stiffness, limit, recoil, rounding };
        let harmonic = |&[amplitude, frequency, phase]: &[f64; 3]| Harmonic { amplitude, frequency, phase };
        Ok(robot::Drive {
            elastic: self.elastic,
            stiffness: self.stiffness,
            damping: self.damping,
            motor_inertia: self.motor_inertia,
            cubic_stiffness: self.cubic_stiffness,
            soft_windup: SoftWindup { stiffness: self.soft_windup_stiffness, shape: self.soft_windup_shape },
            curve,
            backlash: Backlash { half_gap, slope, rounding },
            hysteresis: Hysteresis { elements: self.hysteresis.iter().map(element).collect() },
            ripple: Ripple::new(self.ripple.iter().map(harmonic).collect()),
            encoder_lines: self.encoder_lines.clone(),
            motor_friction: Friction {
                viscous: self.friction_viscous,
                coulomb: self.friction_coulomb,
                stribeck: self.friction_stribeck,
                stribeck_velocity: self.friction_stribeck_velocity,
                asymmetry: self.friction_asymmetry,
            },
            gear_loss: load_friction(self.gear_loss),
            link_friction: self.link_friction,
            bearing_friction: Friction { viscous, coulomb, stribeck, stribeck_velocity, asymmetry },
            bearing_loss: load_friction(self.bearing_loss),
        })
    }
}

impl Place {
    fn build(&self, owner: &str, tree: &Tree) -> Result<Frame, RobotError> {
        tree.frame(owner, self.body, &Mat3::from_rows(self.rotation), &Vec3(self.translation))
    }
}

impl Wrench {
    fn build(&self, tree: &Tree) -> Result<CoreWrench, RobotError> {
        let acting = self.constant.map_or(Acting::Varying { measured: self.measured }, Acting::Constant);
        Ok(CoreWrench { frame: self.place.build("wrench", tree)?, acting })
    }
}

impl Sensor {
    fn build(&self, kind: &'static str, tree: &Tree) -> Result<robot::Sensor, BuildError> {
        BuildError::limit("axes of a sensor", self.axes.len(), 3)?;
        let frame = tree.frame(kind, self.body, &Mat3::from_rows(self.rotation), &Vec3(self.translation))?;
        Ok(robot::Sensor { frame, axes: self.axes.clone(), noise_std: self.noise_std })
    }
}

impl Tracker {
    fn build(&self, tree: &Tree) -> Result<robot::Tracker, BuildError> {
        let (axes, origin) = (Mat3::from_rows(self.rotation), Vec3(self.origin));
        Ok(robot::Tracker { target: self.target.build("tracker", tree)?, axes, origin })
    }
}

impl Rotor {
    fn build(&self) -> robot::Rotor {
        let Self { motor, body, axis, ratio } = *self;
        robot::Rotor { motor, body, axis: Vec3(axis), ratio }
    }
}

impl Balance {
    fn build(&self) -> Counterbalance {
        let anchor = |&(body, point): &(i64, [f64; 3])| Anchor { body: usize::try_from(body).ok(), point: Vec3(point) };
        let strut = match (self.spring, self.gas) {
            (Some([stiffness, length]), _) => Some(Strut::Spring { stiffness, length }),
            (_, Some([pressure, volume, length, area, exponent, ambient])) => {
                Some(Strut::Gas(GasSpring { pressure, volume, length, area, exponent, ambient, pulls: self.pulls }))
            }
            _ => None,
        };
        if let (Some(strut), [a, b]) = (strut, &self.ends[..]) {
            return Counterbalance::Between { ends: [anchor(a), anchor(b)], strut };
        }
        let harmonic = |&(order, cosine, sine): &(u32, f64, f64)| TorqueHarmonic { order, cosine, sine };
        let series = TorqueSeries(self.series.iter().map(harmonic).collect());
        Counterbalance::Turning { joints: self.joints.clone(), series }
    }
}
