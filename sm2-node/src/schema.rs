//! Hashes of types' structures, so that two programs find out that they mean the same.
//!
//! A type's hash covers what its bytes depend on: the names and types of its
//! fields, in order. It covers neither the type's own name (which is compared beside
//! the hash, SM2-NAM-003) nor any Rust module, so that two crates, or two languages,
//! that define the same structure get the same hash.
//!
//! The hash of a type is FNV-1a (64 bits) of a text, in which the hashes of the types
//! that it is made of stand as 16 lower-case hexadecimal digits:
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
//! | `Box<T>` | as `T` |
//! | message | `plain:<type>`, `postcard:<type>`: the encoding and the type that is encoded |
//!
//! `usize` has none: its width depends on the machine.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};

/// A type whose structure has a hash. Derive it for what messages are made of.
///
/// A type that contains itself needs an implementation by hand, since its hash
/// cannot be made of its parts: `const HASH: u64 = sm2_node::schema::text("tree, version 1");`
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no schema",
    note = "derive it: `#[derive(sm2_node::Schema)]`",
    note = "instead of `usize` and `isize` use a type whose width is the same everywhere"
)]
pub trait Schema {
    /// The hash of the structure: see the [module](self).
    const HASH: u64;
}

/// The hash of a text.
#[must_use]
pub const fn text(text: &str) -> u64 {
    Hasher::new().text(text).0
}

/// The hash of a structure with these fields: name and hash of the type.
#[must_use]
pub const fn structure(fields: &[(&str, u64)]) -> u64 {
    members("struct{", fields)
}

/// The hash of an enumeration with these variants: name and hash of the fields.
#[must_use]
pub const fn enumeration(variants: &[(&str, u64)]) -> u64 {
    members("enum{", variants)
}

/// The hash of as many values of one type as a message says.
#[must_use]
pub const fn list(element: u64) -> u64 {
    Hasher::new().text("list[").hex(element).text("]").0
}

/// The hash of `len` values of one type.
#[must_use]
pub const fn array(element: u64, len: u64) -> u64 {
    let elements = Hasher::new().text("array[").hex(element);
    elements.text(";").hex(len).text("]").0
}

/// The hash of a message type: how its structure becomes bytes.
#[must_use]
pub const fn message(encoding: &str, structure: u64) -> u64 {
    Hasher::new().text(encoding).text(":").hex(structure).0
}

const fn members(open: &str, members: &[(&str, u64)]) -> u64 {
    let mut hasher = Hasher::new().text(open);
    let mut rest = members;
    while let [(name, hash), tail @ ..] = rest {
        hasher = hasher.text(name).text(":").hex(*hash).text(",");
        rest = tail;
    }
    hasher.text("}").0
}

/// FNV-1a, 64 bits.
struct Hasher(u64);

impl Hasher {
    const fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    const fn byte(self, byte: u8) -> Self {
        Self((self.0 ^ byte as u64).wrapping_mul(0x0000_0100_0000_01b3))
    }

    const fn text(mut self, text: &str) -> Self {
        let mut rest = text.as_bytes();
        while let [byte, tail @ ..] = rest {
            self = self.byte(*byte);
            rest = tail;
        }
        self
    }

    const fn hex(mut self, value: u64) -> Self {
        let mut shift = 64;
        while shift > 0 {
            shift -= 4;
            self = self.byte(b"0123456789abcdef"[(value >> shift) as usize & 0xf]);
        }
        self
    }
}

macro_rules! named {
    ($($type:ty = $name:literal),* $(,)?) => {
        $(impl Schema for $type { const HASH: u64 = text($name); })*
    };
}

named! {
    u8 = "u8", u16 = "u16", u32 = "u32", u64 = "u64", u128 = "u128",
    i8 = "i8", i16 = "i16", i32 = "i32", i64 = "i64", i128 = "i128",
    f32 = "f32", f64 = "f64", bool = "bool", char = "char",
    str = "string", String = "string",
}

/// Numbers without alignment, whose bytes are those of the number on a machine that
/// counts them from the little end, as all do that SM2 runs on.
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
}

macro_rules! lists {
    ($($type:ty),*) => {
        $(impl<T: Schema> Schema for $type { const HASH: u64 = list(T::HASH); })*
    };
}

lists!([T], Vec<T>, VecDeque<T>);

const fn set(element: u64) -> u64 {
    Hasher::new().text("set[").hex(element).text("]").0
}

const fn map(key: u64, value: u64) -> u64 {
    let key = Hasher::new().text("map[").hex(key);
    key.text(",").hex(value).text("]").0
}

impl<T: Schema> Schema for BTreeSet<T> {
    const HASH: u64 = set(T::HASH);
}

impl<T: Schema, S> Schema for HashSet<T, S> {
    const HASH: u64 = set(T::HASH);
}

impl<K: Schema, V: Schema> Schema for BTreeMap<K, V> {
    const HASH: u64 = map(K::HASH, V::HASH);
}

impl<K: Schema, V: Schema, S> Schema for HashMap<K, V, S> {
    const HASH: u64 = map(K::HASH, V::HASH);
}

impl<T: Schema> Schema for Option<T> {
    const HASH: u64 = Hasher::new().text("option[").hex(T::HASH).text("]").0;
}

impl<T: Schema + ?Sized> Schema for Box<T> {
    const HASH: u64 = T::HASH;
}

/// As serde encodes it: whole seconds and nanoseconds.
impl Schema for std::time::Duration {
    const HASH: u64 = structure(&[("secs", u64::HASH), ("nanos", u32::HASH)]);
}

macro_rules! tuples {
    ($(($($type:ident $position:literal),*))*) => {
        $(impl<$($type: Schema),*> Schema for ($($type,)*) {
            const HASH: u64 = structure(&[$(($position, $type::HASH)),*]);
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
