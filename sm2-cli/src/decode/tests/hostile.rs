//! Hostile bytes and schemas cause no panic and no excessive use of memory.

use proptest::{collection::vec, prelude::*, sample::select};

use super::{ALL, LINE, schema};
use crate::decode::{DecodeError, Limits, Value, decode, encode, show};

const TYPES: &[&str] = &[
    "u8",
    "i128",
    "char",
    "string",
    "bool",
    "struct{}",
    "list[u8]",
    "list[struct{}]",
    "set[option[char]]",
    "map[string,list[i64]]",
    "array[struct{a:u16,b:f32,};0000000000000002]",
    "array[array[struct{};ffffffffffffffff];ffffffffffffffff]",
    "enum{}",
    "list[list[list[list[list[list[struct{}]]]]]]",
    "enum{A:struct{},B:struct{0:string,},C:struct{x:list[enum{A:struct{},}],y:u128,},}",
    "struct{a:u8,b:struct{c:list[struct{x:i8,y:u16,}],},}",
];

fn types() -> impl Strategy<Value = String> {
    (select(&["plain", "postcard", "json"][..]), select(TYPES))
        .prop_map(|(encoding, ty)| format!("{encoding}:{ty}"))
}

/// The number of values in a tree.
fn count(value: &Value<'_>) -> usize {
    1 + match value {
        Value::List { items, .. } => items.iter().map(count).sum(),
        Value::Map { entries, .. } => entries.iter().map(|(a, b)| count(a) + count(b)).sum(),
        Value::Struct(fields) => fields.iter().map(|(_, it)| count(it)).sum(),
        Value::Variant(_, fields) => count(fields),
        _ => 0,
    }
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(
        text in types(),
        bytes in vec(any::<u8>(), 0..64),
        keep in select(&[0, 1, 5, ALL][..]),
    ) {
        let schema = schema(&text);
        if let Ok(value) = decode(&schema, &bytes, keep) {
            prop_assert!(count(&value) <= 2 * (16 * bytes.len() + 4_096));
            prop_assert!(show(&value, &Limits::SCREEN).len() < 17_000);
            prop_assert!(!show(&value, &LINE).contains('\n'));
            serde_json::to_string(&value).unwrap();
        }
    }

    #[test]
    fn no_json_makes_it_panic(text in types(), json in "[\\[\\]{}\":,0-9a-f.eE+\\- ]{0,40}") {
        let message = schema("json:u8");
        let _ = decode(&message, json.as_bytes(), ALL);
        if let Ok(given) = serde_json::from_str(&json) {
            let schema = schema(&text);
            if let Ok(bytes) = encode(&schema, &given) {
                prop_assert!(decode(&schema, &bytes, ALL).is_ok());
            }
        }
    }
}

#[test]
fn json_that_nests_for_ever_is_refused() {
    let schema = schema("json:u8");
    for len in [129, 1_000_000] {
        for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
            let text = format!("{}1{}", open.repeat(len), close.repeat(len));
            let found = decode(&schema, text.as_bytes(), ALL);
            assert!(matches!(&found, Err(DecodeError::Json(_))), "{found:?}");
        }
    }
    let deep = format!("{}1{}", "[".repeat(100), "]".repeat(100));
    assert!(decode(&schema, deep.as_bytes(), ALL).is_ok());
}

#[test]
fn json_keeps_digits_and_order() {
    let text = concat!(
        r#"{"z":[340282366920938463463374607431768211455],"#,
        r#""e":{"A":{"n":-170141183460469231731687303715884105728}},"#,
        r#""a":[-1,1.5,true,null,"\n"],"m":{"k":{}}}"#,
    );
    let schema = schema(
        "json:struct{a:u8,z:struct{0:list[u128],},e:enum{A:struct{n:i128,},},m:map[string,u8],}",
    );
    let value = decode(&schema, text.as_bytes(), ALL).unwrap();
    let expected = text
        .replace("3402823", "\"3402823")
        .replace("1455", "1455\"");
    let expected = expected
        .replace("-1701411", "\"-1701411")
        .replace("5728", "5728\"");
    assert_eq!(serde_json::to_string(&value).unwrap(), expected);
    let error = decode(&schema, b"{\"a\":1} x", ALL)
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("invalid JSON: trailing"), "{error}");
    let error = decode(&schema, b"\"\xff", ALL).unwrap_err().to_string();
    assert!(error.contains("UTF-8"), "{error}");
}

#[test]
fn a_head_of_json_is_its_beginning() {
    let schema = schema("json:struct{l:list[list[u8]],m:map[string,u8],}");
    let text = r#"{"l":[[1,2,3],[4],[5,6]],"m":{"b":1,"a":2,"c":3}}"#;
    let head = decode(&schema, text.as_bytes(), 2).unwrap();
    assert_eq!(
        show(&head, &LINE),
        r#"{l: [[1, 2, … 1 more], [4], … 1 more], m: {"b": 1, "a": 2, … 1 more}}"#
    );
}
