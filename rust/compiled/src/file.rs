//! Descriptions in files.
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `linkside` |
//! | 4 | version of the format, an integer, the least significant byte first |
//! | 8 | n, the length of the content, likewise |
//! | n | the content: a [`Description`] in CBOR (RFC 8949), structures as maps by the names of their fields |
//! | 4 | CRC-32 (as of Ethernet) of all bytes before, likewise |
//!
//! Within a version fields are added with a value that they have where they are missing, and none changes its meaning. A
//! program refuses what it does not know.

use crate::description::{BuildError, Description};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Version of the format.
pub const VERSION: u32 = 1;

/// The first bytes of a file.
const MAGIC: &[u8; 8] = b"linkside";

/// Bytes before the content, and after it.
const HEAD: usize = 20;
const TAIL: usize = 4;

/// No robot needs more: 256 joints and as many sensors are a tenth of it.
const MOST_BYTES: usize = 1 << 24;

/// A file that cannot be used.
#[derive(Debug, Error)]
pub enum FileError {
    /// Nothing could be read.
    #[error("{}: cannot be read: {error}", path.display())]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A file of something else.
    #[error("this is no compiled robot of linkside")]
    Foreign,
    /// Another version of the format.
    #[error("this is version {found} of the format, expected {VERSION}: compile the robot again")]
    Version {
        /// The file's.
        found: u32,
    },
    /// Bytes that are missing, or too many.
    #[error("there are {found} bytes, expected {expected}: the file is not whole")]
    Length {
        /// How many.
        found: usize,
        /// How many there should be.
        expected: u64,
    },
    /// Bytes that have changed.
    #[error("the checksum is wrong: the file is damaged")]
    Checksum,
    /// Content that is no description.
    #[error("the content cannot be read: {0}")]
    Content(String),
    /// A description of nothing that can be built.
    #[error(transparent)]
    Build(#[from] BuildError),
}

impl Description {
    /// Reads a file; [`from_bytes`](Self::from_bytes) of what is in it.
    ///
    /// # Errors
    /// Likewise, and a file that cannot be read.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let unreadable = |error| FileError::Unreadable { path: path.into(), error };
        let size = std::fs::metadata(path).map_err(unreadable)?.len();
        if size > MOST_BYTES as u64 {
            return Err(FileError::Foreign);
        }
        Self::from_bytes(&std::fs::read(path).map_err(unreadable)?)
    }

    /// The description in the bytes of a file, which is whole and of this version; it may not be one of anything yet.
    ///
    /// # Errors
    /// Bytes that are no such file, or no longer.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FileError> {
        let mut content = minicbor_serde::Deserializer::new(content(bytes)?);
        let description = serde::Deserialize::deserialize(&mut content);
        let description = description.map_err(|error| FileError::Content(error.to_string()))?;
        match content.decoder().position() == content.decoder().input().len() {
            true => Ok(description),
            false => Err(FileError::Content("there is more behind it".into())),
        }
    }

    /// The bytes of its file.
    pub fn to_bytes(&self) -> Vec<u8> {
        #[expect(clippy::expect_used, reason = "writing into memory does not fail")]
        let content = minicbor_serde::to_vec(self).expect("memory takes all that is written");
        framed(VERSION, &content)
    }
}

/// The content between head and checksum.
fn content(bytes: &[u8]) -> Result<&[u8], FileError> {
    let found = bytes.len();
    let rest = match bytes.strip_prefix(MAGIC) {
        Some(rest) => rest,
        None if found < MAGIC.len() && MAGIC.starts_with(bytes) => return Err(too_short(found)),
        None => return Err(FileError::Foreign),
    };
    let (version, rest) = rest.split_first_chunk().ok_or_else(|| too_short(found))?;
    let version = u32::from_le_bytes(*version);
    if version != VERSION {
        return Err(FileError::Version { found: version });
    }
    let (length, rest) = rest.split_first_chunk().ok_or_else(|| too_short(found))?;
    let expected = u64::from_le_bytes(*length).saturating_add((HEAD + TAIL) as u64);
    if expected != found as u64 {
        return Err(FileError::Length { found, expected });
    }
    let (content, checksum) = rest.split_last_chunk().ok_or_else(|| too_short(found))?;
    let checked = &bytes[..found - TAIL];
    if crc32fast::hash(checked) == u32::from_le_bytes(*checksum) { Ok(content) } else { Err(FileError::Checksum) }
}

fn too_short(found: usize) -> FileError {
    FileError::Length { found, expected: (HEAD + TAIL) as u64 }
}

/// `content` with head and checksum.
fn framed(version: u32, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    let mut bytes = [MAGIC, &version.to_le_bytes()[..], &length, content].concat();
    let checksum = crc32fast::hash(&bytes).to_le_bytes();
    bytes.extend_from_slice(&checksum);
    bytes
}
