//! The tree of a schema: its encoding and its types.

use alloc::{boxed::Box, vec::Vec};
use core::fmt;

use super::{definition::Definition, hash};

/// The part of a schema that states what is encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Root {
    /// The type that is encoded (SM2-TYP-001).
    Type(Type),
    /// The definition of a message of ROS 2 (SM2-TYP-002). The encoding is [`Encoding::Cdr`].
    Definition(Definition),
}

/// How a value becomes bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As the value lies in memory, without padding.
    Plain,
    /// The postcard format, as in control frames.
    Postcard,
    /// JSON, as serde writes it.
    Json,
    /// The CDR of ROS 2.
    Cdr,
    /// An encoding that SPEC does not define.
    Other(Box<str>),
}

impl Encoding {
    /// The name in schema texts.
    #[must_use]
    pub const fn name(&self) -> &str {
        match self {
            Self::Plain => "plain",
            Self::Postcard => "postcard",
            Self::Json => "json",
            Self::Cdr => "cdr",
            Self::Other(name) => name,
        }
    }

    pub(super) fn named(name: &str) -> Self {
        match name {
            "plain" => Self::Plain,
            "postcard" => Self::Postcard,
            "json" => Self::Json,
            "cdr" => Self::Cdr,
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
    /// Values of several types, each with a name. The fields of a tuple are named `0`, `1`, ….
    Struct(Vec<Field>),
    /// One of several variants.
    Enum(Vec<Variant>),
    /// `len` values of one type.
    Array {
        /// The type of each value.
        element: Box<Type>,
        /// The number of values.
        len: u64,
    },
    /// A list of values of one type, whose length the message states.
    List(Box<Type>),
    /// A list whose values differ from each other and have no order.
    Set(Box<Type>),
    /// A list of pairs whose first values differ from each other.
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
    pub(super) name: Box<str>,
    pub(super) ty: Type,
}

impl Field {
    /// The name; a number for the field of a tuple.
    #[must_use]
    pub const fn name(&self) -> &str {
        &self.name
    }

    /// The type.
    #[must_use]
    pub const fn ty(&self) -> &Type {
        &self.ty
    }
}

/// A variant of an enumeration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variant {
    pub(super) name: Box<str>,
    pub(super) fields: Vec<Field>,
}

impl Variant {
    /// The name.
    #[must_use]
    pub const fn name(&self) -> &str {
        &self.name
    }

    /// The fields.
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
            /// All scalars.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// The name in schema texts.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// The size in memory, in bytes.
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
    pub(super) fn hash(&self) -> u64 {
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
