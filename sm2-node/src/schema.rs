//! Schemas of types. With them, two programs can check that they use the same type, and tools can decode
//! messages.
//!
//! The hash of a type covers everything that determines its bytes: the names and types of its fields, in
//! order. It covers neither the type's own name (which is compared beside the hash, SM2-NAM-003) nor any Rust
//! module. Two crates, or two languages, that define the same structure therefore get the same hash. A field
//! that serde renames has its new name here.
//!
//! The hash is FNV-1a (64 bits) of a text. In this text, each type of a part stands as its hash, in 16
//! lower-case hexadecimal digits:
//!
//! | type | text |
//! | --- | --- |
//! | `u8` … `u128`, `i8` … `i128`, `f32`, `f64`, `bool`, `char` | its name, also for zerocopy's `little_endian` types |
//! | `String`, `str` | `string` |
//! | structure | `struct{a:<hash of a's type>,b:<…>,}`; the fields of a tuple structure are `0`, `1`, … |
//! | enumeration | `enum{A:<hash of its fields as a structure>,B:<…>,}` |
//! | tuple | as a structure with the fields `0`, `1`, … |
//! | `[T; n]` | `array[<T>;<n as 16 hexadecimal digits>]` |
//! | `[T]`, `Vec<T>`, `VecDeque<T>` | `list[<T>]` |
//! | `BTreeSet<T>`, `HashSet<T>` | `set[<T>]` |
//! | `BTreeMap<K, V>`, `HashMap<K, V>` | `map[<K>,<V>]` |
//! | `Option<T>` | `option[<T>]` |
//! | `Box<T>`, a type that is `#[serde(transparent)]` | as `T` |
//! | message | `plain:<type>`, `postcard:<type>`, `json:<type>`: the encoding and the type that is encoded |
//!
//! `usize` has no hash, because its width depends on the machine.
//!
//! The schema text of a message type ([`Message::schema`](crate::Message::schema)) is the same text with the
//! texts of the parts in place of their hashes. `sm2_proto::schema` parses it.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};
use std::fmt::Write as _;

use sm2_proto::TypeId;
use sm2_proto::limits::SCHEMA_TEXT_MAX;
pub use sm2_proto::schema::hash::{
    array, cdr, enumeration, list, map, message, option, set, structure, text,
};

pub use crate::error::SchemaError;

/// A type whose structure has a hash. Derive it for the types that messages consist of.
///
/// A recursive type needs a manual implementation, because its hash cannot be computed from its parts: `const
/// HASH: u64 = sm2_node::schema::text("tree, version 1");`. Tools cannot decode messages that contain such a
/// type.
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Schema`",
    note = "derive it: `#[derive(sm2_node::Schema)]`",
    note = "replace `usize` and `isize` by a type of fixed width, such as `u64`"
)]
pub trait Schema {
    /// The hash of the structure: see the [module](self).
    const HASH: u64;

    /// Appends the type's schema text. Returns false if the type has no text, or if the text is longer than
    /// allowed; then the appended part is invalid.
    #[must_use]
    fn describe(_text: &mut String) -> bool {
        false
    }
}

/// The name of a message type, which the compiler checks for `derive(Message)`:
///
/// ```compile_fail,E0080
/// #[derive(serde::Serialize, serde::Deserialize, sm2_node::Message)]
/// #[message(name = "/imu", encoding = "postcard")]
/// struct Imu;
///
/// const NAME: &str = <Imu as sm2_node::Message>::NAME;
/// ```
///
/// # Panics
///
/// It is not a [`Name`](sm2_proto::Name).
#[must_use]
pub const fn checked_type(name: &'static str) -> &'static str {
    assert!(
        sm2_proto::Name::is_valid(name),
        "a name has 1 to 255 bytes: segments of A-Z a-z 0-9 _ - joined by single slashes"
    );
    name
}

/// The name of a field or variant, which the compiler checks for `derive(Schema)`:
///
/// ```compile_fail,E0080
/// #[derive(serde::Serialize, sm2_node::Schema)]
/// struct Imu {
///     #[serde(rename = "angular velocity")]
///     angular_velocity: f64,
/// }
///
/// const HASH: u64 = <Imu as sm2_node::Schema>::HASH;
/// ```
///
/// # Panics
///
/// It cannot be one: see [`is_name`](sm2_proto::schema::is_name).
#[must_use]
pub const fn checked_member(name: &'static str) -> &'static str {
    assert!(
        sm2_proto::schema::is_name(name),
        "the name of a field or variant has letters, digits, `_` and `-`"
    );
    name
}

/// The signature of [`Schema::describe`].
pub type Describe = fn(&mut String) -> bool;

/// Implements [`Schema::describe`] for a structure with these fields.
#[must_use]
pub fn describe_structure(text: &mut String, fields: &[(&str, Describe)]) -> bool {
    describe_members(text, "struct{", fields, |text, field| append(text, *field))
}

/// Implements [`Schema::describe`] for an enumeration with these variants and their fields.
#[must_use]
pub fn describe_enumeration(text: &mut String, variants: &[(&str, &[(&str, Describe)])]) -> bool {
    describe_members(text, "enum{", variants, |text, fields| {
        describe_structure(text, fields)
    })
}

fn describe_members<M>(
    text: &mut String,
    open: &str,
    members: &[(&str, M)],
    describe: impl Fn(&mut String, &M) -> bool,
) -> bool {
    text.push_str(open);
    for (name, member) in members {
        text.push_str(name);
        text.push(':');
        if !describe(text, member) {
            return false;
        }
        text.push(',');
    }
    text.push('}');
    true
}

/// Appends a part, unless the text exceeds its limit: the text of deeply nested types can grow without bound.
fn append(text: &mut String, part: Describe) -> bool {
    text.len() <= SCHEMA_TEXT_MAX && part(text)
}

/// Appends `open`, the parts separated by `,`, and `]`.
fn describe_parts(text: &mut String, open: &str, parts: &[Describe]) -> bool {
    text.push_str(open);
    for (at, part) in parts.iter().enumerate() {
        if at > 0 {
            text.push(',');
        }
        if !append(text, *part) {
            return false;
        }
    }
    text.push(']');
    true
}

/// Returns the schema text of a message type in this encoding. `None` if a part has no text, if the text
/// would be too long, or if its hash is not that of the type (as for `bytes`).
#[must_use]
pub fn message_text<T: crate::Message + Schema + ?Sized>(encoding: &str) -> Option<String> {
    let mut text = format!("{encoding}:");
    if !T::describe(&mut text) {
        return None;
    }
    let schema = sm2_proto::schema::Schema::parse(&text).ok()?;
    (schema.hash() == <T as crate::Message>::HASH).then_some(text)
}

/// Checks that the Manager will accept this text for this type.
//= SM2-SCH-001, SM2-TYP-001
pub(crate) fn check_schema(data: &TypeId, text: &str) -> Result<(), SchemaError> {
    let found = match sm2_proto::schema::Schema::parse(text) {
        Ok(schema) => schema.hash(),
        Err(reason) => {
            return Err(SchemaError::Text {
                data: data.clone(),
                reason,
            });
        }
    };
    if found != data.hash {
        return Err(SchemaError::Hash {
            data: data.clone(),
            found,
        });
    }
    Ok(())
}

macro_rules! named {
    ($($type:ty = $name:literal),* $(,)?) => {
        $(impl Schema for $type {
            const HASH: u64 = text($name);

            fn describe(text: &mut String) -> bool {
                text.push_str($name);
                true
            }
        })*
    };
}

named! {
    u8 = "u8", u16 = "u16", u32 = "u32", u64 = "u64", u128 = "u128",
    i8 = "i8", i16 = "i16", i32 = "i32", i64 = "i64", i128 = "i128",
    f32 = "f32", f64 = "f64", bool = "bool", char = "char",
    str = "string", String = "string",
}

/// Numbers without alignment. Their bytes are those of a number on a little-endian machine, the only kind
/// that SM2 runs on.
#[cfg(target_endian = "little")]
mod unaligned {
    use zerocopy::little_endian as le;

    use super::{Schema, text};

    named! {
        le::U16 = "u16", le::U32 = "u32", le::U64 = "u64", le::U128 = "u128",
        le::I16 = "i16", le::I32 = "i32", le::I64 = "i64", le::I128 = "i128",
        le::F32 = "f32", le::F64 = "f64",
    }
}

impl<T: Schema, const N: usize> Schema for [T; N] {
    const HASH: u64 = array(T::HASH, N as u64);

    fn describe(text: &mut String) -> bool {
        text.push_str("array[");
        append(text, T::describe) && write!(text, ";{N:016x}]").is_ok()
    }
}

/// Implements `Schema` for types that consist of other types. `$hash` computes the hash from those of the
/// parts; the text begins with `$open`.
macro_rules! made_of {
    ($($type:ty, ($($generics:tt)*) = $hash:ident, $open:literal, [$($part:ident),*];)*) => {
        $(impl<$($generics)*> Schema for $type {
            const HASH: u64 = $hash($($part::HASH),*);

            fn describe(text: &mut String) -> bool {
                describe_parts(text, $open, &[$($part::describe),*])
            }
        })*
    };
}

made_of! {
    [T], (T: Schema) = list, "list[", [T];
    Vec<T>, (T: Schema) = list, "list[", [T];
    VecDeque<T>, (T: Schema) = list, "list[", [T];
    BTreeSet<T>, (T: Schema) = set, "set[", [T];
    HashSet<T, S>, (T: Schema, S) = set, "set[", [T];
    BTreeMap<K, V>, (K: Schema, V: Schema) = map, "map[", [K, V];
    HashMap<K, V, S>, (K: Schema, V: Schema, S) = map, "map[", [K, V];
    Option<T>, (T: Schema) = option, "option[", [T];
}

impl<T: Schema + ?Sized> Schema for Box<T> {
    const HASH: u64 = T::HASH;

    fn describe(text: &mut String) -> bool {
        T::describe(text)
    }
}

/// As serde encodes it: seconds and nanoseconds.
impl Schema for std::time::Duration {
    const HASH: u64 = structure(&[("secs", u64::HASH), ("nanos", u32::HASH)]);

    fn describe(text: &mut String) -> bool {
        describe_structure(text, &[("secs", u64::describe), ("nanos", u32::describe)])
    }
}

macro_rules! tuples {
    ($(($($type:ident $position:literal),*))*) => {
        $(impl<$($type: Schema),*> Schema for ($($type,)*) {
            const HASH: u64 = structure(&[$(($position, $type::HASH)),*]);

            fn describe(text: &mut String) -> bool {
                describe_structure(text, &[$(($position, $type::describe)),*])
            }
        })*
    };
}

tuples! {
    ()
    (A "0")
    (A "0", B "1")
    (A "0", B "1", C "2")
    (A "0", B "1", C "2", D "3")
    (A "0", B "1", C "2", D "3", E "4")
    (A "0", B "1", C "2", D "3", E "4", F "5")
}
