//! Messages in CDR, and bytes that are none. `sm2-ros/oracle` compares all types with another implementation.

use serde_json::{Value as Json, json};
use sm2_ros::{DecodeError, EncodeError, Fault, Value, decode, encode};
use sm2_ros_idl::{Set, TypeName};

fn name() -> TypeName {
    "p/msg/T".parse().unwrap()
}

fn set(text: &str) -> Set {
    let mut set = Set::default();
    set.add(&name(), text).unwrap();
    set
}

fn bytes(text: &str, value: &Json) -> Vec<u8> {
    encode(&set(text), &name(), value).unwrap()
}

fn json_of(value: &Value<'_>) -> Json {
    serde_json::to_value(value).unwrap()
}

fn fault(text: &str, bytes: &[u8]) -> (String, usize, Fault) {
    match decode(&set(text), &name(), bytes, usize::MAX) {
        Err(DecodeError::Value { path, at, fault }) => (path.to_string(), at, fault),
        other => panic!("{other:?}"),
    }
}

#[test]
fn numbers_are_aligned_behind_the_header() {
    let text = "uint8 a\nfloat64 b\nuint16[] c\nstring d";
    let value = json!({"a": 1, "b": 1.0, "c": [2, 3], "d": "x"});
    let expected = [
        &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0][..],
        &1f64.to_le_bytes(),
        &[2, 0, 0, 0, 2, 0, 3, 0, 2, 0, 0, 0, b'x', 0],
    ];
    let bytes = bytes(text, &value);
    assert_eq!(bytes, expected.concat());
    let set = set(text);
    let decoded = decode(&set, &name(), &bytes, usize::MAX).unwrap();
    assert_eq!(json_of(&decoded), value);
}

#[test]
fn both_byte_orders_are_read() {
    let text = "uint32 a\nwstring b";
    let little = [0, 1, 0, 0, 1, 2, 0, 0, 1, 0, 0, 0, 0xe4, 0];
    let big = [0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 1, 0, 0xe4];
    for bytes in [little, big] {
        let set = set(text);
        let value = decode(&set, &name(), &bytes, usize::MAX).unwrap();
        assert_eq!(json_of(&value), json!({"a": 0x201, "b": "ä"}));
    }
}

#[test]
fn missing_fields_have_their_defaults() {
    let text =
        "int8 a 7\nstring b 'x y'\nfloat32[2] c [1.5, -2]\nbool d True\nuint8[3] e\nstring f";
    let bytes = bytes(text, &json!({}));
    let set = set(text);
    let value = decode(&set, &name(), &bytes, usize::MAX).unwrap();
    let expected =
        json!({"a": 7, "b": "x y", "c": [1.5, -2.0], "d": true, "e": [0, 0, 0], "f": ""});
    assert_eq!(json_of(&value), expected);
}

#[test]
fn elements_that_are_not_kept_are_counted() {
    let text = "float64[] a\nbool[] b\nstring[] c";
    let value = json!({"a": [1, 2, 3], "b": [true, false], "c": ["x", "y", "z"]});
    let bytes = bytes(text, &value);
    let set = set(text);
    let decoded = decode(&set, &name(), &bytes, 1).unwrap();
    let Value::Struct(fields) = decoded else {
        panic!("{decoded:?}");
    };
    let more = fields.iter().map(|(_, value)| match value {
        Value::List { items, more } => (items.len(), *more),
        other => panic!("{other:?}"),
    });
    assert_eq!(more.collect::<Vec<_>>(), [(1, 2), (1, 1), (1, 2)]);
}

#[test]
fn wrong_bytes_have_a_place_and_a_reason() {
    let head = [0, 1, 0, 0];
    let with = |rest: &[u8]| [&head[..], rest].concat();
    let at = |path: &str, at, fault| (path.to_owned(), at, fault);
    assert_eq!(
        fault("int8 a", &[1, 0, 0, 0]),
        at("message", 0, Fault::Header)
    );
    assert_eq!(fault("int32 a", &with(&[1, 0])), at("a", 4, Fault::Short));
    assert_eq!(
        fault("int8 a", &with(&[0; 5])),
        at("message", 5, Fault::LeftOver(4))
    );
    assert_eq!(fault("bool a", &with(&[2])), at("a", 5, Fault::Bool(2)));
    assert_eq!(
        fault("bool[2] a", &with(&[1, 3])),
        at("a[1]", 6, Fault::Bool(3))
    );
    let text = [1, 0, 0, 0, b'x'];
    assert_eq!(
        fault("string a", &with(&text)),
        at("a", 9, Fault::Unterminated)
    );
    let text = [2, 0, 0, 0, 0xff, 0];
    assert_eq!(fault("string a", &with(&text)), at("a", 10, Fault::Unicode));
    let (len, max) = (3, 2);
    assert_eq!(
        fault("int8[<=2] a", &with(&[3, 0, 0, 0, 1, 2, 3])),
        at("a", 8, Fault::Limit { len, max })
    );
}

/// A length of 4 GiB in a message of a few bytes is refused before memory is allocated.
#[test]
fn a_hostile_length_costs_nothing() {
    let bytes = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0];
    for text in [
        "uint8[] a",
        "float64[] a",
        "string[] a",
        "string a",
        "wstring a",
    ] {
        // The fault is that of the length, before any element.
        let (path, at, fault) = fault(text, &bytes);
        assert_eq!((&*path, at, fault), ("a", 8, Fault::Short), "{text}");
    }
    let (path, at, short) = fault("float64[4294967295] a", &bytes);
    assert_eq!((&*path, at, short), ("a", 4, Fault::Short));
    let error = encode(&set("float64[4294967295] a"), &name(), &json!({})).unwrap_err();
    assert!(matches!(error, EncodeError::TooLong { .. }), "{error}");
}

/// Arrays of arrays that the JSON lacks are refused after a bounded number of steps, and so are long default values.
#[test]
fn a_message_of_missing_values_has_a_limit() {
    let blanks = format!("int8[] b [{}]", " ".repeat(3_000));
    let mut cases = vec![("U[2000] a", &*blanks)];
    if cfg!(feature = "slow") {
        cases.push(("U[3000] a", "V[3000] b"));
    }
    for (whole, part) in cases {
        let mut set = set(whole);
        set.add(&"p/msg/U".parse().unwrap(), part).unwrap();
        set.add(&"p/msg/V".parse().unwrap(), "").unwrap();
        let error = encode(&set, &name(), &json!({})).unwrap_err();
        assert!(matches!(error, EncodeError::Missing { .. }), "{error}");
    }
    // An array of numbers is one value.
    let bytes = encode(&set("uint16[5000000] a"), &name(), &json!({})).unwrap();
    assert!(bytes[4..] == vec![0; 10_000_000]);
}

/// The values inside values count.
#[test]
fn the_number_of_values_has_a_limit() {
    let mut set = set("T1[] a");
    set.add(&"p/msg/T1".parse().unwrap(), "uint8[63] a")
        .unwrap();
    limits_values(&set, 63);
}

/// 64 types inside each other around one byte: the message is short, and its values are not.
#[cfg(feature = "slow")]
#[test]
fn the_number_of_values_of_a_short_message_has_a_limit() {
    let mut set = set("T1[] a");
    for at in 1..64 {
        let (part, text) = (format!("p/msg/T{at}"), format!("T{} a", at + 1));
        let text = if at == 63 { "uint8 a" } else { &text };
        set.add(&part.parse().unwrap(), text).unwrap();
    }
    limits_values(&set, 1);
}

/// Decodes 70,000 elements of 64 values and so many bytes.
fn limits_values(set: &Set, element_bytes: usize) {
    let len = 70_000;
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend_from_slice(&u32::to_le_bytes(len));
    bytes.resize(8 + len as usize * element_bytes, 7);
    let error = decode(set, &name(), &bytes, usize::MAX).unwrap_err();
    let DecodeError::Value { fault, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(fault, Fault::Values);
    assert!(decode(set, &name(), &bytes, 10).is_ok());
}

#[test]
fn values_that_do_not_fit_have_a_path() {
    let mut set = set("U[] u\nuint8 a");
    let other = "p/msg/U".parse().unwrap();
    set.add(&other, "string<=2 s").unwrap();
    let error = |value: Json| encode(&set, &name(), &value).unwrap_err().to_string();
    assert_eq!(
        error(json!({"u": [{}, {"s": "abc"}]})),
        "u[1].s: expected a text of at most 2, found 3"
    );
    assert_eq!(error(json!({"a": 256})), "a: expected uint8, found 256");
    assert_eq!(
        error(json!([1])),
        "message: expected an object with the fields, found an array"
    );
    assert_eq!(
        error(json!({"u": [{"x": 1}]})),
        "u[0]: the type p/msg/U has no field x"
    );
}
