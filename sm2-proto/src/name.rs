//! The grammar of names (SPEC section 2). Each name has one spelling.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{borrow::ToOwned, string::String};
use core::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, de};

use crate::limits::NAME_MAX;

/// The name of a node, topic, service or type: 1 to 255 bytes, segments of
/// `A-Z a-z 0-9 _ -` joined by single `/`.
//= SM2-NAM-001
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Name(String);

/// The reason why a text is not a [`Name`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// The text is empty.
    #[error("a name cannot be empty")]
    Empty,
    /// The text is longer than 255 bytes.
    #[error("a name is at most {NAME_MAX} bytes, this one has {0}")]
    TooLong(usize),
    /// A segment between slashes is empty.
    #[error("a name has no empty segment: `/` stands between two segments only (byte {0})")]
    EmptySegment(usize),
    /// A character that no name contains.
    #[error("a name holds only A-Z a-z 0-9 _ - and /, not {character:?}")]
    BadCharacter {
        /// The number of bytes before the character.
        at: usize,
        /// The first such character.
        character: char,
    },
}

/// The place where bytes are not a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    Empty,
    TooLong(usize),
    EmptySegment(usize),
    BadByte(usize),
}

impl Fault {
    /// The error for the text with these bytes.
    fn of(self, text: &str) -> NameError {
        match self {
            Self::Empty => NameError::Empty,
            Self::TooLong(len) => NameError::TooLong(len),
            Self::EmptySegment(at) => NameError::EmptySegment(at),
            Self::BadByte(at) => NameError::BadCharacter {
                at,
                // All bytes before it are ASCII, so a character begins there.
                character: text[at..].chars().next().unwrap_or_default(),
            },
        }
    }
}

impl Name {
    /// Checks `text` against the grammar without changing it.
    pub fn new(text: &str) -> Result<Self, NameError> {
        check(text.as_bytes()).map_err(|it| it.of(text))?;
        Ok(Self(text.to_owned()))
    }

    /// Whether `text` is a name. Programs can ask at compile time.
    #[must_use]
    pub const fn is_valid(text: &str) -> bool {
        check(text.as_bytes()).is_ok()
    }

    /// As [`Name::new`], for text that a person typed: one leading `/` is dropped.
    pub fn typed(text: &str) -> Result<Self, NameError> {
        Self::new(text.strip_prefix('/').unwrap_or(text))
    }

    /// The name's text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

const fn check(bytes: &[u8]) -> Result<(), Fault> {
    if bytes.is_empty() {
        return Err(Fault::Empty);
    }
    if bytes.len() > NAME_MAX {
        return Err(Fault::TooLong(bytes.len()));
    }
    let mut before = b'/';
    let mut at = 0;
    // A constant function has no iterators.
    while at < bytes.len() {
        let byte = bytes[at];
        match byte {
            b'/' if before == b'/' => return Err(Fault::EmptySegment(at)),
            b'/' | b'_' | b'-' => {}
            _ if byte.is_ascii_alphanumeric() => {}
            _ => return Err(Fault::BadByte(at)),
        }
        before = byte;
        at += 1;
    }
    if before == b'/' {
        return Err(Fault::EmptySegment(bytes.len() - 1));
    }
    Ok(())
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for Name {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl de::Visitor<'_> for Visitor {
            type Value = Name;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a name")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Name, E> {
                Name::new(text).map_err(E::custom)
            }
        }
        deserializer.deserialize_str(Visitor)
    }
}
