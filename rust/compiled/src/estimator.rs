//! An estimator at work.

use crate::description::{BuildError, Description, Method, Observer, Velocity, kinds};
use crate::fields::Fields;
use crate::file::FileError;
use crate::filter::Filter;
use crate::sample::{Sample, Signal};
use linkside_core::error::{DesignError, RunError};
use linkside_core::estimate::kalman::{ElasticModel, JerkDriven, Model};
use linkside_core::estimate::observer::{AccelerationObserver, ObserverSample};
use linkside_core::estimate::velocity::VelocityObserver;
use linkside_core::robot::Robot;
use linkside_core::simd;
use std::path::Path;
use std::sync::Arc;

/// Any estimator that a file can hold, sample by sample, with the bits that Python gets from it.
///
/// After it has been made, nothing allocates, asks the operating system or waits.
///
/// ```
/// use linkside_compiled::{Estimator, Sample};
///
/// # let bytes = linkside_compiled::demo::observer().to_bytes();
/// # let path = std::env::temp_dir().join("linkside-doc.lsr");
/// # std::fs::write(&path, bytes)?;
/// let mut estimator = Estimator::read(&path)?; // of `linkside compile robot.yaml --out robot.lsr`
/// for _ in 0..100 {
///     let sample = Sample { theta: &[0.1], tau: &[0.0], acceleration: &[0.0, 0.0, 9.81], ..Sample::default() };
///     estimator.step(&sample)?;
/// }
/// let q = estimator.get("q").expect("all estimate link positions");
/// assert!((q[0] - 0.1).abs() < 1e-9 && estimator.status() == 0);
/// # std::fs::remove_file(&path)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Estimator {
    robot: Arc<Robot>,
    description: Description,
    method: Working,
    fields: Fields,
    status: u8,
}

#[derive(Clone, Debug)]
enum Working {
    Observer(Box<AccelerationObserver>),
    Ekf(Box<Filter<JerkDriven>>),
    ElasticEkf(Box<Filter<ElasticModel>>),
    Velocity(Box<VelocityObserver>),
}

/// As many motor positions and velocities as a robot may have joints.
type Joints = [f64; crate::description::MOST_PARTS];

impl Estimator {
    /// Reads a file, with all checks.
    ///
    /// # Errors
    /// A file that cannot be read, that is damaged or of another version, or whose content fits no robot.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, FileError> {
        Ok(Self::new(Description::read(path)?)?)
    }

    /// The same of the bytes of a file.
    ///
    /// # Errors
    /// Likewise.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FileError> {
        Ok(Self::new(Description::from_bytes(bytes)?)?)
    }

    /// Builds what a description says.
    ///
    /// # Errors
    /// A description of nothing that can be built.
    pub fn new(description: Description) -> Result<Self, BuildError> {
        let robot = Arc::new(description.robot.build()?);
        let names = [
            ("joints", description.joints.len(), robot.len()),
            ("accelerometer channels", description.accelerations.len(), robot.acceleration_channels()),
            ("gyroscope channels", description.rates.len(), robot.gyroscope_channels()),
        ];
        for (what, found, expected) in names {
            if found != expected {
                return Err(BuildError::Names { what, found, expected });
            }
        }
        let method = match &description.estimator {
            Method::Observer(settings) => Working::Observer(Box::new(settings.build(&robot)?)),
            Method::Ekf(settings) => {
                Working::Ekf(Box::new(Filter::new(settings.build(&robot)?, &kinds(&settings.kinds)?)?))
            }
            Method::ElasticEkf(settings) => {
                Working::ElasticEkf(Box::new(Filter::new(settings.build(&robot)?, &kinds(&settings.kinds)?)?))
            }
            Method::Velocity(settings) => Working::Velocity(Box::new(settings.build(&robot)?)),
        };
        simd::level(); // asks the environment once, here and not in a step
        let fields = fields(&method, &robot);
        Ok(Self { robot, description, method, fields, status: 0 })
    }

    /// The robot.
    pub fn robot(&self) -> &Arc<Robot> {
        &self.robot
    }

    /// What it was made of.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// As the command line calls it.
    pub fn method(&self) -> &'static str {
        match self.method {
            Working::Observer(_) => "observer",
            Working::Ekf(_) => "ekf",
            Working::ElasticEkf(_) => "elastic-ekf",
            Working::Velocity(_) => "velocity",
        }
    }

    /// The sampling period that an observer was designed for [s]; filters take any.
    pub fn period(&self) -> Option<f64> {
        match &self.description.estimator {
            Method::Observer(Observer { period, .. }) | Method::Velocity(Velocity { period, .. }) => Some(*period),
            _ => None,
        }
    }

    /// How many entries of `signal` a sample has; 0 where it is not read.
    pub fn width(&self, signal: Signal) -> usize {
        let n = self.robot.len();
        match &self.method {
            Working::Observer(observer) => match signal {
                Signal::Theta | Signal::Tau => n,
                Signal::Acceleration if self.is_of_sensors() => observer.channels(),
                Signal::Ddq if !self.is_of_sensors() => n,
                _ => 0,
            },
            Working::Ekf(filter) => filter.width(signal),
            Working::ElasticEkf(filter) => filter.width(signal),
            Working::Velocity(observer) => {
                let [position, torque] = velocity_signals(observer);
                if signal == position || signal == torque { n } else { 0 }
            }
        }
    }

    /// Takes one sample; afterwards [`get`](Self::get) gives the estimate at its time.
    ///
    /// # Errors
    /// A sample that cannot be used, after which everything is as before it. [`RunError::NotFinite`] and
    /// [`RunError::SingularInertia`]: readings so extreme that no estimate is left; the next sample starts again.
    pub fn step(&mut self, sample: &Sample<'_>) -> Result<(), RunError> {
        let of_sensors = self.is_of_sensors();
        match &mut self.method {
            Working::Observer(observer) => {
                let acceleration = if of_sensors { sample.acceleration } else { sample.ddq };
                let Sample { theta, tau, .. } = *sample;
                observer.step(ObserverSample { theta, tau, acceleration })?;
            }
            Working::Ekf(filter) => filter.step(sample)?,
            Working::ElasticEkf(filter) => filter.step(sample)?,
            Working::Velocity(observer) => {
                let (signals, n) = (velocity_signals(observer), observer.joints());
                let [position, torque] = signals.map(|signal| signal.checked(sample, n));
                observer.step(position?, torque?)?;
            }
        }
        self.write();
        Ok(())
    }

    /// Forgets all samples: the next one starts again.
    #[expect(clippy::expect_used, reason = "the same settings began when it was made")]
    pub fn reset(&mut self) {
        match (&mut self.method, &self.description.estimator) {
            (Working::Observer(observer), Method::Observer(settings)) => {
                observer.reset();
                settings.begin(observer).expect("it has begun so before");
            }
            (Working::Velocity(observer), Method::Velocity(settings)) => {
                observer.reset();
                settings.begin(observer).expect("it has begun so before");
            }
            (Working::Ekf(filter), _) => filter.reset(),
            (Working::ElasticEkf(filter), _) => filter.reset(),
            _ => {}
        }
        self.fields.clear();
        self.status = 0;
    }

    /// Names of what [`get`](Self::get) gives.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.fields.names()
    }

    /// A part of the estimate at the last sample, as a column of an estimate is called: `q`, `dq`, `q_std`, `tool_position`,
    /// `nis`, `state` and others; NaN before there is one. It stays where it is in memory.
    pub fn get(&self, name: &str) -> Option<&[f64]> {
        self.fields.get(name)
    }

    /// See [`Status`](linkside_core::estimate::Status).
    pub fn status(&self) -> u8 {
        self.status
    }

    /// Number of states of a filter; 0 of an observer, which knows no covariance.
    pub fn states(&self) -> usize {
        match &self.method {
            Working::Ekf(filter) => filter.core.model().states(),
            Working::ElasticEkf(filter) => filter.core.model().states(),
            _ => 0,
        }
    }

    /// Covariance of the state after the last sample, row-major (states × states).
    ///
    /// # Errors
    /// Another length.
    pub fn covariance_into(&mut self, out: &mut [f64]) -> Result<(), DesignError> {
        match &mut self.method {
            Working::Ekf(filter) => filter.core.covariance_into(out),
            Working::ElasticEkf(filter) => filter.core.covariance_into(out),
            _ if out.is_empty() => Ok(()),
            _ => Err(DesignError::Length { what: "covariance", found: out.len(), expected: 0 }),
        }
    }

    fn is_of_sensors(&self) -> bool {
        !matches!(&self.description.estimator, Method::Observer(Observer { joint_accelerations: true, .. }))
    }

    /// The estimate into its fields.
    fn write(&mut self) {
        let Self { method, fields, status, .. } = self;
        let tool = usize::from(self.robot.tool.is_some()) * 3;
        match method {
            Working::Observer(observer) => {
                let n = observer.joints();
                let (mut theta, mut dtheta): (Joints, Joints) = ([0.0; _], [0.0; _]);
                for (j, (theta, dtheta)) in theta.iter_mut().zip(&mut dtheta).take(n).enumerate() {
                    (*theta, *dtheta) = observer.motor(j);
                }
                let links = [&[observer.time()][..], observer.q(), observer.dq(), observer.ddq()];
                let motors = [&theta[..n], &dtheta[..n], &observer.tool()[..tool]];
                let deviations =
                    [observer.q_std(), &observer.tool_std()[..if observer.q_std().is_empty() { 0 } else { tool }]];
                fields.fill(links.into_iter().chain(motors).chain(deviations));
                *status = observer.status();
            }
            Working::Velocity(observer) => {
                let (t, level, place) = ([observer.time()], [observer.level() as f64], observer.tool());
                let links = [&t[..], observer.q(), observer.dq(), observer.ddq()];
                let motors = [observer.q(), observer.dq()].map(|x| if observer.is_of_motors() { x } else { &[] });
                fields.fill(links.into_iter().chain(motors).chain([&place[..tool], &level]));
                *status = observer.status();
            }
            Working::Ekf(filter) => {
                filter.write(fields);
                *status = filter.status();
            }
            Working::ElasticEkf(filter) => {
                filter.write(fields);
                *status = filter.status();
            }
        }
    }
}

/// Positions and torques: the log's of motors or of links.
fn velocity_signals(observer: &VelocityObserver) -> [Signal; 2] {
    if observer.is_of_motors() { [Signal::Theta, Signal::Tau] } else { [Signal::Q, Signal::Torque] }
}

/// Fields in the order in which [`Estimator::write`] fills them.
fn fields(method: &Working, robot: &Robot) -> Fields {
    let (mut fields, n) = (Fields::default(), robot.len());
    let (motors, level, deviating) = match method {
        Working::Ekf(filter) => {
            filter.fields(&mut fields);
            return fields;
        }
        Working::ElasticEkf(filter) => {
            filter.fields(&mut fields);
            return fields;
        }
        Working::Observer(observer) => (n, 0, usize::from(!observer.q_std().is_empty())),
        Working::Velocity(observer) => (if observer.is_of_motors() { n } else { 0 }, 1, 0),
    };
    let tool = usize::from(robot.tool.is_some()) * 3;
    let widths = [("t", 1), ("q", n), ("dq", n), ("ddq", n), ("theta", motors), ("dtheta", motors)];
    let rest = [("tool_position", tool), ("level", level), ("q_std", n * deviating), ("tool_std", tool * deviating)];
    for (name, width) in widths.into_iter().chain(rest) {
        fields.add(name, width);
    }
    fields
}
