//! The content of a definition: fields, constants and their types.

use std::fmt;

use crate::TypeName;

/// A type with fields: a message, or a part of a service or action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its name.
    pub name: TypeName,
    /// The fields, in the order of the definition.
    pub fields: Vec<Field>,
    /// The constants, which are not part of a message's bytes.
    pub constants: Vec<Constant>,
    /// The comment at the start of the definition, before an empty line.
    pub comment: Box<str>,
}

/// A field of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: Box<str>,
    /// Its type.
    pub ty: FieldType,
    /// The default value, as the definition writes it.
    pub default: Option<Box<str>>,
    /// The lines of comment above it and behind it.
    pub comment: Box<str>,
}

/// A constant of a definition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Constant {
    /// Its name.
    pub name: Box<str>,
    /// Its type, a primitive or a string.
    pub ty: Base,
    /// The value, as the definition writes it.
    pub value: Box<str>,
    /// The lines of comment above it and behind it.
    pub comment: Box<str>,
}

/// The type of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldType {
    /// The type of one value.
    pub base: Base,
    /// The number of values.
    pub shape: Shape,
}

/// The type of one value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Base {
    /// A number or a boolean.
    Primitive(Primitive),
    /// Text in UTF-8.
    String {
        /// The most bytes that it may have, if there is a limit.
        max_bytes: Option<u32>,
    },
    /// Text in UTF-16.
    WString {
        /// The most 16-bit units that it may have, if there is a limit.
        max_units: Option<u32>,
    },
    /// Another message.
    Message(TypeName),
}

/// The number of values of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// One value.
    One,
    /// Always this number of values.
    Array(u32),
    /// A sequence, whose message has the number of values. The limit is the most values.
    Sequence(Option<u32>),
}

macro_rules! primitives {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $id:literal, $size:literal;)*) => {
        /// A number or a boolean.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Primitive {
            $($(#[$doc])* $variant,)*
        }

        impl Primitive {
            /// All primitives.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Its name in definitions.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Its number in `type_description_interfaces/msg/FieldType`.
            #[must_use]
            pub const fn type_id(self) -> u8 {
                match self { $(Self::$variant => $id,)* }
            }

            /// Its size and alignment in CDR, in bytes.
            #[must_use]
            pub const fn size_bytes(self) -> usize {
                match self { $(Self::$variant => $size,)* }
            }
        }
    };
}

primitives! {
    /// One byte, 0 or 1.
    Bool = "bool", 15, 1;
    /// One byte without a meaning as a number.
    Byte = "byte", 16, 1;
    /// The same as `uint8`, also in the hash: ROS 2 translates it so.
    Char = "char", 3, 1;
    /// 8 bits, two's complement.
    Int8 = "int8", 2, 1;
    /// 8 bits, unsigned.
    Uint8 = "uint8", 3, 1;
    /// 16 bits, two's complement.
    Int16 = "int16", 4, 2;
    /// 16 bits, unsigned.
    Uint16 = "uint16", 5, 2;
    /// 32 bits, two's complement.
    Int32 = "int32", 6, 4;
    /// 32 bits, unsigned.
    Uint32 = "uint32", 7, 4;
    /// 64 bits, two's complement.
    Int64 = "int64", 8, 8;
    /// 64 bits, unsigned.
    Uint64 = "uint64", 9, 8;
    /// IEEE 754, 32 bits.
    Float32 = "float32", 10, 4;
    /// IEEE 754, 64 bits.
    Float64 = "float64", 11, 8;
}

impl fmt::Display for Base {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (word, max) = match self {
            Self::Primitive(primitive) => (primitive.name(), None),
            Self::String { max_bytes } => ("string", *max_bytes),
            Self::WString { max_units } => ("wstring", *max_units),
            Self::Message(name) if name.kind() == crate::Kind::Msg => {
                return write!(f, "{}/{}", name.package(), name.name());
            }
            Self::Message(name) => return write!(f, "{name}"),
        };
        match max {
            Some(max) => write!(f, "{word}<={max}"),
            None => f.write_str(word),
        }
    }
}

impl fmt::Display for FieldType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.base.fmt(f)?;
        match self.shape {
            Shape::One => Ok(()),
            Shape::Array(len) => write!(f, "[{len}]"),
            Shape::Sequence(None) => f.write_str("[]"),
            Shape::Sequence(Some(max)) => write!(f, "[<={max}]"),
        }
    }
}
