//! Bags that are whole, and bags that are broken in any way: no panic, and memory in proportion to what is read.
#![allow(unsafe_code)] // an allocator that measures

use core::sync::atomic::{AtomicUsize, Ordering};
use linkside_bag::{BagError, Collector, McapReader, Request, Series};
use proptest::prelude::*;
use std::alloc::{GlobalAlloc, Layout, System};

/// The system's allocator, which knows the most that was in use.
struct Measuring;

static NOW: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is handed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Measuring {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(now, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Measuring = Measuring;

/// What a reader may use beside the bag [bytes]: some buffers ahead of what comes, and windows of decompression.
const BOUND: usize = 256 << 20;

const DEFINITION: &str = "std_msgs/Header header\nstring[] name\nfloat64[] position\nPart[<=3] parts\n\
    ===\nMSG: own_msgs/Part\nstring<=8 label\nfloat32[2] values # two\n";

fn text(value: &str) -> Vec<u8> {
    [&(value.len() as u32).to_le_bytes()[..], value.as_bytes()].concat()
}

fn record(kind: u8, body: &[u8]) -> Vec<u8> {
    [&[kind][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

/// A message: a stamp, `names` with positions, and one part.
fn message(stamp: u32, names: &[&str]) -> Vec<u8> {
    let mut data = vec![0, 1, 0, 0];
    let pad = |data: &mut Vec<u8>, size| {
        while !(data.len() - 4).is_multiple_of(size) {
            data.push(0)
        }
    };
    let string = |data: &mut Vec<u8>, value: &str| {
        pad(data, 4);
        data.extend((value.len() as u32 + 1).to_le_bytes());
        data.extend(value.bytes().chain([0]));
    };
    data.extend(stamp.to_le_bytes());
    data.extend(500u32.to_le_bytes());
    string(&mut data, "base");
    pad(&mut data, 4);
    data.extend((names.len() as u32).to_le_bytes());
    names.iter().for_each(|name| string(&mut data, name));
    pad(&mut data, 4);
    data.extend((names.len() as u32).to_le_bytes());
    pad(&mut data, 8);
    (0..names.len()).for_each(|at| data.extend((f64::from(stamp) + at as f64).to_le_bytes()));
    data.extend(1u32.to_le_bytes());
    string(&mut data, "x");
    pad(&mut data, 4);
    data.extend([1.5f32.to_le_bytes(), 2.5f32.to_le_bytes()].concat());
    data
}

/// Chunks of ten messages, compressed with lz4 or not at all.
fn bag(chunks: u32, lz4: bool) -> Vec<u8> {
    let schema = [&1u16.to_le_bytes()[..], &text("own_msgs/msg/Joints"), &text("ros2msg"), &text(DEFINITION)].concat();
    let channel = [&[1, 0, 1, 0][..], &text("/js"), &text("cdr"), &[0; 4]].concat();
    let mut file = b"\x89MCAP0\r\n".to_vec();
    file.extend(record(1, &[text("ros2"), text("test")].concat()));
    for chunk in 0..chunks {
        let mut records = [record(3, &schema), record(4, &channel)].concat();
        for stamp in 10 * chunk..10 * chunk + 10 {
            let head = [&1u16.to_le_bytes()[..], &[0; 4], &u64::from(stamp).to_le_bytes(), &[0; 8]].concat();
            records.extend(record(5, &[head, message(stamp, &["a", "b"])].concat()));
        }
        let packed = if lz4 { packed(&records) } else { records.clone() };
        let sizes = [&[0; 16][..], &(records.len() as u64).to_le_bytes(), &[0; 4]].concat();
        let name = text(if lz4 { "lz4" } else { "" });
        file.extend(record(6, &[sizes, name, (packed.len() as u64).to_le_bytes().to_vec(), packed].concat()));
    }
    file.extend(record(15, &[0; 4]));
    file
}

fn packed(records: &[u8]) -> Vec<u8> {
    let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
    std::io::Write::write_all(&mut encoder, records).unwrap();
    encoder.finish().unwrap()
}

fn requests() -> Vec<Request> {
    let named = Request { topic: "/js".into(), paths: vec!["position".into()], names: Some("name".into()), only: None };
    let paths = ["parts[0].values[1]", "header.stamp.sec", "position[1]"].map(String::from).to_vec();
    vec![named, Request { topic: "/js".into(), paths, names: None, only: None }]
}

fn read(file: &[u8]) -> Result<(Vec<Series>, bool), BagError> {
    let mut collector = Collector::new(requests(), false);
    let mut reader = McapReader::new(file)?;
    while reader.advance(&mut collector)? {}
    Ok((collector.finish(), reader.truncated()))
}

#[test]
fn a_whole_bag_is_read() {
    for lz4 in [false, true] {
        let (series, truncated) = read(&bag(3, lz4)).unwrap();
        assert!(!truncated);
        let stamps: Vec<f64> = (0..30).map(f64::from).collect();
        assert_eq!(series[0].names, ["a", "b"]);
        assert_eq!(series[0].columns, [stamps.clone(), stamps.iter().map(|x| x + 1.0).collect()]);
        assert_eq!(series[1].columns[0], vec![2.5; 30]);
        assert_eq!(series[1].columns[1], stamps);
        assert_eq!(series[1].columns[2], series[0].columns[1]);
        assert_eq!(series[0].stamps, (0..30).map(|k| k * 1_000_000_000 + 500).collect::<Vec<i64>>());
    }
}

#[test]
fn a_bag_that_was_cut_off_gives_whole_chunks() {
    let file = bag(3, true);
    for length in 8..file.len() {
        let (series, truncated) = read(&file[..length]).unwrap();
        assert!(truncated);
        assert_eq!(series[0].received.len() % 10, 0);
    }
}

#[test]
fn what_contradicts_itself_is_refused_by_name() {
    let wrong = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let file = bag(1, false);
        let at = file.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut changed = file.clone();
        changed[at..at + to.len()].copy_from_slice(to.as_bytes());
        read(&changed).unwrap_err().to_string()
    };
    assert!(wrong("cdr", "xml").contains("topic '/js' is written as 'xml'"));
    assert!(wrong("ros2msg", "ros2idl").contains("'ros2idl': a definition as ros2msg is expected"));
    assert!(wrong("Part[<=3]", "Pert[<=3]").contains("'own_msgs/Pert' is not defined in the bag"));
    assert!(wrong("values # two", "valued # two").contains("in place of 'values' there are label, valued"));
    assert!(wrong("float32[2]", "float32[0]").contains("has no size that can be understood"));
    assert!(wrong("string<=8 label", "Part parts2    ").contains("'own_msgs/Part' holds itself"));
    assert!(wrong("float64[] position", "float64[9] positio").contains("no field: in place of 'position'"));
    assert!(wrong("string[] name", "byte[900] nam").contains("'name'"));
    assert!(matches!(read(b"#ROSBAG V2.0\n"), Err(BagError::NotMcap(_))));
    let huge = record(6, &[&[0; 16][..], &u64::MAX.to_le_bytes(), &[0; 4], &text(""), &[0; 8]].concat());
    let file = [b"\x89MCAP0\r\n", &huge[..]].concat();
    assert!(matches!(read(&file), Err(BagError::Record { at: 8, .. })));
}

/// Changes to a file: bytes replaced, and pieces cut out or doubled.
fn mutations() -> impl Strategy<Value = Vec<(usize, u8, u8)>> {
    prop::collection::vec((any::<usize>(), any::<u8>(), 0..6u8), 1..8)
}

fn mutated(mut file: Vec<u8>, mutations: &[(usize, u8, u8)]) -> Vec<u8> {
    for &(place, byte, kind) in mutations {
        let at = place % file.len();
        let end = (at + usize::from(byte)).min(file.len());
        match kind {
            0 => drop(file.drain(at..end)),
            1 => drop(file.splice(at..at, file[at..end].to_vec())),
            2 => file[at..end].fill(0xff),
            _ => file[at] = byte,
        }
        if file.is_empty() {
            file.push(0);
        }
    }
    file
}

fn stays_bounded(mutations: &[(usize, u8, u8)], lz4: bool) {
    let file = mutated(bag(2, lz4), mutations);
    let before = NOW.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    let _ = read(&file);
    assert!(MOST.load(Ordering::Relaxed) - before < BOUND);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

    #[test]
    fn a_mutated_bag_is_read_or_refused(mutations in mutations(), lz4: bool) {
        stays_bounded(&mutations, lz4);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(100_000) })]

    #[test]
    #[ignore = "takes a minute"]
    fn many_mutated_bags_are_read_or_refused(mutations in mutations(), lz4: bool) {
        stays_bounded(&mutations, lz4);
    }
}
