//! Files of compiled robots: whole, damaged and absurd ones.

use linkside_compiled::description::{BuildError, Method};
use linkside_compiled::{Description, Estimator, FileError, Sample, Signal, VERSION, demo};

/// Files of version 1 as Python wrote them: they must stay readable.
const FILES: [&[u8]; 4] = [
    include_bytes!("../data/compiled/observer.lsr"),
    include_bytes!("../data/compiled/ekf.lsr"),
    include_bytes!("../data/compiled/elastic-ekf.lsr"),
    include_bytes!("../data/compiled/velocity.lsr"),
];

const HEAD: usize = 20;

/// The content of `file` after `change`, with a length and a checksum that are right.
fn reframed(file: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut content = file[HEAD..file.len() - 4].to_vec();
    change(&mut content);
    let mut bytes = file[..12].to_vec();
    bytes.extend((content.len() as u64).to_le_bytes());
    bytes.extend(content);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    bytes
}

/// Steps of an estimator with plain numbers for all signals that it reads.
fn steps(estimator: &mut Estimator, count: usize) -> bool {
    let numbers = vec![0.1; 4096];
    let row = |signal| &numbers[..estimator.width(signal).min(4096)];
    let sample = Sample {
        dt: 1e-3,
        theta: row(Signal::Theta),
        dtheta: row(Signal::Dtheta),
        tau: row(Signal::Tau),
        acceleration: row(Signal::Acceleration),
        torque: row(Signal::Torque),
        q: row(Signal::Q),
        ..Sample::default()
    };
    (0..count).all(|_| estimator.step(&sample).is_ok())
}

#[test]
fn files_of_this_version_are_read_and_written_again_as_they_were() {
    for (file, method) in FILES.iter().zip(["observer", "ekf", "elastic-ekf", "velocity"]) {
        let mut estimator = Estimator::from_bytes(file).unwrap();
        assert_eq!(estimator.method(), method);
        let again = estimator.description().to_bytes(); // with fields that are younger than the file
        assert_eq!(Description::from_bytes(&again).unwrap().to_bytes(), again);
        assert_eq!(estimator.description().joints, ["axis2", "axis3"]);
        assert!(estimator.get("q").unwrap().iter().all(|q| q.is_nan()));
        assert!(steps(&mut estimator, 20), "{method}");
        let first = estimator.get("q").unwrap().to_vec();
        assert!(first.iter().all(|q| q.is_finite()));
        assert!((estimator.get("t").unwrap()[0] - 0.019).abs() < 1e-12);
        estimator.reset();
        assert!(steps(&mut estimator, 20));
        assert_eq!(estimator.get("q").unwrap(), first, "{method} starts anew after a reset");
    }
}

#[test]
fn a_file_that_ends_early_or_late_is_refused() {
    for file in FILES {
        for length in 0..file.len() {
            assert!(
                matches!(Estimator::from_bytes(&file[..length]), Err(FileError::Length { found, .. }) if found == length)
            );
        }
        let longer = [file, &[0]].concat();
        assert!(matches!(Estimator::from_bytes(&longer), Err(FileError::Length { .. })));
    }
}

#[test]
fn a_flipped_bit_anywhere_is_refused() {
    for file in FILES {
        let mut bytes = file.to_vec();
        for bit in 0..8 * file.len() {
            bytes[bit / 8] ^= 1 << (bit % 8);
            match Estimator::from_bytes(&bytes) {
                Err(FileError::Foreign) => assert!(bit < 64),
                Err(FileError::Version { found }) => assert!((64..96).contains(&bit) && found != VERSION),
                Err(FileError::Length { .. }) => assert!((96..160).contains(&bit)),
                Err(FileError::Checksum) => assert!(bit >= 160),
                other => panic!("bit {bit}: {other:?}"),
            }
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
    }
}

#[test]
fn another_version_is_refused_before_anything_else_is_looked_at() {
    let mut bytes = FILES[0].to_vec();
    bytes[8..12].copy_from_slice(&7_u32.to_le_bytes());
    let error = Estimator::from_bytes(&bytes).unwrap_err();
    assert_eq!(error.to_string(), "this is version 7 of the format, expected 1: compile the robot again");
    let error = Estimator::read("/no/such.lsr").unwrap_err().to_string();
    assert!(error.starts_with("/no/such.lsr: cannot be read: "), "{error}");
}

/// Whatever is in a file whose checksum is right: it is refused, or its estimator takes samples; nothing panics.
#[test]
fn content_that_was_tampered_with_does_no_harm() {
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut draw = |below: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        (random % below as u64) as usize
    };
    let (mut read, mut built) = (0, 0);
    for round in 0..2_000 {
        let bytes = reframed(FILES[round % FILES.len()], |content| {
            for _ in 0..=draw(3) {
                let at = draw(content.len());
                match draw(4) {
                    0 => content[at] = draw(256) as u8,
                    1 => content[at] ^= 1 << draw(8),
                    2 => drop(content.remove(at)),
                    _ => content.insert(at, draw(256) as u8),
                }
            }
        });
        match Estimator::from_bytes(&bytes) {
            Ok(mut estimator) => {
                built += 1;
                steps(&mut estimator, 3);
                let mut covariance = vec![0.0; estimator.states().pow(2)];
                estimator.covariance_into(&mut covariance).unwrap();
            }
            Err(FileError::Build(_)) => read += 1,
            Err(_) => {}
        }
    }
    assert!(read > 20 && built > 50, "{read} read, {built} built: the mutations are too coarse to test anything");
}

#[test]
fn what_follows_the_description_or_is_not_known_is_refused() {
    let refused = |change: fn(&mut Vec<u8>)| match Estimator::from_bytes(&reframed(FILES[0], change)) {
        Err(FileError::Content(why)) => why,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(|content| content.push(0)), "there is more behind it");
    assert!(!refused(|content| content.truncate(100)).is_empty());
    let renamed = refused(|content| {
        let at = content.windows(7).position(|name| name == b"gravity").unwrap();
        content[at] = b'G';
    });
    assert!(renamed.contains("Gravity") || renamed.contains("unknown field"), "{renamed}");
}

#[test]
fn a_description_of_nothing_says_what_is_wrong() {
    let refused = |change: fn(&mut Description)| {
        let mut description = demo::observer();
        change(&mut description);
        Estimator::new(description).unwrap_err()
    };
    let names = refused(|d| d.joints.clear());
    assert_eq!(names, BuildError::Names { what: "joints", found: 0, expected: 1 });
    assert_eq!(names.to_string(), "there are 0 names of joints, expected 1");
    let many = refused(|d| d.robot.drives = vec![d.robot.drives[0].clone(); 300]);
    assert_eq!(many, BuildError::TooMany { what: "joints", found: 300, most: 256 });
    assert!(matches!(refused(|d| d.robot.drives[0].stiffness = -1.0), BuildError::Robot(_)));
    let period = refused(|d| {
        let Method::Observer(observer) = &mut d.estimator else { unreachable!() };
        observer.period = -1.0;
    });
    assert!(matches!(period, BuildError::Design(_)));
    let mut ekf = Description::from_bytes(FILES[1]).unwrap();
    let Method::Ekf(filter) = &mut ekf.estimator else { unreachable!() };
    filter.tolerances[0].1 = 2; // there is no third joint
    assert!(matches!(Estimator::new(ekf.clone()), Err(BuildError::Unknown { .. })));
    let Method::Ekf(filter) = &mut ekf.estimator else { unreachable!() };
    filter.kinds[0] = "smell".into();
    assert_eq!(Estimator::new(ekf).unwrap_err().to_string(), "\"smell\" is not a kind of channel");
}

#[test]
fn a_sample_that_cannot_be_used_changes_nothing() {
    let mut estimator = Estimator::new(demo::observer()).unwrap();
    let good = Sample { theta: &[0.1], tau: &[0.0], acceleration: &[0.0, 0.0, 9.81], ..Sample::default() };
    estimator.step(&good).unwrap();
    let before = estimator.get("q").unwrap().to_vec();
    for bad in [
        Sample { theta: &[0.1, 0.2], ..good },
        Sample { tau: &[f64::INFINITY], ..good },
        Sample { acceleration: &[], ..good },
    ] {
        assert!(estimator.step(&bad).is_err());
        assert_eq!(estimator.get("q").unwrap(), before);
    }
    assert!(estimator.get("colour").is_none());
}
