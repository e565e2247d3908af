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

use alloc::{boxed::Box, vec::Vec};
use core::fmt;

pub use self::difference::Difference;
pub use self::layout::{Layout, NoLayout};
pub use self::parse::{ParseError, Reason, is_name};

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
        parse::schema(text)
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
        difference::of(self, other)
    }
}

/// How a value becomes bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As it lies in memory, without padding.
    Plain,
    /// The postcard format, as in control frames.
    Postcard,
    /// JSON, as serde writes it.
    Json,
    /// One that SPEC does not know.
    Other(Box<str>),
}

impl Encoding {
    /// Its name in schema texts.
    #[must_use]
    pub const fn name(&self) -> &str {
        match self {
            Self::Plain => "plain",
            Self::Postcard => "postcard",
            Self::Json => "json",
            Self::Other(name) => name,
        }
    }

    fn named(name: &str) -> Self {
        match name {
            "plain" => Self::Plain,
            "postcard" => Self::Postcard,
            "json" => Self::Json,
            _ => Self::Other(name.into()),
        }
    }
}

/// The structure of a value. [`Display`](fmt::Display) is its schema text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Type {
    /// A number, a boolean or a character.
    Scalar(Scalar),
    /// `string`
    Text,
    /// Values of several types, each with a name; those of a tuple are `0`, `1`, ….
    Struct(Vec<Field>),
    /// One of several variants.
    Enum(Vec<Variant>),
    /// `len` values of one type.
    Array {
        /// The type of each.
        element: Box<Type>,
        /// How many.
        len: u64,
    },
    /// As many values of one type as the message says.
    List(Box<Type>),
    /// As a list, without order.
    Set(Box<Type>),
    /// Pairs.
    Map {
        /// The type of a pair's first value.
        key: Box<Type>,
        /// The type of a pair's second value.
        value: Box<Type>,
    },
    /// A value that may be absent.
    Option(Box<Type>),
}

/// A field of a structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    name: Box<str>,
    ty: Type,
}

impl Field {
    /// Its name; a number for the field of a tuple.
    #[must_use]
    pub const fn name(&self) -> &str {
        &self.name
    }

    /// What it holds.
    #[must_use]
    pub const fn ty(&self) -> &Type {
        &self.ty
    }
}

/// A variant of an enumeration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variant {
    name: Box<str>,
    fields: Vec<Field>,
}

impl Variant {
    /// Its name.
    #[must_use]
    pub const fn name(&self) -> &str {
        &self.name
    }

    /// What it holds.
    #[must_use]
    pub fn fields(&self) -> &[Field] {
        &self.fields
    }
}

macro_rules! scalars {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $size:literal;)*) => {
        /// A number, a boolean or a character.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Scalar {
            $($(#[$doc])* $variant,)*
        }

        impl Scalar {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Its name in schema texts.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// How many bytes it takes in memory.
            #[must_use]
            pub const fn size_bytes(self) -> u64 {
                match self { $(Self::$variant => $size,)* }
            }
        }
    };
}

scalars! {
    /// 8 bits, unsigned.
    U8 = "u8", 1;
    /// 16 bits, unsigned.
    U16 = "u16", 2;
    /// 32 bits, unsigned.
    U32 = "u32", 4;
    /// 64 bits, unsigned.
    U64 = "u64", 8;
    /// 128 bits, unsigned.
    U128 = "u128", 16;
    /// 8 bits, two's complement.
    I8 = "i8", 1;
    /// 16 bits, two's complement.
    I16 = "i16", 2;
    /// 32 bits, two's complement.
    I32 = "i32", 4;
    /// 64 bits, two's complement.
    I64 = "i64", 8;
    /// 128 bits, two's complement.
    I128 = "i128", 16;
    /// IEEE 754, 32 bits.
    F32 = "f32", 4;
    /// IEEE 754, 64 bits.
    F64 = "f64", 8;
    /// One byte, 0 or 1.
    Bool = "bool", 1;
    /// A Unicode scalar value.
    Char = "char", 4;
}

impl Type {
    fn hash(&self) -> u64 {
        match self {
            Self::Scalar(scalar) => hash::text(scalar.name()),
            Self::Text => hash::text("string"),
            Self::Struct(fields) => hash_of(fields),
            Self::Enum(variants) => {
                let variant = |it: &Variant| hash_of(&it.fields);
                let variants: Vec<_> = variants.iter().map(|it| (it.name(), variant(it))).collect();
                hash::enumeration(&variants)
            }
            Self::Array { element, len } => hash::array(element.hash(), *len),
            Self::List(element) => hash::list(element.hash()),
            Self::Set(element) => hash::set(element.hash()),
            Self::Map { key, value } => hash::map(key.hash(), value.hash()),
            Self::Option(value) => hash::option(value.hash()),
        }
    }
}

fn hash_of(fields: &[Field]) -> u64 {
    let fields: Vec<_> = fields.iter().map(|it| (it.name(), it.ty.hash())).collect();
    hash::structure(&fields)
}

impl fmt::Display for Schema {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.encoding.name(), self.root)
    }
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scalar(scalar) => f.write_str(scalar.name()),
            Self::Text => f.write_str("string"),
            Self::Struct(fields) => write_fields(f, fields),
            Self::Enum(variants) => {
                f.write_str("enum{")?;
                for Variant { name, fields } in variants {
                    write!(f, "{name}:")?;
                    write_fields(f, fields)?;
                    f.write_str(",")?;
                }
                f.write_str("}")
            }
            Self::Array { element, len } => write!(f, "array[{element};{len:016x}]"),
            Self::List(element) => write!(f, "list[{element}]"),
            Self::Set(element) => write!(f, "set[{element}]"),
            Self::Map { key, value } => write!(f, "map[{key},{value}]"),
            Self::Option(value) => write!(f, "option[{value}]"),
        }
    }
}

fn write_fields(f: &mut fmt::Formatter<'_>, fields: &[Field]) -> fmt::Result {
    f.write_str("struct{")?;
    for Field { name, ty } in fields {
        write!(f, "{name}:{ty},")?;
    }
    f.write_str("}")
}

#[cfg(test)]
mod tests;
