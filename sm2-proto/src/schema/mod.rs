//! Schemas: what a message's bytes mean, as a text and as a tree (SPEC Annex A).
//!
//! The text is what programs register with the Manager and what tools get from it:
//! `postcard:struct{frame:string,points:list[struct{0:f64,1:f64,}],}`. It certifies itself: the
//! hash of the type, which programs compare, follows from it ([`Schema::hash`]).
//!
//! [`Schema::parse`] is the only way to a [`Schema`], so whoever has one has a tree of at most
//! [`SCHEMA_DEPTH_MAX`](crate::limits::SCHEMA_DEPTH_MAX) levels whose names are legal, and
//! whose text ([`Display`](fmt::Display)) is the one that it came from.

mod difference;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
pub mod hash;
mod layout;
mod parse;
#[cfg(any(kani, test))]
mod proofs;
mod tree;

use core::fmt;

pub use self::difference::Difference;
pub use self::layout::{Layout, NoLayout};
pub use self::parse::{ParseError, Reason, is_name};
pub use self::tree::{Encoding, Field, Scalar, Type, Variant};

/// What the bytes of a message type are: an encoding, and what is encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    encoding: Encoding,
    root: Type,
}

impl Schema {
    /// Reads a schema text.
    ///
    /// # Errors
    ///
    /// [`ParseError`] for anything that is not exactly the text of a schema (SM2-TYP-001).
    pub fn parse(text: &str) -> Result<Self, ParseError> {
        let (encoding, root) = parse::schema(text)?;
        Ok(Self { encoding, root })
    }

    /// How the value becomes bytes.
    #[must_use]
    pub const fn encoding(&self) -> &Encoding {
        &self.encoding
    }

    /// What is encoded.
    #[must_use]
    pub const fn root(&self) -> &Type {
        &self.root
    }

    /// The hash of the type that has this schema (SM2-NAM-003).
    #[must_use]
    pub fn hash(&self) -> u64 {
        hash::message(self.encoding.name(), self.root.hash())
    }

    /// Where this schema and another one differ first, if they do.
    #[must_use]
    pub fn difference(&self, other: &Self) -> Option<Difference> {
        let [here, there] = [self, other].map(|it| (&it.encoding, &it.root));
        difference::of(here, there)
    }
}

impl fmt::Display for Schema {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.encoding.name(), self.root)
    }
}

#[cfg(test)]
mod tests;
