//! Scenarios that Rust, Python and C read alike: what an estimator is given, and what it must answer to the last bit.

use linkside_compiled::{Estimator, Sample, Signal};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().map_or(&[][..], |list| list).iter().map(number).collect()
}

/// A number of its bits in hexadecimal digits.
fn number(value: &Value) -> f64 {
    f64::from_bits(u64::from_str_radix(value.as_str().unwrap(), 16).unwrap())
}

/// Bits, every NaN the same.
fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| if x.is_nan() { f64::NAN.to_bits() } else { x.to_bits() }).collect()
}

#[test]
fn answers_are_the_same_to_the_last_bit() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
    let mut steps = 0;
    for entry in fs::read_dir(data.join("scenarios")).unwrap() {
        let scenario: Value = serde_json::from_slice(&fs::read(entry.unwrap().path()).unwrap()).unwrap();
        let file = data.join("compiled").join(scenario["estimator"].as_str().unwrap());
        let mut estimator = Estimator::read(file).unwrap();
        let pairs = scenario["steps"].as_array().unwrap().iter().zip(scenario["answers"].as_array().unwrap());
        for (index, (given, answer)) in pairs.enumerate() {
            if given["reset"] == true {
                estimator.reset();
            }
            let signals = Signal::ALL.map(|signal| numbers(&given["signals"][signal.name()]));
            let [theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position] = &signals;
            let dt = number(&given["dt"]);
            let sample =
                Sample { dt, theta, dtheta, tau, acceleration, rate, q, dq, ddq, torque, ddqref, wrench, position };
            let taken = estimator.step(&sample).is_ok();
            assert_eq!(answer["taken"], taken, "{} step {index}", estimator.method());
            if taken {
                assert_eq!(answer["status"], estimator.status());
                for name in ["t", "q", "dq", "ddq", "theta", "dtheta", "q_std", "tool_position", "tool_std", "nis"] {
                    let found = estimator.get(name).unwrap_or(&[]);
                    assert_eq!(bits(found), bits(&numbers(&answer[name])), "{} {name} {index}", estimator.method());
                }
            }
            steps += 1;
        }
    }
    assert_eq!(steps, 240);
}
