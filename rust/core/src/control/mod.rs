//! Torques that make a robot with elastic joints do what is wanted.

pub mod feedforward;
mod transmission;
