//! Harnesses for schema texts: a text is read back unchanged, and its hash follows from it.

use alloc::string::{String, ToString};

use super::Schema;
use crate::proofs::{below, one_of};

const LEAVES: [&str; 4] = ["u8", "f64", "bool", "string"];

/// FNV-1a of a text.
fn fnv(text: &str) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for byte in text.bytes() {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    hash
}

/// The hash of `open`, the parts as their hashes with commas between them, and `close`.
fn hash(open: &str, parts: &[u64], close: &str) -> u64 {
    let mut text = String::from(open);
    for (at, part) in parts.iter().enumerate() {
        if at > 0 {
            text.push(',');
        }
        for shift in (0..16).rev() {
            let digit = (part >> (4 * shift)) as usize & 15;
            text.push(char::from(b"0123456789abcdef"[digit]));
        }
    }
    text.push_str(close);
    fnv(&text)
}

/// Puts a type into another one, or leaves it as it is: its text, and its hash by Annex A.
fn wrap(inner: &str, part: u64) -> (String, u64) {
    let (open, close, hash) = match below(6) {
        0 => ("", "", part),
        1 => ("list[", "]", hash("list[", &[part], "]")),
        2 => ("set[", "]", hash("set[", &[part], "]")),
        3 => ("option[", "]", hash("option[", &[part], "]")),
        4 => {
            let close = ";000000000000000a]";
            ("array[", close, hash("array[", &[part], close))
        }
        _ => ("map[u8,", "]", hash("map[", &[fnv("u8"), part], "]")),
    };
    let mut text = String::new();
    for piece in [open, inner, close] {
        text.push_str(piece);
    }
    (text, hash)
}

/// The hash of a type follows from the hashes of its parts, and from nothing else.
//= SM2-NAM-003, SM2-TYP-001 kani
// Shows TYP-HASH (Exhaustive), bound: 4 leaves in up to 2 of 5 types, 4 encodings.
#[cfg_attr(kani, kani::proof)]
// Texts of at most 70 bytes.
#[cfg_attr(kani, kani::unwind(72))]
fn hashes_follow_from_the_parts() {
    let leaf = one_of(&LEAVES);
    let (text, part) = wrap(leaf, fnv(leaf));
    let (text, part) = wrap(&text, part);
    let encoding = one_of(&["plain", "postcard", "json", "own-1"]);
    let mut whole = String::new();
    for piece in [encoding, ":"] {
        whole.push_str(piece);
    }
    let expected = hash(&whole, &[part], "");
    whole.push_str(&text);
    let schema = Schema::parse(&whole).expect("a schema");
    assert_eq!(schema.hash(), expected);
    assert!(schema.to_string() == whole);
    let other = Schema::parse("plain:u8").expect("a schema").hash();
    assert_eq!(schema.hash() == other, whole == "plain:u8");
    kani::cover!(text.len() > 40, "a type in a type");
    kani::cover!(whole == "plain:u8", "the other one");
}

/// A text with one byte changed is not a schema any more, or the schema of just that text.
//= SM2-TYP-001 kani
// Shows TYP-HASH (Exhaustive), bound: 4 texts, any ASCII byte at any place.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(72))]
fn texts_have_one_meaning() {
    let text = one_of(&[
        "plain:struct{a:u8,b:list[f64],}",
        "json:enum{A:struct{},B:struct{0:u8,},}",
        "postcard:map[string,option[bool]]",
        "x-1:array[u8;0000000000000003]",
    ]);
    let mut bytes = [0; 48];
    bytes[..text.len()].copy_from_slice(text.as_bytes());
    let at = below(text.len());
    let was = bytes[at];
    bytes[at] = kani::any_where(|byte: &u8| byte.is_ascii());
    let changed = bytes[at] != was;
    let Ok(text) = core::str::from_utf8(&bytes[..text.len()]) else {
        panic!("it is ASCII");
    };
    let schema = Schema::parse(text);
    assert!(changed || schema.is_ok());
    kani::cover!(schema.is_ok() && changed, "another schema");
    kani::cover!(schema.is_err(), "none");
    if let Ok(schema) = schema {
        assert!(schema.to_string() == text);
    }
}

/// A definition with one byte changed has no schema text any more, or another one. The hash of the
/// type follows from the first line.
//= SM2-NAM-003, SM2-TYP-002 kani
// Shows TYP-HASH (Exhaustive), bound: 1 text, any ASCII byte at any place.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(92))]
fn definitions_have_one_meaning() {
    const LINE: usize = 75;
    let text = concat!(
        "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\n",
        "string data\n",
    );
    let mut bytes = [0; 88];
    bytes.copy_from_slice(text.as_bytes());
    let at = below(text.len());
    let was = bytes[at];
    bytes[at] = kani::any_where(|byte: &u8| byte.is_ascii());
    let changed = bytes[at] != was;
    let Ok(text) = core::str::from_utf8(&bytes) else {
        panic!("it is ASCII");
    };
    let schema = Schema::parse(text);
    assert!(changed || schema.is_ok());
    kani::cover!(schema.is_ok() && changed, "another schema");
    kani::cover!(schema.is_err(), "none");
    if let Ok(schema) = schema {
        assert!(schema.to_string() == text);
        assert_eq!(schema.hash(), fnv(&text[..LINE]));
        assert!(
            text[LINE + 1..]
                .bytes()
                .all(|byte| byte == b'\n' || !byte.is_ascii_control())
        );
    }
}

#[cfg(test)]
kani::explored! {
    hashes_follow_from_the_parts: 2,
    texts_have_one_meaning: 2,
    definitions_have_one_meaning: 2,
}
