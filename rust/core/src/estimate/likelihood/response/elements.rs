//! Friction elements beside the springs: they remember their way, and so do their derivatives.

use super::super::parameters::{Parameter, Parameters};
use crate::robot::{FrictionElement, Moved, Robot};

/// One element, as it was left at the last sample.
#[derive(Clone, Debug)]
struct Element {
    joint: usize,
    law: FrictionElement,
    /// Which of the free parameters are its stiffness and its limit.
    free: [Option<usize>; 2],
    /// z, and the torsion of its joint [rad].
    left: f64,
    torsion: f64,
    /// Derivatives of z and of the link's position (width).
    slopes: Vec<f64>,
    link: Vec<f64>,
}

/// All elements of a robot.
#[derive(Clone, Debug)]
pub(super) struct Elements {
    each: Vec<Element>,
    /// Whether torsions are those at which elements were left: what was then found of them is part of the state. Else
    /// they follow the torsion from there, within one step, as if it did not turn on the way.
    pub(super) still: bool,
}

impl Element {
    /// After its way to `torsion`, and ∂z/∂w, w being its reach: z is homogeneous in where it was, its step, and that.
    fn moved(&self, torsion: f64, still: bool) -> (Moved, f64) {
        if still {
            return (Moved { deflection: self.left, slope: 0.0, bend: 0.0, fading: 1.0 }, 0.0);
        }
        let step = torsion - self.torsion;
        let moved = self.law.moved(self.left, step);
        (moved, (moved.deflection - self.left * moved.fading - step * moved.slope) / self.law.reach())
    }

    /// Derivatives of z in its stiffness and its limit, by that in its reach.
    fn by_size(&self, by_reach: f64) -> [f64; 2] {
        [-by_reach * self.law.reach() / self.law.stiffness, by_reach / self.law.stiffness]
    }
}

impl Elements {
    /// Relaxed; with `width` derivatives, of which those in the parameters `free` come first.
    pub(super) fn new(robot: &Robot, parameters: &Parameters<f64>, free: &[Parameter], width: usize) -> Self {
        let index = |wanted: Parameter| free.iter().position(|&parameter| parameter == wanted);
        let of_joint = |(joint, sizes): (usize, &Vec<[f64; 2]>)| {
            let laws = robot.drives[joint].hysteresis.elements.iter().zip(sizes.clone()).enumerate();
            let element = move |(i, (law, [stiffness, limit])): (usize, (&FrictionElement, [f64; 2]))| Element {
                joint,
                law: FrictionElement { stiffness, limit, ..*law },
                free: [index(Parameter::ElementStiffness(joint, i)), index(Parameter::ElementLimit(joint, i))],
                left: 0.0,
                torsion: 0.0,
                slopes: vec![0.0; width],
                link: vec![0.0; width],
            };
            laws.map(element).collect::<Vec<_>>()
        };
        Self { each: parameters.elements.iter().enumerate().flat_map(of_joint).collect(), still: true }
    }

    /// Torque of joint `j`'s elements on its link, and its slope in the torsion.
    pub(super) fn torque(&self, j: usize, torsion: f64) -> [f64; 2] {
        let own = self.each.iter().filter(|element| element.joint == j);
        own.fold([0.0; 2], |[torque, slope], element| {
            let (moved, _) = element.moved(torsion, self.still);
            [torque + element.law.stiffness * moved.deflection, slope + element.law.stiffness * moved.slope]
        })
    }

    /// Adds `factor` times that torque's derivatives but for those by where the link is at `torsion`.
    pub(super) fn differentiate(&self, j: usize, torsion: f64, factor: f64, out: &mut [f64]) {
        for element in self.each.iter().filter(|element| element.joint == j) {
            let (moved, by_reach) = element.moved(torsion, self.still);
            let stiffness = factor * element.law.stiffness;
            for ((x, link), z) in out.iter_mut().zip(&element.link).zip(&element.slopes) {
                *x += stiffness * (moved.slope * link + moved.fading * z);
            }
            let [by_stiffness, by_limit] = element.by_size(by_reach);
            let own = [factor * moved.deflection + stiffness * by_stiffness, stiffness * by_limit];
            for (k, x) in element.free.iter().zip(own).filter_map(|(k, x)| Some(((*k)?, x))) {
                out[k] += x;
            }
        }
    }

    /// Goes on to a sample's `torsions`, the links' positions there having the derivatives `slopes` (n × width). The
    /// first is where a recording begins.
    pub(super) fn advance(&mut self, torsions: impl Fn(usize) -> f64, slopes: &[f64], first: bool) {
        for element in &mut self.each {
            let torsion = torsions(element.joint);
            let (moved, by_reach) = element.moved(torsion, first);
            let width = element.slopes.len();
            let now = &slopes[element.joint * width..][..width];
            for ((z, link), now) in element.slopes.iter_mut().zip(&mut element.link).zip(now) {
                *z = moved.slope * (*link - now) + moved.fading * *z;
                *link = *now;
            }
            let sizes = element.by_size(by_reach);
            for (k, x) in element.free.iter().zip(sizes).filter_map(|(k, x)| Some(((*k)?, x))) {
                element.slopes[k] += x;
            }
            (element.left, element.torsion) = (moved.deflection, torsion);
        }
        self.still = true;
    }
}
