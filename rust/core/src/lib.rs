//! Link-side state estimation for robots with elastic joints.
//!
//! | symbol | meaning | unit |
//! | --- | --- | --- |
//! | q, q̇, q̈ | link side | rad, or m where prismatic |
//! | θ, θ̇ | motor side, reflected through the gear to the link side | rad |
//! | τ | motor torque, likewise reflected | N m |
//! | K, D, B | stiffness, damping, motor inertia of a drive | N m/rad, N m s/rad, kg m² |
//! | S | inertial coupling of motors to links, strictly upper triangular | kg m² |
//! | M, C, g | links' inertia, Coriolis matrix (Christoffel), gravity torque | |
//!
//! From bottom to top: [`scalar`] numbers, [`spatial`] algebra, the [`robot`], its [`dynamics`], what is
//! [`estimate`]d with them, and [`control`]. The crate knows nothing of Python, allocates nothing in a step and does not panic there.

mod check;
pub mod control;
pub mod dynamics;
pub mod error;
pub mod estimate;
pub mod interrupt;
mod linear;
mod lu;
pub mod memory;
pub mod parallel;
mod random;
pub mod robot;
pub mod scalar;
pub mod simd;
pub mod simulate;
pub mod spatial;
