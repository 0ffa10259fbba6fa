//! Text for C, in memory that is there beforehand.

use std::ffi::c_char;
use std::fmt::{self, Display, Write};

/// Longer ones are cut.
const LENGTH: usize = 512;

/// A string that ends in a zero.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    text: [u8; LENGTH],
    used: usize,
}

impl Message {
    pub(crate) const EMPTY: Self = Self { text: [0; LENGTH], used: 0 };

    /// Takes over what `text` displays.
    pub(crate) fn set(&mut self, text: &dyn Display) {
        self.clear();
        let _ = write!(self, "{text}"); // an error is a text that was cut
        self.text[self.used] = 0;
    }

    pub(crate) fn clear(&mut self) {
        (self.used, self.text[0]) = (0, 0);
    }

    pub(crate) fn as_ptr(&self) -> *const c_char {
        self.text.as_ptr().cast()
    }
}

impl Write for Message {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        // A zero ends strings in C, so that one within would hide the rest; half a character is none.
        for character in text.chars().map(|c| if c == '\0' { ' ' } else { c }) {
            let end = self.used + character.len_utf8();
            if end >= LENGTH {
                return Err(fmt::Error);
            }
            character.encode_utf8(&mut self.text[self.used..end]);
            self.used = end;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::CStr;

    #[test]
    fn texts_end_in_a_zero_whatever_their_length() {
        let mut message = Message::EMPTY;
        for (text, expected) in [("short", "short".into()), ("a\0b", "a b".into()), (&"é".repeat(400), "é".repeat(255))]
        {
            message.set(&text);
            // SAFETY: it ends in a zero, or this test fails under any checker.
            let found = unsafe { CStr::from_ptr(message.as_ptr()) };
            assert_eq!(found.to_str().unwrap(), expected);
        }
    }
}
