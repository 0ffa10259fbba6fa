//! MCAP files (<https://mcap.dev/spec>): records, of which chunks hold further records, compressed.
//!
//! A file is read from its beginning, without its index, so that one that was cut off is read up to its end.

use crate::collect::{Collector, Written};
use crate::error::BagError;
use crate::unpack::{all, unpack};
use rayon::prelude::*;
use std::collections::HashMap;
use std::io::{self, Read};

const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

const FOOTER: u8 = 2;
const SCHEMA: u8 = 3;
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const DATA_END: u8 = 15;

/// Bytes of records, unpacked, that are read at a time.
const BATCH: u64 = 32 << 20;
/// Bytes of a chunk, unpacked, at most.
const LARGEST: u64 = 1 << 30;
/// Bytes of a record ahead of its content.
const HEAD: usize = 9;

/// The language of a message definition and its text, and the name of the type.
#[derive(Debug, Default)]
struct Schema {
    name: String,
    language: String,
    text: Vec<u8>,
}

/// A chunk that is not unpacked yet.
#[derive(Debug)]
struct Chunk {
    at: u64,
    size: u64,
    checksum: u32,
    compression: String,
    packed: Vec<u8>,
}

/// A record outside of chunks, or a chunk.
#[derive(Debug)]
enum Piece {
    Record(u8, u64, Vec<u8>),
    Chunk(Chunk),
}

/// Reads an MCAP file from its beginning to its end, and feeds what it holds to a [`Collector`].
#[derive(Debug)]
pub struct McapReader<R> {
    source: R,
    at: u64,
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, usize>,
    truncated: bool,
    damaged: Vec<u64>,
}

impl<R: Read> McapReader<R> {
    /// Opens what begins like an MCAP file.
    ///
    /// # Errors
    ///
    /// Something else, or what cannot be read.
    pub fn new(mut source: R) -> Result<Self, BagError> {
        let begin = all(&mut source, MAGIC.len() as u64)?;
        match &begin[..] {
            begin if begin == MAGIC => {}
            b"#ROSBAG " => return Err(BagError::NotMcap(", but a bag of ROS 1: convert it with rosbags-convert")),
            b"" => return Err(BagError::NotMcap(": it is empty")),
            _ => return Err(BagError::NotMcap("")),
        }
        let (schemas, channels) = (HashMap::new(), HashMap::new());
        Ok(Self { source, at: MAGIC.len() as u64, schemas, channels, truncated: false, damaged: Vec::new() })
    }

    /// Reads about 32 MB; whether there is more.
    ///
    /// # Errors
    ///
    /// Records that contradict themselves, and whatever the collector refuses.
    pub fn advance(&mut self, collector: &mut Collector) -> Result<bool, BagError> {
        let (pieces, more) = self.read_batch()?;
        let unpacked: Vec<_> = pieces.into_par_iter().map(unpacked).collect();
        for piece in unpacked {
            match piece {
                Ok((at, records)) => self.records(&records, at, collector)?,
                Err(at) => self.damaged.push(at),
            }
        }
        Ok(more)
    }

    /// Whether the file ends before its data do.
    #[must_use]
    pub fn truncated(&self) -> bool {
        self.truncated
    }

    /// Where chunks begin that were left out: they cannot be unpacked, or are not what their checksum says.
    #[must_use]
    pub fn damaged(&self) -> &[u64] {
        &self.damaged
    }

    fn read_batch(&mut self) -> Result<(Vec<Piece>, bool), BagError> {
        let (mut pieces, mut size) = (Vec::new(), 0);
        while size < BATCH {
            let Some((kind, at, body)) = self.read_record()? else { return Ok((pieces, false)) };
            match kind {
                FOOTER | DATA_END => return Ok((pieces, false)),
                CHUNK => {
                    let chunk = Chunk::parse(&body, at)?;
                    size += chunk.size + HEAD as u64;
                    pieces.push(Piece::Chunk(chunk));
                }
                kind => {
                    size += body.len() as u64 + HEAD as u64;
                    pieces.push(Piece::Record(kind, at, body));
                }
            }
        }
        Ok((pieces, true))
    }

    /// The next record that matters; nothing at the end of the file, where it should not be yet.
    fn read_record(&mut self) -> Result<Option<(u8, u64, Vec<u8>)>, BagError> {
        loop {
            let head = all(&mut self.source, HEAD as u64)?;
            let Ok([kind, length @ ..]) = <[u8; HEAD]>::try_from(head) else { break };
            let (at, length) = (self.at, u64::from_le_bytes(length));
            self.at = at.saturating_add(length).saturating_add(HEAD as u64);
            let got = if matches!(kind, FOOTER | SCHEMA | CHANNEL | MESSAGE | CHUNK | DATA_END) {
                let body = all(&mut self.source, length)?;
                if body.len() as u64 == length {
                    return Ok(Some((kind, at, body)));
                }
                body.len() as u64
            } else {
                io::copy(&mut (&mut self.source).take(length), &mut io::sink())?
            };
            if got < length {
                break;
            }
        }
        self.truncated = true;
        Ok(None)
    }

    /// Works through records one after the other; `at` is where the chunk around them begins, or the record itself.
    fn records(&mut self, mut records: &[u8], at: u64, collector: &mut Collector) -> Result<(), BagError> {
        while !records.is_empty() {
            let (kind, body, rest) =
                split_record(records).ok_or_else(|| damaged(at, "a record is longer than what is around it"))?;
            self.record(kind, body, collector).unwrap_or_else(|| Err(damaged(at, "a record is too short")))?;
            records = rest;
        }
        Ok(())
    }

    /// Works through a record; nothing where it is too short.
    fn record(&mut self, kind: u8, body: &[u8], collector: &mut Collector) -> Option<Result<(), BagError>> {
        let mut fields = Fields(body);
        match kind {
            SCHEMA => {
                let (id, name, language) = (fields.u16()?, fields.text()?, fields.text()?);
                let text = fields.bytes()?.to_vec();
                self.schemas.insert(id, Schema { name, language, text });
            }
            CHANNEL => {
                let (id, schema) = (fields.u16()?, fields.u16()?);
                let (topic, encoding) = (fields.text()?, fields.text()?);
                let none = Schema::default();
                let schema = self.schemas.get(&schema).unwrap_or(&none);
                let (message, language, definition) = (&schema.name[..], &schema.language[..], &schema.text[..]);
                match collector.define(&topic, Written { message, encoding: &encoding, language, definition }) {
                    Ok(channel) => drop(self.channels.insert(id, channel)),
                    Err(error) => return Some(Err(error)),
                }
            }
            MESSAGE => {
                let (id, _, recorded, _) = (fields.u16()?, fields.u32()?, fields.u64()?, fields.u64()?);
                if let Some(&channel) = self.channels.get(&id) {
                    return Some(collector.add(channel, i64::try_from(recorded).unwrap_or(i64::MAX), fields.0));
                }
            }
            _ => {}
        }
        Some(Ok(()))
    }
}

impl Chunk {
    fn parse(body: &[u8], at: u64) -> Result<Self, BagError> {
        Self::fields(body, at).ok_or_else(|| damaged(at, "a chunk is too short")).and_then(|chunk| match chunk.size {
            size if size <= LARGEST => Ok(chunk),
            size => Err(damaged(at, &format!("a chunk of {size} bytes, at most {LARGEST} are expected"))),
        })
    }

    fn fields(body: &[u8], at: u64) -> Option<Self> {
        let mut fields = Fields(body);
        let (_, _, size, checksum) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u32()?);
        let compression = fields.text()?;
        let length = usize::try_from(fields.u64()?).ok()?;
        Some(Self { at, size, checksum, compression, packed: fields.take(length)?.to_vec() })
    }
}

/// Records of a piece, and where it begins; of a chunk that is damaged only the latter.
fn unpacked(piece: Piece) -> Result<(u64, Vec<u8>), u64> {
    match piece {
        Piece::Record(kind, at, body) => {
            let mut record = Vec::with_capacity(HEAD + body.len());
            record.push(kind);
            record.extend((body.len() as u64).to_le_bytes());
            record.extend(body);
            Ok((at, record))
        }
        Piece::Chunk(chunk) => {
            let records = unpack(&chunk.packed, &chunk.compression, chunk.size).map_err(|_| chunk.at)?;
            let sound = chunk.checksum == 0 || crc32fast::hash(&records) == chunk.checksum;
            if sound && records.len() as u64 == chunk.size { Ok((chunk.at, records)) } else { Err(chunk.at) }
        }
    }
}

/// A record's kind and content, and what comes after it.
fn split_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let mut fields = Fields(records);
    let kind = fields.take(1)?[0];
    let length = usize::try_from(fields.u64()?).ok()?;
    Some((kind, fields.take(length)?, fields.0))
}

fn damaged(at: u64, what: &str) -> BagError {
    BagError::Record { at, what: what.into() }
}

/// The rest of a record, of which fields are taken from the front.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        self.take(length)
    }

    fn text(&mut self) -> Option<String> {
        self.bytes().map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }
}
