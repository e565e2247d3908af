//! Values at the ends of what a type and a message allow.

use serde_json::{Value as Json, json};
use sm2_ros::{EncodeError, decode, encode, place};
use sm2_ros_idl::{Set, TypeName};

fn name() -> TypeName {
    "p/msg/T".parse().unwrap()
}

fn set(text: &str) -> Set {
    let mut set = Set::default();
    set.add(&name(), text).unwrap();
    set
}

fn encoded(text: &str, value: &Json) -> Result<Vec<u8>, EncodeError> {
    encode(&set(text), &name(), value)
}

/// The JSON of the message of some JSON.
fn there_and_back(text: &str, value: &Json) -> Json {
    let bytes = encoded(text, value).unwrap_or_else(|error| panic!("{text}: {error}"));
    let set = set(text);
    let value = decode(&set, &name(), &bytes, usize::MAX).unwrap();
    serde_json::to_value(&value).unwrap()
}

#[test]
fn numbers_that_json_does_not_have_are_texts() {
    for ty in ["float32", "float64"] {
        let text = format!("{ty} a\n{ty}[] b");
        let value = json!({"a": "NaN", "b": ["inf", "-inf", "NaN", 1.5]});
        assert_eq!(there_and_back(&text, &value), value);
        for other in ["nan", "infinity", "+inf", "1.5", ""] {
            let error = encoded(&text, &json!({"a": other})).unwrap_err();
            assert!(
                matches!(error, EncodeError::Value { .. }),
                "{other}: {error}"
            );
        }
    }
    for ty in ["int8", "uint64", "bool", "char"] {
        assert!(
            encoded(&format!("{ty} a"), &json!({"a": "NaN"})).is_err(),
            "{ty}"
        );
    }
}

#[test]
fn integers_have_their_least_and_greatest_value() {
    for (ty, least, greatest) in [
        ("int8", i128::from(i8::MIN), i128::from(i8::MAX)),
        ("int16", i16::MIN.into(), i16::MAX.into()),
        ("int32", i32::MIN.into(), i32::MAX.into()),
        ("int64", i64::MIN.into(), i64::MAX.into()),
        ("byte", 0, u8::MAX.into()),
        ("char", 0, u8::MAX.into()),
        ("uint8", 0, u8::MAX.into()),
        ("uint16", 0, u16::MAX.into()),
        ("uint32", 0, u32::MAX.into()),
        ("uint64", 0, u64::MAX.into()),
    ] {
        let text = format!("{ty} a");
        let of = |number: i128| serde_json::from_str(&format!("{{\"a\": {number}}}")).unwrap();
        for number in [least, greatest] {
            assert_eq!(there_and_back(&text, &of(number)), of(number), "{ty}");
        }
        for number in [least - 1, greatest + 1] {
            let error = encoded(&text, &of(number)).unwrap_err();
            assert!(
                matches!(error, EncodeError::Value { .. }),
                "{ty} {number}: {error}"
            );
        }
    }
}

/// A text has as many bytes in UTF-8, or units of UTF-16, as its type allows, and a sequence as many elements.
#[test]
fn limits_include_their_last_value() {
    for (ty, fits, does_not) in [
        ("string<=3", json!("abc"), json!("abcd")),
        ("string<=3", json!("€"), json!("€a")),
        ("wstring<=3", json!("€€€"), json!("€€€€")),
        ("wstring<=3", json!("🤖a"), json!("🤖🤖")),
        ("int8[<=2]", json!([1, 2]), json!([1, 2, 3])),
        ("string[<=1]", json!(["a"]), json!(["a", "b"])),
        ("int8[2]", json!([1, 2]), json!([1])),
        ("int8[2]", json!([1, 2]), json!([1, 2, 3])),
        ("string[1]", json!(["a"]), json!([])),
    ] {
        let text = format!("{ty} a");
        let value = json!({ "a": fits });
        assert_eq!(there_and_back(&text, &value), value, "{ty}");
        let error = encoded(&text, &json!({ "a": does_not })).unwrap_err();
        assert!(
            error.to_string().starts_with("a: expected "),
            "{ty}: {error}"
        );
    }
}

/// Elements after the last field would be left over, and the elements of the last field end with the message.
#[test]
fn the_last_elements_of_a_message_may_be_its_last_bytes() {
    for (text, value, len_bytes) in [
        ("uint8[] a", json!({"a": [1, 2, 3]}), 11),
        ("bool[] a", json!({"a": [true, false]}), 10),
        ("uint8[3] a", json!({"a": [1, 2, 3]}), 7),
        ("bool[2] a", json!({"a": [true, false]}), 6),
        // Numbers are aligned where there are any.
        ("float64[] a\nuint8 b", json!({"a": [], "b": 7}), 9),
        ("float64[] a\nuint8 b", json!({"a": [0.5], "b": 7}), 21),
        ("wstring a\nuint8 b", json!({"a": "", "b": 7}), 9),
    ] {
        let bytes = encoded(text, &value).unwrap();
        assert_eq!(bytes.len(), len_bytes, "{text}: {bytes:?}");
        assert_eq!(there_and_back(text, &value), value, "{text}");
        // The fields one by one end where the message does.
        let set = set(text);
        let fields = &set.get(&name()).unwrap().fields;
        let end = fields.iter().try_fold(place::START, |at, field| {
            let (_, next) = place::read(&set, &field.ty, &*bytes, at)?;
            assert_eq!(
                place::skip(&set, &field.ty, &*bytes, at),
                Ok(next),
                "{text}"
            );
            Ok::<_, sm2_ros::DecodeError>(next)
        });
        assert_eq!(end, Ok(bytes.len()), "{text}");
    }
}

/// A message has 64 MiB at most. Units of UTF-16 have two bytes each.
#[test]
fn the_longest_message_is_refused_before_it_is_written() {
    const MOST: usize = 64 << 20;
    for (text, units) in [
        ("string a", MOST),
        ("wstring a", MOST / 2),
        ("wstring a", MOST * 2 / 3),
    ] {
        let error = encoded(text, &json!({"a": "x".repeat(units)})).unwrap_err();
        assert!(
            matches!(error, EncodeError::TooLong { max: MOST, .. }),
            "{text}: {error}"
        );
    }
    for text in [
        format!("uint8[{MOST}] a"),
        format!("float64[{}] a", MOST / 8),
        format!("string[{MOST}] a"),
    ] {
        let error = encoded(&text, &json!({})).unwrap_err();
        assert!(
            matches!(error, EncodeError::TooLong { max: MOST, .. }),
            "{text}: {error}"
        );
    }
    let bytes = encoded("string a", &json!({"a": "x".repeat(MOST - 64)})).unwrap();
    assert!(
        bytes.len() > MOST - 64 && bytes.len() <= MOST,
        "{}",
        bytes.len()
    );
}
