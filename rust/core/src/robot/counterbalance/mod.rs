//! What carries part of a robot's weight without a motor: springs and gas springs between two points, torques by an angle.
//!
//! All of them are potentials of the links' positions: what they give joints joins the gravity torque, and its slopes those of
//! gravity, wherever either is asked for.

mod strut;
mod torque_series;

pub use strut::{GasSpring, Strut};
pub(crate) use torque_series::add_angles;
pub use torque_series::{TorqueHarmonic, TorqueSeries};

use super::tree::Body;
use super::{JointKind, Robot, Tree};
use crate::check::expect_of;
use crate::error::RobotError;
use crate::spatial::Vec3;

/// A point that a link or the base carries.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchor {
    /// Which body; none for the base.
    pub body: Option<usize>,
    /// Where in the modeller's frame of that body [m].
    pub point: Vec3<f64>,
}

/// A torque on links from their positions alone.
///
/// ```
/// use linkside_core::dynamics::{Batch, States};
/// use linkside_core::robot::{Anchor, Counterbalance, Strut};
/// use linkside_core::spatial::Vec3;
///
/// let ends = [(None, [0.0, 0.5, 0.0]), (Some(0), [0.2, 0.0, 0.0])].map(|(body, p)| Anchor { body, point: Vec3(p) });
/// let strut = Strut::Spring { stiffness: 1e3, length: 0.0 }; // of no length where it is slack, it pulls by 1e3 N/m
/// let robot = linkside_core::demo::arm()?.with_counterbalances(&[Counterbalance::Between { ends, strut }])?;
/// let mut torque = [0.0];
/// Batch::new(robot.into()).gravity_torque(&[0.0], &mut torque);
/// assert!((torque[0] + 1e3 * 0.5 * 0.2).abs() < 1e-12); // it helps the joint along
/// # Ok::<(), linkside_core::error::RobotError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum Counterbalance {
    /// Pulls or pushes two points.
    Between {
        /// The points.
        ends: [Anchor; 2],
        /// Its force.
        strut: Strut,
    },
    /// Turns joints by the sum of their angles: the angle between two links where axes are parallel.
    Turning {
        /// Which joints.
        joints: Vec<usize>,
        /// The torque that it gives each.
        series: TorqueSeries,
    },
}

/// The same ready for the kernels.
#[derive(Clone, Debug)]
pub(crate) enum Support {
    Between(Linkage),
    /// Bodies that the joints move.
    Turning {
        bodies: Vec<usize>,
        series: TorqueSeries,
    },
}

/// Two points, and the chains of bodies that carry them from where they part.
#[derive(Clone, Debug)]
pub(crate) struct Linkage {
    /// The last body that carries both; none for the base.
    pub(crate) stem: Option<usize>,
    pub(crate) branches: [Branch; 2],
    pub(crate) strut: Strut,
}

/// Bodies from the stem outwards, and a point in the frame of the last, of the stem where there is none.
#[derive(Clone, Debug)]
pub(crate) struct Branch {
    pub(crate) bodies: Vec<usize>,
    pub(crate) point: Vec3<f64>,
}

impl Robot {
    /// The same robot with `counterbalances`.
    ///
    /// # Errors
    /// A body or a joint that does not exist, two points on one body, a joint that slides or comes twice, a force out of range.
    pub fn with_counterbalances(self, counterbalances: &[Counterbalance]) -> Result<Self, RobotError> {
        Ok(Self { tree: self.tree.with_counterbalances(counterbalances)?, ..self })
    }
}

impl Tree {
    /// See [`Robot::with_counterbalances`].
    ///
    /// # Errors
    /// Likewise.
    pub fn with_counterbalances(mut self, counterbalances: &[Counterbalance]) -> Result<Self, RobotError> {
        let compile = |(i, one): (usize, &Counterbalance)| self.support(&format!("counterbalance {i}"), one);
        self.supports = counterbalances.iter().enumerate().map(compile).collect::<Result<_, _>>()?;
        Ok(self)
    }

    fn support(&self, owner: &str, counterbalance: &Counterbalance) -> Result<Support, RobotError> {
        match counterbalance {
            Counterbalance::Between { ends, strut } => {
                strut.check(owner)?;
                self.linkage(owner, ends, *strut).map(Support::Between)
            }
            Counterbalance::Turning { joints, series } => {
                series.check(owner)?;
                let bodies = joints.iter().enumerate().map(|(k, &joint)| {
                    let turns = |b: &Body| b.joint == joint && b.following.is_none() && b.kind == JointKind::Revolute;
                    let body = self.bodies.iter().position(turns);
                    let ok = body.is_some() && !joints[..k].contains(&joint);
                    expect_of(ok, "joint", || owner.into(), joint as f64, "one that turns, once")?;
                    Ok(body.unwrap_or_default())
                });
                Ok(Support::Turning { bodies: bodies.collect::<Result<_, _>>()?, series: series.clone() })
            }
        }
    }

    fn linkage(&self, owner: &str, ends: &[Anchor; 2], strut: Strut) -> Result<Linkage, RobotError> {
        let count = self.bodies.len();
        let mut paths = [vec![], vec![]];
        for (path, end) in paths.iter_mut().zip(ends) {
            let sum: f64 = end.point.0.iter().sum();
            expect_of(sum.is_finite(), "point", || owner.into(), sum, "finite numbers")?;
            let Some(body) = end.body else { continue };
            if body >= count {
                return Err(RobotError::Body { owner: owner.into(), body, count });
            }
            path.extend(self.path(body));
            path.reverse();
        }
        let shared = paths[0].iter().zip(&paths[1]).take_while(|(a, b)| a == b).count();
        let stem = shared.checked_sub(1).map(|last| paths[0][last]);
        let moved = paths.iter().any(|path| path.len() > shared);
        expect_of(moved, "length", || owner.into(), 0.0, "one that changes: both of its points are on one link")?;
        let mut branch = |k: usize| Branch {
            bodies: paths[k].split_off(shared),
            point: ends[k].body.map_or(ends[k].point, |body| self.bodies[body].align.apply(&ends[k].point)),
        };
        Ok(Linkage { stem, branches: [branch(0), branch(1)], strut })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(counterbalance: Counterbalance) -> String {
        crate::demo::arm().unwrap().with_counterbalances(&[counterbalance]).unwrap_err().to_string()
    }

    #[test]
    fn counterbalances_that_cannot_be_are_refused() {
        let point = |body| Anchor { body, point: Vec3([0.1, 0.0, 0.0]) };
        let strut = Strut::Spring { stiffness: 1e3, length: 0.1 };
        let between = |a, b| refused(Counterbalance::Between { ends: [point(a), point(b)], strut });
        assert!(between(Some(0), Some(0)).contains("both of its points are on one link"));
        assert!(between(None, None).contains("both of its points are on one link"));
        assert!(between(None, Some(3)).starts_with("counterbalance 0 is on body 3, there are 1"));
        let turning = |joints: &[usize], order| {
            let series = TorqueSeries(vec![TorqueHarmonic { order, cosine: 1.0, sine: 0.0 }]);
            refused(Counterbalance::Turning { joints: joints.to_vec(), series })
        };
        assert!(turning(&[0, 0], 1).starts_with("joint of counterbalance 0 is 0, expected one that turns, once"));
        assert!(turning(&[1], 1).starts_with("joint of counterbalance 0 is 1"));
        assert!(turning(&[0], 101).contains("at most 100"));
    }
}
