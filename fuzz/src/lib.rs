//! Targets: each takes any bytes, and panics where linkside does what it must not.
//!
//! libFuzzer drives them (`fuzz_targets`), and on every submission `tests/rust/corpus.rs` with the corpus.

pub mod bags;
mod bytes;
pub mod c_calls;
pub mod calls;
pub mod compiled;
pub mod dynamics;
pub mod runs;

/// A target: takes any bytes.
pub type Target = fn(&[u8]);

/// Every target, by its name.
pub const TARGETS: [(&str, Target); 16] = [
    ("mcap", bags::mcap),
    ("definition", bags::definition),
    ("cdr", bags::cdr),
    ("compressed", bags::compressed),
    ("compiled_file", compiled::compiled_file),
    ("compiled_content", compiled::compiled_content),
    ("description", compiled::description),
    ("step_observer", calls::step_observer),
    ("step_ekf", calls::step_ekf),
    ("step_elastic", calls::step_elastic),
    ("step_velocity", calls::step_velocity),
    ("run_filter", runs::run_filter),
    ("run_smoother", runs::run_smoother),
    ("run_particles", runs::run_particles),
    ("dynamics", dynamics::dynamics),
    ("c_interface", c_calls::c_interface),
];
