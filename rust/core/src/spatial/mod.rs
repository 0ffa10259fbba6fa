//! Three-vectors, rotations and spatial (six-dimensional) quantities, all in one frame: the robot's base.
//!
//! A spatial vector at the base origin pairs an angular and a linear part (Featherstone 2008). Keeping every body's
//! quantities in the same frame makes composites plain sums, and lets derivatives be read off as in Singh, Russell
//! and Wensing (2022).

mod inertia;
mod mat3;
mod motion;
mod vec3;

pub use inertia::{Coriolis, Inertia};
pub use mat3::{Mat3, Sym3};
pub use motion::{Force, Motion};
pub use vec3::Vec3;
