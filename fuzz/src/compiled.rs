//! Compiled robots: files of any bytes, contents of any bytes, descriptions with any numbers.

use super::bytes::Bytes;
use super::calls;
use linkside_compiled::{Description, Estimator};

/// A file.
pub fn compiled_file(data: &[u8]) {
    let _ = Estimator::from_bytes(data).map(|estimator| calls::rest(estimator, &mut Bytes(&[])));
}

/// A file whose head and checksum are right, so that its content is looked at.
pub fn compiled_content(data: &[u8]) {
    let Ok(description) = Description::from_bytes(&framed(data)) else { return };
    let bytes = description.to_bytes();
    let again = Description::from_bytes(&bytes).expect("what is written can be read");
    assert_eq!(again.to_bytes(), bytes);
    let _ = Estimator::new(description).map(|estimator| calls::rest(estimator, &mut Bytes(&[])));
}

/// One of the robots of the tests with some of its numbers replaced.
pub fn description(data: &[u8]) {
    let mut bytes = Bytes(data);
    let file = calls::FILES[bytes.below(calls::FILES.len())];
    let mut content = file[20..file.len() - 4].to_vec();
    let doubles: Vec<_> = places(&content);
    for _ in 0..=bytes.below(4) {
        let at = doubles[((usize::from(bytes.byte()) << 8) | usize::from(bytes.byte())) % doubles.len()];
        content[at..at + 8].copy_from_slice(&bytes.number().to_be_bytes());
    }
    let Ok(description) = Description::from_bytes(&framed(&content)) else { return };
    let _ = Estimator::new(description).map(|estimator| calls::rest(estimator, &mut bytes));
}

/// Where numbers of double precision are in CBOR; text has no such byte.
fn places(content: &[u8]) -> Vec<usize> {
    let mut places = vec![];
    let mut at = 0;
    while at + 9 <= content.len() {
        if content[at] == 0xfb {
            places.push(at + 1);
            at += 9;
        } else {
            at += 1;
        }
    }
    places
}

fn framed(content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    let mut bytes = [&b"linkside"[..], &1u32.to_le_bytes(), &length, content].concat();
    let checksum = crc32fast::hash(&bytes).to_le_bytes();
    bytes.extend(checksum);
    bytes
}
