//! Three-vectors, rotations and spatial (six-dimensional) quantities, all in one frame: the robot's base.
//!
//! A spatial vector at the base origin pairs an angular and a linear part (Featherstone 2008). Keeping every body's
//! quantities in the same frame makes composites plain sums, and lets derivatives be read off as in Singh, Russell
//! and Wensing (2022).
//!
//! | type | numbers | is |
//! | --- | --- | --- |
//! | [`Vec3`], [`Mat3`], [`Sym3`] | 3, 9, 6 | vectors, rotations, symmetric matrices |
//! | [`Motion`] | 6 | twist, spatial acceleration, joint axis |
//! | [`Force`] | 6 | wrench, momentum |
//! | [`Inertia`] | 10 | moments of mass: ∫dm, ∫r dm, ∫r rᵀ dm |
//! | [`Coriolis`] | 12 | what a moving mass does to a turning frame |

mod fixed;
mod inertia;
mod mat3;
mod motion;
mod vec3;

pub(crate) use fixed::FixedRotation;
pub use inertia::{Coriolis, Inertia};
pub use mat3::{Mat3, Sym3};
pub use motion::{Force, Motion};
pub use vec3::Vec3;
