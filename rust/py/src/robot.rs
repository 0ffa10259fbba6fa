//! A compiled robot and its dynamics over arrays.

use crate::array::{counted, mat3, rows, shaped, vec3};
use crate::error::IntoPyErr;
use crate::gil::Release;
use linkside_core::dynamics::{Batch, DrivenStates, States, check_inertia};
use linkside_core::error::{DesignError, RobotError};
use linkside_core::memory;
use linkside_core::robot::{
    self, Anchor, Backlash, BodySpec, Counterbalance, Friction, FrictionElement, GasSpring, Harmonic, Hysteresis,
    Interpolation, JointKind, LoadFriction, Ripple, Rotor, SoftWindup, SpringCurve, Strut, TorqueHarmonic,
    TorqueSeries, Tree,
};
use numpy::{PyArrayDyn, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::Arc;

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Body {
    parent: isize,
    joint: usize,
    prismatic: bool,
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    axis: [f64; 3],
    mass: f64,
    com: [f64; 3],
    inertia: [[f64; 3]; 3],
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Drive {
    elastic: bool,
    stiffness: f64,
    damping: f64,
    motor_inertia: f64,
    cubic_stiffness: f64,
    soft_windup_stiffness: f64,
    soft_windup_shape: f64,
    curve: Vec<[f64; 2]>,
    curve_straight: bool,
    gap: [f64; 3],
    ripple: Vec<[f64; 3]>,
    encoder_lines: Vec<f64>,
    hysteresis: Vec<[f64; 4]>,
    friction_viscous: f64,
    friction_coulomb: f64,
    friction_stribeck: f64,
    friction_stribeck_velocity: f64,
    friction_asymmetry: f64,
    gear_loss: [f64; 3],
    link_friction: [f64; 6],
    bearing: [f64; 5],
    bearing_loss: [f64; 3],
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Sensor {
    body: usize,
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    axes: Vec<usize>,
    noise_std: f64,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct RotorPlace {
    motor: usize,
    body: usize,
    axis: [f64; 3],
    ratio: f64,
}

/// A strut between two points, or a series of torques on joints; each with what the other has not, empty.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Balance {
    ends: Vec<(isize, [f64; 3])>,
    spring: Option<[f64; 2]>,
    gas: Option<[f64; 6]>,
    pulls: bool,
    joints: Vec<usize>,
    series: Vec<(u32, f64, f64)>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Tool {
    body: usize,
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Body {
    fn spec(self) -> BodySpec {
        BodySpec {
            parent: usize::try_from(self.parent).ok(),
            joint: self.joint,
            kind: if self.prismatic { JointKind::Prismatic } else { JointKind::Revolute },
            rotation: mat3(self.rotation),
            translation: vec3(self.translation),
            axis: vec3(self.axis),
            mass: self.mass,
            com: vec3(self.com),
            inertia: mat3(self.inertia),
        }
    }
}

impl TryFrom<Drive> for robot::Drive {
    type Error = RobotError;

    fn try_from(d: Drive) -> Result<Self, RobotError> {
        let interpolation = if d.curve_straight { Interpolation::Linear } else { Interpolation::Monotone };
        let none = d.curve.is_empty();
        let curve = if none { SpringCurve::default() } else { SpringCurve::new(&d.curve, interpolation)? };
        let [half_gap, slope, rounding] = d.gap;
        let [viscous, coulomb, stribeck, stribeck_velocity, asymmetry] = d.bearing;
        let load_friction = |[driving, driven, rounding]: [f64; 3]| LoadFriction { driving, driven, rounding };
        let element =
            |[stiffness, limit, recoil, rounding]: [f64; 4]| FrictionElement { stiffness, limit, recoil, rounding };
        let elements = d.hysteresis.into_iter().map(element);
        let harmonics =
            d.ripple.into_iter().map(|[amplitude, frequency, phase]| Harmonic { amplitude, frequency, phase });
        Ok(Self {
            elastic: d.elastic,
            stiffness: d.stiffness,
            damping: d.damping,
            motor_inertia: d.motor_inertia,
            cubic_stiffness: d.cubic_stiffness,
            soft_windup: SoftWindup { stiffness: d.soft_windup_stiffness, shape: d.soft_windup_shape },
            curve,
            backlash: Backlash { half_gap, slope, rounding },
            hysteresis: Hysteresis { elements: elements.collect() },
            ripple: Ripple::new(harmonics.collect()),
            encoder_lines: d.encoder_lines,
            motor_friction: Friction {
                viscous: d.friction_viscous,
                coulomb: d.friction_coulomb,
                stribeck: d.friction_stribeck,
                stribeck_velocity: d.friction_stribeck_velocity,
                asymmetry: d.friction_asymmetry,
            },
            gear_loss: load_friction(d.gear_loss),
            link_friction: d.link_friction,
            bearing_friction: Friction { viscous, coulomb, stribeck, stribeck_velocity, asymmetry },
            bearing_loss: load_friction(d.bearing_loss),
        })
    }
}

impl Balance {
    fn counterbalance(self) -> Counterbalance {
        let anchor =
            |&(body, point): &(isize, [f64; 3])| Anchor { body: usize::try_from(body).ok(), point: vec3(point) };
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
        let harmonic = |(order, cosine, sine)| TorqueHarmonic { order, cosine, sine };
        let series = TorqueSeries(self.series.into_iter().map(harmonic).collect());
        Counterbalance::Turning { joints: self.joints, series }
    }
}

impl Sensor {
    fn place(self, kind: &str, tree: &Tree) -> Result<robot::Sensor, RobotError> {
        let frame = tree.frame(kind, self.body, &mat3(self.rotation), &vec3(self.translation))?;
        Ok(robot::Sensor { frame, axes: self.axes, noise_std: self.noise_std })
    }
}

/// A robot flattened for the kernels.
#[pyclass(frozen, module = "linkside._core")]
pub(crate) struct Robot(pub(crate) Arc<robot::Robot>);

type Input<'py> = PyReadonlyArray2<'py, f64>;
type Output<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

#[pymethods]
impl Robot {
    #[new]
    fn new(
        gravity: [f64; 3],
        bodies: Vec<Body>,
        drives: Vec<Drive>,
        coupling: Input<'_>,
        accelerometers: Vec<Sensor>,
        gyroscopes: Vec<Sensor>,
        tool: Option<Tool>,
        rotors: Vec<RotorPlace>,
        counterbalances: Vec<Balance>,
        gearing: (Vec<usize>, Vec<f64>),
        followers: Vec<(usize, f64, f64)>,
    ) -> PyResult<Self> {
        let coupling = rows("coupling", &coupling, drives.len())?.to_vec();
        let specs: Vec<BodySpec> = bodies.into_iter().map(Body::spec).collect();
        let build = || {
            let tree = Tree::new(vec3(gravity), &specs)?.with_followers(&followers)?;
            let place = |kind, sensors: Vec<Sensor>| -> Result<Vec<_>, _> {
                sensors.into_iter().map(|s| s.place(kind, &tree)).collect()
            };
            let accelerometers = place("accelerometer", accelerometers)?;
            let gyroscopes = place("gyroscope", gyroscopes)?;
            let tool = tool.map(|t| tree.frame("tool", t.body, &mat3(t.rotation), &vec3(t.translation))).transpose()?;
            let drives = drives.into_iter().map(TryInto::try_into).collect::<Result<_, _>>()?;
            let rotors =
                rotors.into_iter().map(|r| Rotor { motor: r.motor, body: r.body, axis: vec3(r.axis), ratio: r.ratio });
            let counterbalances: Vec<_> = counterbalances.into_iter().map(Balance::counterbalance).collect();
            robot::Robot::new(tree, drives, coupling, accelerometers, gyroscopes, tool)?
                .with_counterbalances(&counterbalances)?
                .with_rotors(rotors.collect())?
                .with_gearing(gearing.0, &gearing.1)
        };
        let checked = |robot| check_inertia(&robot).map(|()| Self(Arc::new(robot)));
        build().and_then(checked).map_err(IntoPyErr::into_py_err)
    }

    /// Number of joints.
    #[getter]
    fn n(&self) -> usize {
        self.0.len()
    }

    fn inverse_dynamics<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &ddq, [self.0.len()], Batch::inverse_dynamics)
    }

    fn forward_dynamics<'py>(
        &self,
        q: Input<'py>,
        dq: Input<'py>,
        theta: Input<'py>,
        dtheta: Input<'py>,
        tau: Input<'py>,
    ) -> Output<'py> {
        let n = self.0.len();
        let count = q.shape()[0];
        let states = DrivenStates {
            q: rows("q", &q, n)?,
            dq: counted("dq", &dq, n, count)?,
            theta: counted("theta", &theta, n, count)?,
            dtheta: counted("dtheta", &dtheta, n, count)?,
            tau: counted("tau", &tau, n, count)?,
        };
        self.over(&q, [2, n], |batch, out| batch.forward_dynamics(states, out))
    }

    fn coriolis_matrix<'py>(&self, q: Input<'py>, dq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &dq, [self.0.len(); 2], Batch::coriolis_matrix)
    }

    fn inverse_dynamics_derivatives<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        let n = self.0.len();
        self.states(&q, &dq, &ddq, [3, n, n], Batch::inverse_dynamics_derivatives)
    }

    fn specific_force<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &ddq, [self.0.acceleration_channels()], Batch::specific_force)
    }

    fn specific_force_derivatives<'py>(&self, q: Input<'py>, dq: Input<'py>, ddq: Input<'py>) -> Output<'py> {
        let shape = [3, self.0.acceleration_channels(), self.0.len()];
        self.states(&q, &dq, &ddq, shape, Batch::specific_force_derivatives)
    }

    fn angular_rate<'py>(&self, q: Input<'py>, dq: Input<'py>) -> Output<'py> {
        self.states(&q, &dq, &dq, [self.0.gyroscope_channels()], Batch::angular_rate)
    }

    fn mass_matrix<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [self.0.len(); 2], Batch::mass_matrix)
    }

    fn gravity_torque<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [self.0.len()], Batch::gravity_torque)
    }

    fn link_friction<'py>(&self, dq: Input<'py>, load: Input<'py>) -> Output<'py> {
        let n = self.0.len();
        let (velocities, load) = (rows("dq", &dq, n)?, counted("load", &load, n, dq.shape()[0])?);
        self.over(&dq, [n], |batch, out| batch.link_friction(velocities, load, out))
    }

    fn motor_friction<'py>(&self, dtheta: Input<'py>, load: Input<'py>) -> Output<'py> {
        let n = self.0.len();
        let (velocities, load) = (rows("dtheta", &dtheta, n)?, counted("load", &load, n, dtheta.shape()[0])?);
        self.over(&dtheta, [n], |batch, out| batch.motor_friction(velocities, load, out))
    }

    fn tool_position<'py>(&self, q: Input<'py>) -> Output<'py> {
        self.positions(&q, [3], Batch::tool_position)
    }
}

impl Robot {
    /// Runs `f` over the rows of a state; the output has one array of `shape` a row.
    fn states<'a, 'py, const D: usize>(
        &'a self,
        q: &Input<'py>,
        dq: &Input<'py>,
        ddq: &Input<'py>,
        shape: [usize; D],
        f: impl FnOnce(&mut Batch<'a>, States<'_>, &mut [f64]) + Send,
    ) -> Output<'py> {
        let n = self.0.len();
        // One row of velocities or accelerations is that of all samples.
        let height = |array: &Input<'py>| if array.shape()[0] == 1 { 1 } else { q.shape()[0] };
        let (dq, ddq) = (counted("dq", dq, n, height(dq))?, counted("ddq", ddq, n, height(ddq))?);
        let states = States { q: rows("q", q, n)?, dq, ddq };
        self.over(q, shape, |batch, out| f(batch, states, out))
    }

    /// As [`states`](Self::states), for what depends on positions alone.
    fn positions<'a, 'py, const D: usize>(
        &'a self,
        q: &Input<'py>,
        shape: [usize; D],
        f: impl FnOnce(&mut Batch<'a>, &[f64], &mut [f64]) + Send,
    ) -> Output<'py> {
        let positions = rows("q", q, self.0.len())?;
        self.over(q, shape, |batch, out| f(batch, positions, out))
    }

    fn over<'a, 'py, const D: usize>(
        &'a self,
        q: &Input<'py>,
        shape: [usize; D],
        f: impl FnOnce(&mut Batch<'a>, &mut [f64]) + Send,
    ) -> Output<'py> {
        let (py, count) = (q.py(), q.shape()[0]);
        let values = py.release(|| {
            let mut out = memory::filled(0.0, count, shape.iter().product())?;
            f(&mut Batch::new(&self.0), &mut out);
            Ok::<_, DesignError>(out)
        })?;
        let shape: Vec<usize> = core::iter::once(count).chain(shape).collect();
        shaped(py, values, shape)
    }
}
