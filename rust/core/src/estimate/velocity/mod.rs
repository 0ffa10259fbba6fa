//! Velocity observers for rigid robots, from positions and torques.
//!
//! The reduced-order observer of Cristofaro and De Luca (2023) and, with a spring on the position error, the full-order
//! one of Nicosia and Tomei (1990). In terms of the estimate x̂₂ itself and with the robot's model
//! a(y, v) = M⁻¹(τ − C(y, v) v − friction − g), both are
//!
//! x̂₂' = a(y, x̂₂) + M⁻¹ K_P ỹ + K (ẏ − x̂₂),  ỹ' = ẏ − x̂₂,
//!
//! where the reduced-order observer has K_P = 0 and its K may depend on the posture. In this form a gain may jump without a
//! jump of the estimate.
//!
//! | part | where |
//! | --- | --- |
//! | a(y, v), and the inertia's factors | `rigid` |
//! | K that jumps with the estimated speed | [`Schedule`] |
//! | K that depends on the posture | [`GainMap`] |
//! | wraps and missing positions | `encoder` |

mod encoder;
mod map;
mod observer;
mod rigid;
mod run;
mod schedule;
mod settings;

pub use map::GainMap;
pub use observer::VelocityObserver;
pub use run::{VelocityOutput, VelocityRecording};
pub use schedule::{Logic, Schedule};
pub use settings::{FASTEST, Gains, VelocitySettings};
