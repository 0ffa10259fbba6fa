//! Bags: files in MCAP, definitions of messages, messages in CDR.

use super::bytes::Bytes;
use linkside_bag::{Collector, McapReader, Request, Series, Written};

/// Topics, paths and names that are asked for; those of the corpus and some that are not there.
fn requests() -> Vec<Request> {
    let request = |topic: &str, paths: &[&str], names: Option<&str>, only: Option<&[&str]>| Request {
        topic: topic.into(),
        paths: paths.iter().map(|&path| path.into()).collect(),
        names: names.map(Into::into),
        only: only.map(|only| only.iter().map(|&name| name.into()).collect()),
    };
    vec![
        request("/joints", &["position", "velocity"], Some("name"), None),
        request("/joints", &["position"], Some("name"), Some(&["b", "a"])),
        request("/imu", &["linear_acceleration.x", "angular_velocity.z"], None, None),
        request("/parts", &["parts[1].values[0]"], None, None),
    ]
}

/// A row has a stamp (or no row has), a time of receipt and an entry of each column.
fn check(series: &[Series]) {
    for one in series {
        let rows = one.received.len();
        assert!(one.stamps.is_empty() || one.stamps.len() == rows);
        assert!(one.columns.iter().all(|column| column.len() == rows));
    }
}

/// A whole file.
pub fn mcap(data: &[u8]) {
    let mut collector = Collector::new(requests(), false);
    let Ok(mut reader) = McapReader::new(data) else { return };
    while let Ok(true) = reader.advance(&mut collector) {}
    let _ = collector.topics();
    check(&collector.finish());
}

/// The text of a definition, its type and the path of a field, then messages of it.
fn written(data: &[u8], definition: Option<&[u8]>, compressed: bool) {
    let mut bytes = Bytes(data);
    let mut text = || String::from_utf8_lossy(bytes.block()).into_owned();
    let (message, path, name) = match definition {
        Some(_) => ("own_msgs/msg/All".into(), "parts[1].values[0]".into(), String::new()),
        None => (text(), text(), text()),
    };
    let definition = definition.unwrap_or_else(|| bytes.block());
    let names = (!name.is_empty()).then_some(name);
    let request = |path: String, names| Request { topic: "/t".into(), paths: vec![path], names, only: None };
    let mut asked = vec![request(path, names)];
    if bytes.flag() {
        asked.push(request("position".into(), Some("name".into())));
    }
    let mut collector = Collector::new(asked, compressed);
    let written = Written { message: &message, encoding: "cdr", language: "ros2msg", definition };
    let Ok(channel) = collector.define("/t", written) else { return };
    while !bytes.is_empty() {
        let _ = collector.add(channel, 7, bytes.block());
    }
    check(&collector.finish());
}

/// Any definition, and messages that should be of it.
pub fn definition(data: &[u8]) {
    written(data, None, false);
}

const DEFINITION: &[u8] = b"std_msgs/Header header\nstring[] name\nfloat64[] position\nPart[<=3] parts\n\
    ===\nMSG: own_msgs/Part\nstring<=8 label\nfloat32[2] values\nuint8[] more\nint64 large\nwstring wide\n";

/// Any messages of a definition that is right.
pub fn cdr(data: &[u8]) {
    written(data, Some(DEFINITION), false);
}

/// Messages that are compressed by themselves.
pub fn compressed(data: &[u8]) {
    written(data, Some(DEFINITION), true);
}
