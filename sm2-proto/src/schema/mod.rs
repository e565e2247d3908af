//! Schemas: the meaning of a message's bytes, as a text and as a tree (SPEC Annex A).
//!
//! Programs register the text with the Manager, and tools get it from there:
//! `postcard:struct{frame:string,points:list[struct{0:f64,1:f64,}],}`. The text proves itself: the
//! hash of the type, which programs compare, follows from it ([`Schema::hash`]).
//!
//! Messages of ROS 2 have a text of another form, with the definition of their type
//! ([`Root::Definition`]).
//!
//! [`Schema::parse`] is the only way to make a [`Schema`]. So every schema has at most
//! [`SCHEMA_DEPTH_MAX`](crate::limits::SCHEMA_DEPTH_MAX) levels, legal names, and the text
//! ([`Display`](fmt::Display)) that it was made from.

mod definition;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
pub mod hash;
mod layout;
mod parse;
#[cfg(any(kani, test))]
mod proofs;
mod tree;

use core::fmt;

pub use self::definition::Definition;
pub use self::layout::{Layout, NoLayout};
pub use self::parse::{ParseError, Reason, is_name};
pub use self::tree::{Encoding, Field, Root, Scalar, Type, Variant};

/// The schema of a message type: an encoding and the type that is encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    encoding: Encoding,
    root: Root,
}

impl Schema {
    /// Reads a schema text.
    ///
    /// # Errors
    ///
    /// [`ParseError`] for any text that is not exactly that of a schema (SM2-TYP-001,
    /// SM2-TYP-002).
    pub fn parse(text: &str) -> Result<Self, ParseError> {
        let (encoding, root) = parse::schema(text)?;
        Ok(Self { encoding, root })
    }

    /// The encoding, which turns a value into bytes.
    #[must_use]
    pub const fn encoding(&self) -> &Encoding {
        &self.encoding
    }

    /// The type that is encoded, or its definition.
    #[must_use]
    pub const fn root(&self) -> &Root {
        &self.root
    }

    /// The hash of the type that has this schema (SM2-NAM-003).
    #[must_use]
    pub fn hash(&self) -> u64 {
        match &self.root {
            Root::Type(ty) => hash::message(self.encoding.name(), ty.hash()),
            Root::Definition(definition) => hash::cdr(definition.rihs01()),
        }
    }
}

impl fmt::Display for Schema {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.encoding.name())?;
        match &self.root {
            Root::Type(ty) => write!(f, "{ty}"),
            Root::Definition(definition) => write!(f, "{definition}"),
        }
    }
}

#[cfg(test)]
mod tests;
