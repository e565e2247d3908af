//! Postcard messages: the output of the postcard crate decodes to the JSON that serde_json writes.

use std::collections::{BTreeMap, BTreeSet};

use proptest::{
    collection::{btree_map, btree_set, vec},
    option,
    prelude::*,
};
use serde::{Deserialize, Serialize};
use sm2_node::Message;

use super::{ALL, schema, schema_of};
use crate::decode::{Value, decode, encode};

#[derive(Message, Serialize, Deserialize, Clone, Debug, PartialEq)]
#[message(name = "tests/Everything", encoding = "postcard")]
struct Everything {
    unsigned: (u8, u16, u32, u64),
    signed: (i8, i16, i32, i64),
    floats: (f32, f64),
    flag: bool,
    letter: char,
    name: String,
    nothing: (),
    modes: Vec<Mode>,
    metres: Metres,
    fixed: [u16; 3],
    labels: BTreeMap<String, Option<i32>>,
    numbered: BTreeMap<i16, bool>,
    set: BTreeSet<char>,
    pairs: Option<Vec<(i64, String)>>,
}

#[derive(sm2_node::Schema, Serialize, Deserialize, Clone, Debug, PartialEq)]
enum Mode {
    Idle,
    Wait(u32),
    Follow { speed: f64, r#type: Box<str> },
    Go(i8, Metres),
}

#[derive(sm2_node::Schema, Serialize, Deserialize, Clone, Debug, PartialEq)]
struct Metres(f32);

#[derive(Message, Serialize, Deserialize, Clone, Debug, PartialEq)]
#[message(name = "tests/Wide", encoding = "postcard")]
struct Wide {
    number: u128,
    signed: i128,
    /// Keys that JSON objects cannot have.
    pairs: BTreeMap<(u8, u8), u128>,
}

fn f32s() -> impl Strategy<Value = f32> {
    any::<f32>().prop_filter("JSON has it", |it| it.is_finite())
}

fn f64s() -> impl Strategy<Value = f64> {
    any::<f64>().prop_filter("JSON has it", |it| it.is_finite())
}

fn modes() -> impl Strategy<Value = Mode> {
    prop_oneof![
        Just(Mode::Idle),
        any::<u32>().prop_map(Mode::Wait),
        (f64s(), ".{0,5}").prop_map(|(speed, name)| Mode::Follow {
            speed,
            r#type: name.into()
        }),
        (any::<i8>(), f32s()).prop_map(|(number, metres)| Mode::Go(number, Metres(metres))),
    ]
}

prop_compose! {
    fn everything()(
        (unsigned, signed) in any::<((u8, u16, u32, u64), (i8, i16, i32, i64))>(),
        floats in (f32s(), f64s()),
        (flag, letter) in any::<(bool, char)>(),
        name in ".{0,9}",
        modes in vec(modes(), 0..5),
        metres in f32s().prop_map(Metres),
        fixed in any::<[u16; 3]>(),
        labels in btree_map(".{0,3}", any::<Option<i32>>(), 0..4),
        numbered in btree_map(any::<i16>(), any::<bool>(), 0..4),
        set in btree_set(any::<char>(), 0..4),
        pairs in option::of(vec((any::<i64>(), ".{0,3}"), 0..4)),
    ) -> Everything {
        Everything {
            unsigned, signed, floats, flag, letter, name, nothing: (), modes, metres, fixed,
            labels, numbered, set, pairs,
        }
    }
}

proptest! {
    #[test]
    fn whatever_postcard_encodes_is_read_as_serde_shows_it(message in everything()) {
        let bytes = postcard::to_allocvec(&message).unwrap();
        let schema = schema_of::<Everything>();
        let value = decode(&schema, &bytes, ALL).unwrap();
        let found = serde_json::to_value(&value).unwrap();
        prop_assert_eq!(&found, &serde_json::to_value(&message).unwrap());
        // The texts are compared too: serde_json writes f32 and f64 in different ways.
        prop_assert_eq!(serde_json::to_string(&value).unwrap(), serde_json::to_string(&message).unwrap());
        let encoded = encode(&schema, &found).unwrap();
        prop_assert_eq!(postcard::from_bytes::<Everything>(&encoded).unwrap(), message);
    }

    #[test]
    fn wide_numbers_keep_their_value(
        (number, signed) in any::<(u128, i128)>(),
        pairs in btree_map(any::<(u8, u8)>(), any::<u128>(), 0..4),
    ) {
        let message = Wide { number, signed, pairs };
        let bytes = postcard::to_allocvec(&message).unwrap();
        let schema = schema_of::<Wide>();
        let value = decode(&schema, &bytes, ALL).unwrap();
        let found = serde_json::to_value(&value).unwrap();
        prop_assert_eq!(&found["number"], &number.to_string());
        prop_assert_eq!(&found["signed"], &signed.to_string());
        prop_assert_eq!(encode(&schema, &found).unwrap(), bytes);
    }

    #[test]
    fn a_head_is_the_beginning(numbers in vec(any::<Vec<i32>>(), 0..9), keep in 0..9_usize) {
        let bytes = postcard::to_allocvec(&numbers).unwrap();
        let schema = schema("postcard:list[list[i32]]");
        let value = decode(&schema, &bytes, keep).unwrap();
        let Value::List { items, more } = value else { panic!("{value:?}") };
        let kept = keep.min(numbers.len());
        prop_assert_eq!(more, (numbers.len() - kept) as u64);
        prop_assert_eq!(items.len(), kept);
        for (item, expected) in items.iter().zip(&numbers) {
            let Value::List { items, more } = item else { panic!("{item:?}") };
            prop_assert_eq!(items.len() as u64 + more, expected.len() as u64);
            for (item, expected) in items.iter().zip(expected) {
                prop_assert_eq!(item, &Value::Signed((*expected).into()));
            }
        }
    }
}

fn error(text: &str, bytes: &[u8]) -> String {
    decode(&schema(text), bytes, ALL).unwrap_err().to_string()
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    let cases: [(&str, &[u8], &str); 14] = [
        ("u8", &[], "message: the message is cut short, at byte 0"),
        ("u8", &[1, 2, 3], "message: 2 bytes too many, at byte 1"),
        ("bool", &[2], "message: 2 is not a boolean, at byte 0"),
        (
            "u16",
            &[0xff, 0xff, 4],
            "message: a number beyond its type, at byte 0",
        ),
        (
            "u16",
            &[0xff, 0xff, 0x83, 0],
            "message: a number beyond its type, at byte 0",
        ),
        (
            "char",
            &[2, b'a', b'b'],
            "message: not one character, at byte 0",
        ),
        (
            "string",
            &[2, b'a', 0xff],
            "message: text that is not UTF-8, at byte 2",
        ),
        (
            "string",
            &[3, b'a', b'b'],
            "message: the message is cut short, at byte 1",
        ),
        (
            "option[u8]",
            &[2, 0],
            "message: 2 says neither that there is a value nor that there is none, at byte 0",
        ),
        (
            "enum{A:struct{},}",
            &[1],
            "message: there is no variant 1, at byte 0",
        ),
        (
            "struct{points:list[struct{x:u8,y:bool,}],}",
            &[2, 7, 1, 8, 3],
            "points[1].y: 3 is not a boolean, at byte 4",
        ),
        (
            "map[string,struct{0:u8,1:bool,}]",
            &[1, 0, 1, 9],
            "[0].value[1]: 9 is not a boolean, at byte 3",
        ),
        (
            "enum{A:struct{on:bool,},}",
            &[0, 5],
            "A.on: 5 is not a boolean, at byte 1",
        ),
        (
            "struct{a\u{202e}:bool,}",
            &[5],
            "a\\u{202e}: 5 is not a boolean, at byte 0",
        ),
    ];
    for (ty, bytes, expected) in cases {
        assert_eq!(error(&format!("postcard:{ty}"), bytes), expected);
    }
}

/// A large length in a message causes no use of memory or time.
#[test]
fn lengths_that_lie_end_soon() {
    let huge = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1];
    for ty in ["list[u8]", "string", "map[u8,u8]", "set[list[u64]]"] {
        assert!(
            error(&format!("postcard:{ty}"), &huge).contains("cut short"),
            "{ty}"
        );
    }
    for ty in [
        "list[struct{}]",
        "map[struct{},struct{}]",
        "list[array[u8;0000000000000000]]",
    ] {
        let schema = schema(&format!("postcard:{ty}"));
        for keep in [0, 1, ALL] {
            let error = decode(&schema, &huge, keep).unwrap_err().to_string();
            assert!(
                error.contains("more values than its length justifies"),
                "{ty}: {error}"
            );
        }
    }
    let few = schema("postcard:list[struct{}]");
    assert!(decode(&few, &[100], ALL).is_ok());
}

/// Elements that are not kept are skipped at once, or one by one.
#[test]
fn what_is_not_kept_is_still_counted_and_bounded() {
    let points: Vec<(f64, u8)> = (0..100).map(|it| (f64::from(it), 1)).collect();
    let counts: Vec<(u32, u8)> = (0..100).map(|it| (it << 7, 1)).collect();
    let cases = [
        ("list[struct{0:f64,1:u8,}]", postcard::to_allocvec(&points)),
        ("list[struct{0:u32,1:u8,}]", postcard::to_allocvec(&counts)),
    ];
    for (ty, bytes) in cases {
        let schema = schema(&format!("postcard:{ty}"));
        let mut bytes = bytes.unwrap();
        for keep in [0, 1, 99, 100, 101] {
            let value = decode(&schema, &bytes, keep).unwrap();
            let Value::List { items, more } = value else {
                panic!("{value:?}");
            };
            assert_eq!(
                (items.len(), more),
                (keep.min(100), 100 - keep.min(100) as u64)
            );
        }
        bytes.push(0);
        let more = decode(&schema, &bytes, 1).unwrap_err().to_string();
        assert!(more.contains("1 byte too many"), "{more}");
        bytes.truncate(bytes.len() - 2);
        let less = decode(&schema, &bytes, 1).unwrap_err().to_string();
        assert!(less.contains("cut short"), "{less}");
    }
}
