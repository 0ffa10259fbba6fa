//! Decompression, bounded by what is to come out of it.

use crate::error::BagError;
use ruzstd::decoding::StreamingDecoder;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

/// Bytes that are set aside before any have come.
const AHEAD: u64 = 16 << 20;

/// Reads all of a source that has at most `size` bytes, into memory that grows with what comes.
pub(crate) fn all(source: impl Read, size: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(size.min(AHEAD) as usize);
    source.take(size).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Unpacks what is compressed as `zstd` or `lz4`, or not (an empty name), into at most `size` bytes.
pub(crate) fn unpack(packed: &[u8], compression: &str, size: u64) -> Result<Vec<u8>, String> {
    let unpacked = match compression {
        "" => return Ok(packed.to_vec()),
        "zstd" => StreamingDecoder::new(packed).map_err(io::Error::other).and_then(|decoder| all(decoder, size)),
        "lz4" => all(lz4_flex::frame::FrameDecoder::new(packed), size),
        other => return Err(format!("'{other}' is no compression that is known: zstd or lz4 is expected")),
    };
    unpacked.map_err(|error| error.to_string())
}

/// Unpacks a file that is compressed with zstd as a whole, as rosbag2 does it in its mode `file`.
///
/// # Errors
///
/// A file that cannot be read, or written, or is damaged.
pub fn unpack_file(source: &Path, target: &Path) -> Result<(), BagError> {
    let packed = BufReader::new(File::open(source)?);
    let mut decoder = StreamingDecoder::new(packed).map_err(io::Error::other)?;
    let mut file = BufWriter::new(File::create(target)?);
    io::copy(&mut decoder, &mut file)?;
    Ok(file.flush()?)
}
