//! Classic CDR: numbers aligned to their size from the beginning of a message, in either byte order.

/// What is wrong with a message.
pub(crate) type Wrong = &'static str;

const SHORT: Wrong = "ends before its fields do";

/// Types of numbers in message definitions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Primitive {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Primitive {
    /// By its name in a definition.
    pub(crate) fn named(name: &str) -> Option<Self> {
        Some(match name {
            "bool" | "boolean" => Self::Bool,
            "byte" | "char" | "uint8" | "octet" => Self::U8,
            "int8" => Self::I8,
            "uint16" => Self::U16,
            "int16" => Self::I16,
            "uint32" => Self::U32,
            "int32" => Self::I32,
            "uint64" => Self::U64,
            "int64" => Self::I64,
            "float32" | "float" => Self::F32,
            "float64" | "double" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes, and alignment.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

/// A place in a serialised message.
pub(crate) struct Cursor<'a> {
    data: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Cursor<'a> {
    /// At the beginning of a message, behind the four bytes that say how it is written.
    pub(crate) fn new(message: &'a [u8]) -> Result<Self, Wrong> {
        match message.split_at_checked(4) {
            Some((&[0, kind @ (0 | 1), ..], data)) => Ok(Self { data, at: 0, big_endian: kind == 0 }),
            Some(_) => Err("is not classic CDR"),
            None => Err(SHORT),
        }
    }

    /// In what a message holds, at a multiple of four bytes.
    pub(crate) fn within(data: &'a [u8], big_endian: bool) -> Self {
        Self { data, at: 0, big_endian }
    }

    fn align(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size);
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], Wrong> {
        self.align(N);
        let bytes = self.data.get(self.at..).and_then(<[u8]>::first_chunk).ok_or(SHORT)?;
        self.at += N;
        Ok(*bytes)
    }

    /// How many elements, or bytes, follow.
    pub(crate) fn count(&mut self) -> Result<usize, Wrong> {
        let bytes = self.take()?;
        Ok(if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) } as usize)
    }

    /// A number as float64, which holds all but integers beyond 2⁵³.
    #[inline]
    pub(crate) fn number(&mut self, kind: Primitive) -> Result<f64, Wrong> {
        macro_rules! read {
            ($number:ty) => {{
                let bytes = self.take()?;
                let number =
                    if self.big_endian { <$number>::from_be_bytes(bytes) } else { <$number>::from_le_bytes(bytes) };
                number as f64
            }};
        }
        Ok(match kind {
            Primitive::Bool => f64::from(u8::from(self.take::<1>()? != [0])),
            Primitive::U8 => read!(u8),
            Primitive::I8 => read!(i8),
            Primitive::U16 => read!(u16),
            Primitive::I16 => read!(i16),
            Primitive::U32 => read!(u32),
            Primitive::I32 => read!(i32),
            Primitive::U64 => read!(u64),
            Primitive::I64 => read!(i64),
            Primitive::F32 => read!(f32),
            Primitive::F64 => read!(f64),
        })
    }

    /// Passes over numbers. None at all are not aligned either.
    pub(crate) fn pass(&mut self, kind: Primitive, count: usize) -> Result<(), Wrong> {
        if count == 0 {
            return Ok(());
        }
        self.align(kind.size());
        self.skip(count.checked_mul(kind.size()).ok_or(SHORT)?)
    }

    /// Text, without the zero that ends it.
    pub(crate) fn text(&mut self) -> Result<&'a [u8], Wrong> {
        let length = self.count()?;
        let begin = self.at;
        self.skip(length)?;
        let text = &self.data[begin..self.at];
        Ok(text.strip_suffix(&[0]).unwrap_or(text))
    }

    fn skip(&mut self, bytes: usize) -> Result<(), Wrong> {
        let end = self.at.checked_add(bytes).filter(|&end| end <= self.data.len()).ok_or(SHORT)?;
        self.at = end;
        Ok(())
    }

    /// The byte order.
    pub(crate) fn big_endian(&self) -> bool {
        self.big_endian
    }

    /// Where it is.
    pub(crate) fn at(&self) -> usize {
        self.at
    }

    /// What was read since it was at `begin`.
    pub(crate) fn since(&self, begin: usize) -> &'a [u8] {
        &self.data[begin..self.at]
    }
}
