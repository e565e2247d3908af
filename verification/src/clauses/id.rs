//! The id of a clause.

use std::fmt;

/// `SM2-` + three capital letters + `-` + three digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClauseId {
    area: [u8; 3],
    number: [u8; 3],
}

impl ClauseId {
    /// How long every id is, in bytes.
    pub const LEN_BYTES: usize = 11;

    /// Reads an id that is all of `text`.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (id, rest) = Self::parse_prefix(text)?;
        rest.is_empty().then_some(id)
    }

    /// Reads the id that `text` starts with and returns what follows it.
    #[must_use]
    pub fn parse_prefix(text: &str) -> Option<(Self, &str)> {
        let bytes: [u8; Self::LEN_BYTES] =
            text.as_bytes().get(..Self::LEN_BYTES)?.try_into().ok()?;
        let [b'S', b'M', b'2', b'-', a0, a1, a2, b'-', n0, n1, n2] = bytes else {
            return None;
        };
        let (area, number) = ([a0, a1, a2], [n0, n1, n2]);
        let legal =
            area.iter().all(u8::is_ascii_uppercase) && number.iter().all(u8::is_ascii_digit);
        legal.then(|| (Self { area, number }, &text[Self::LEN_BYTES..]))
    }
}

impl fmt::Display for ClauseId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a0, a1, a2] = self.area.map(char::from);
        let [n0, n1, n2] = self.number.map(char::from);
        f.pad(&format!("SM2-{a0}{a1}{a2}-{n0}{n1}{n2}"))
    }
}
