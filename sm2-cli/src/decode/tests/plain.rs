//! Plain messages: the bytes of a zerocopy value decode to that value.

use proptest::{collection::vec, prelude::*};
use serde::Serialize;
use sm2_node::Message;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, little_endian as le};

use super::{ALL, schema, schema_of};
use crate::decode::{DecodeError, Value, decode, encode, error::Wrong};

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Serialize)]
#[message(name = "sensor/Imu")]
#[repr(C, packed)]
struct Imu {
    stamp_ns: u64,
    temperature: i16,
    acceleration: [f64; 3],
    pose: Pose,
    wide: u128,
    signed: i128,
    small: i8,
}

#[derive(
    sm2_node::Schema, FromBytes, IntoBytes, Immutable, KnownLayout, Serialize, Clone, Copy,
)]
#[repr(C, packed)]
struct Pose(f32, i64);

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Image")]
#[repr(C)]
struct Image {
    width: le::U32,
    pixels: [[u8; 3]],
}

fn json(text: &str, bytes: &[u8]) -> serde_json::Value {
    let schema = schema(text);
    let value = decode(&schema, bytes, ALL).unwrap();
    serde_json::to_value(value).unwrap()
}

fn error(text: &str, bytes: &[u8]) -> String {
    decode(&schema(text), bytes, ALL).unwrap_err().to_string()
}

/// A float that JSON can express.
fn float() -> impl Strategy<Value = f64> {
    any::<f64>().prop_filter("JSON has it", |it| it.is_finite())
}

proptest! {
    #[test]
    fn a_structure_is_what_it_was(
        (stamp_ns, temperature, small) in any::<(u64, i16, i8)>(),
        acceleration in [float(), float(), float()],
        pose in (any::<f32>().prop_filter("JSON has it", |it| it.is_finite()), any::<i64>()),
        (wide, signed) in any::<(u128, i128)>(),
    ) {
        let imu = Imu {
            stamp_ns, temperature, acceleration, pose: Pose(pose.0, pose.1), wide, signed, small,
        };
        let schema = schema_of::<Imu>();
        let value = decode(&schema, imu.as_bytes(), ALL).unwrap();
        let found = serde_json::to_value(&value).unwrap();
        let expected = serde_json::json!({
            "stamp_ns": stamp_ns, "temperature": temperature, "acceleration": acceleration,
            "pose": [pose.0, pose.1], "wide": wide.to_string(), "signed": signed.to_string(),
            "small": small,
        });
        prop_assert_eq!(&found, &expected);
        prop_assert_eq!(encode(&schema, &found).unwrap(), imu.as_bytes());
    }

    #[test]
    fn a_list_is_what_it_was(width in any::<u32>(), pixels in vec(any::<[u8; 3]>(), 0..20)) {
        let mut bytes = width.to_le_bytes().to_vec();
        bytes.extend(pixels.iter().flatten());
        let schema = schema_of::<Image>();
        let value = decode(&schema, &bytes, ALL).unwrap();
        let found = serde_json::to_value(&value).unwrap();
        prop_assert_eq!(&found, &serde_json::json!({ "width": width, "pixels": pixels }));
        prop_assert_eq!(encode(&schema, &found).unwrap(), bytes);
    }

    #[test]
    fn a_head_of_a_list_is_its_beginning(numbers in vec(any::<u32>(), 0..20), keep in 0..20_usize) {
        let schema = schema_of::<[u32]>();
        let value = decode(&schema, numbers.as_bytes(), keep).unwrap();
        let Value::List { items, more } = value else { panic!("{value:?}") };
        let expected: Vec<_> = numbers.iter().map(|it| Value::Unsigned((*it).into())).collect();
        let kept = keep.min(numbers.len());
        prop_assert_eq!(&items[..], &expected[..kept]);
        prop_assert_eq!(more, (numbers.len() - kept) as u64);
    }
}

#[test]
fn booleans_characters_and_text_are_checked() {
    let text = "plain:struct{on:bool,c:char,}";
    assert_eq!(
        json(text, &[1, 0x4c, 0x75, 0, 0]),
        serde_json::json!({ "on": true, "c": "界" })
    );
    assert_eq!(
        error(text, &[2, 0, 0, 0, 0]),
        "on: 2 is not a boolean, at byte 0"
    );
    assert_eq!(
        error(text, &[0, 0, 0xd8, 0, 0]),
        "c: 0xd800 is not a character, at byte 1"
    );
    assert_eq!(json("plain:string", "grüße".as_bytes()), "grüße");
    assert_eq!(
        error("plain:string", b"ab\xff"),
        "message: text that is not UTF-8, at byte 2"
    );
    assert_eq!(json("plain:struct{}", b""), serde_json::Value::Null);
}

#[test]
fn numbers_that_json_has_not_are_texts() {
    let floats = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    let expected = serde_json::json!(["NaN", "inf", "-inf"]);
    assert_eq!(json("plain:list[f64]", floats.as_bytes()), expected);
    let single = floats.map(|it| it as f32);
    assert_eq!(json("plain:list[f32]", single.as_bytes()), expected);
    let encoded = encode(&schema("plain:list[f64]"), &expected).unwrap();
    assert!(f64::from_le_bytes(encoded[..8].try_into().unwrap()).is_nan());
    assert_eq!(encoded[8..], *floats[1..].as_bytes());
}

#[test]
fn a_length_that_does_not_fit_is_an_error() {
    let array = "plain:array[u32;0000000000000003]";
    assert_eq!(
        error(array, &[0; 11]),
        "11 bytes cannot be a message of this type, which has 12"
    );
    assert_eq!(
        error("plain:struct{n:u8,l:list[u16],}", &[0; 4]),
        "4 bytes cannot be a message of this type, which has 1 and any multiple of 2"
    );
    assert_eq!(
        error("plain:struct{s:string,}", &[0; 4]),
        "its schema is of no plain type: plain messages hold numbers, booleans, characters, \
         arrays and structures only"
    );
    assert_eq!(
        error("cbor:u8", &[0]),
        "its encoding cbor is not known here"
    );
}

/// Elements of size zero: a message of no bytes may have any number of them.
#[test]
fn nothing_does_not_become_much() {
    let schema = schema("plain:array[struct{};ffffffffffffffff]");
    let found = decode(&schema, &[], ALL);
    assert!(
        matches!(
            &found,
            Err(DecodeError::Value {
                wrong: Wrong::TooMany,
                ..
            })
        ),
        "{found:?}"
    );
    let Ok(Value::List { items, more }) = decode(&schema, &[], 3) else {
        panic!("three can be shown");
    };
    assert_eq!((items.len(), more), (3, u64::MAX - 3));
}
