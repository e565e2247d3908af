//! Values at the ends of what a type and a message allow.

use serde_json::{Value as Json, json};
use sm2_ros::{
    DecodeError, EncodeError, Fault, Value,
    cdr::{Number, Writer},
    decode, encode, place,
    value::more,
};
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

/// The length of a message whose first field has `before` bytes, and whose second one is `value`.
fn len_behind(before: usize, field: &str, value: &Json) -> Result<usize, EncodeError> {
    let text = format!("uint8[{before}] a\n{field} b");
    let given = match value {
        Json::Null => json!({}),
        value => json!({ "b": value }),
    };
    encoded(&text, &given).map(|it| it.len())
}

/// A message is written if 16 bytes are left, with any last field, and never longer than 64 MiB.
#[test]
fn a_message_may_be_as_long_as_the_limit_says() {
    const MOST: usize = 64 << 20;
    let word = "x".repeat(100);
    let hundred = Json::from(vec![7; 100]);
    for (field, value, len_bytes) in [
        ("float64", json!(1.5), 8),
        ("float64", Json::Null, 8),
        ("int8", json!(1), 1),
        ("string", json!(word), 105),
        ("string", Json::Null, 5),
        ("wstring", json!(word), 204),
        ("int8[100]", hundred.clone(), 100),
        ("float64[100]", Json::Null, 800),
        ("uint16[]", hundred, 204),
    ] {
        let fits = len_behind(MOST - 4 - 16 - len_bytes, field, &value);
        let len = fits.unwrap_or_else(|error| panic!("{field}: {error}"));
        assert!((MOST - 16..=MOST).contains(&len), "{field}: {len}");
        for over in [1, 1_000] {
            let before = MOST - 4 - len_bytes + over;
            let error = len_behind(before, field, &value).unwrap_err();
            assert!(
                matches!(error, EncodeError::TooLong { max: MOST, .. }),
                "{field}: {error}"
            );
        }
    }
}

/// A text of a definition is the text itself, whatever else it could mean. Other values are as ROS 2 writes them.
#[test]
fn default_values_are_read_by_their_type() {
    let set = |text: &str| set(text);
    for (text, expected) in [
        ("string a plain words", json!("plain words")),
        ("string a 12", json!("12")),
        ("string a \"it's\"", json!("it's")),
        ("string a 'say \"so\"'", json!("say \"so\"")),
        ("wstring a true", json!("true")),
        ("string[] a ['x', 'y']", json!(["x", "y"])),
        ("string[2] a [\"x\", \"y\"]", json!(["x", "y"])),
        ("bool a True", json!(true)),
        ("bool[] a [True, false]", json!([true, false])),
        ("int16 a -7", json!(-7)),
        ("float64 a 1.5", json!(1.5)),
    ] {
        let bytes = encode(&set(text), &name(), &json!({}));
        let bytes = bytes.unwrap_or_else(|error| panic!("{text}: {error}"));
        let set = set(text);
        let value = decode(&set, &name(), &bytes, usize::MAX).unwrap();
        let json = serde_json::to_value(&value).unwrap();
        assert_eq!(json, json!({ "a": expected }), "{text}");
    }
}

/// Each row of the table at the head of the values.
#[test]
fn each_value_has_its_json() {
    let list = |items, more| Value::List { items, more };
    let map = |keys: Vec<Value<'static>>, more| {
        let entries = keys.into_iter().map(|key| (key, Value::Bool(true)));
        let entries = entries.collect();
        Value::Map { entries, more }
    };
    let digits = "340282366920938463463374607431768211455";
    let field = ("x".into(), Value::Signed(-1));
    for (value, expected) in [
        (Value::Bool(false), json!(false)),
        (Value::Unsigned(u64::MAX), json!(u64::MAX)),
        (Value::Signed(i64::MIN), json!(i64::MIN)),
        (Value::F32(0.5), json!(0.5)),
        (Value::F64(1e300), json!(1e300)),
        (Value::F32(f32::NAN), json!("NaN")),
        (Value::F32(f32::INFINITY), json!("inf")),
        (Value::F64(f64::NEG_INFINITY), json!("-inf")),
        (Value::Digits(digits.to_owned()), json!(digits)),
        (Value::Text("a".into()), json!("a")),
        (Value::Char('c'), json!("c")),
        (Value::Unit, Json::Null),
        (Value::Absent, Json::Null),
        (list(vec![Value::Unit], 0), json!([null])),
        (list(vec![], 1_000), json!(["… 1,000 more"])),
        (Value::Struct(vec![field.clone()]), json!({ "x": -1 })),
        (Value::Variant("On", Value::Unit.into()), json!("On")),
        (
            Value::Variant("At", Value::Struct(vec![field]).into()),
            json!({ "At": { "x": -1 } }),
        ),
        (map(vec![Value::Text("k".into())], 0), json!({ "k": true })),
        (map(vec![Value::Char('k')], 0), json!({ "k": true })),
        (map(vec![Value::Unsigned(7)], 0), json!({ "7": true })),
        (map(vec![Value::Signed(-7)], 0), json!({ "-7": true })),
        (map(vec![Value::Bool(true)], 0), json!({ "true": true })),
        (
            map(vec![Value::Digits(digits.to_owned())], 2),
            json!({ digits: true, "…": "… 2 more" }),
        ),
        (map(vec![Value::F64(0.5)], 0), json!([[0.5, true]])),
        (
            map(vec![Value::Text("k".into()), Value::Unit], 3),
            json!([["k", true], [null, true], "… 3 more"]),
        ),
    ] {
        assert_eq!(serde_json::to_value(&value).unwrap(), expected, "{value:?}");
    }
}

#[test]
fn digits_of_large_numbers_have_groups_of_three() {
    for (count, expected) in [
        (1, "… 1 more"),
        (999, "… 999 more"),
        (1_000, "… 1,000 more"),
        (12_345, "… 12,345 more"),
        (123_456, "… 123,456 more"),
        (u64::MAX, "… 18,446,744,073,709,551,615 more"),
    ] {
        assert_eq!(more(count), expected);
    }
}

/// Definitions can nest types 64 deep around a single byte, so values are counted, not bytes.
#[test]
fn exactly_as_many_values_are_kept_as_the_limit_says() {
    const MOST: u32 = 1 << 22;
    let set = set("bool[] a");
    let bytes = |len: u32| {
        let len_bytes = len as usize;
        [&[0, 1, 0, 0], &len.to_le_bytes()[..], &vec![1; len_bytes]].concat()
    };
    let most = bytes(MOST);
    let Value::Struct(fields) = decode(&set, &name(), &most, usize::MAX).unwrap() else {
        panic!("a message has fields");
    };
    let Value::List { items, more } = &fields[0].1 else {
        panic!("{:?}", fields[0].0);
    };
    assert_eq!((items.len(), *more), (MOST as usize, 0));
    let too_many = bytes(MOST + 1);
    let error = decode(&set, &name(), &too_many, usize::MAX).unwrap_err();
    let DecodeError::Value { fault, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(fault, Fault::Values);
}

/// Numbers, and the same numbers as bytes, behind a byte. No numbers need no alignment.
fn bytes_are_the_numbers<T: Number>(numbers: &[T], bytes: &[u8], len_bytes: usize) {
    let (mut one, mut other) = (Writer::new(Vec::new()), Writer::new(Vec::new()));
    one.bool(true);
    other.bool(true);
    one.numbers(numbers);
    other.number_bytes(bytes, size_of::<T>());
    assert_eq!((one.len_bytes(), other.len_bytes()), (len_bytes, len_bytes));
    let (one, other) = (one.into_sink(), other.into_sink());
    assert_eq!((&one, one.len()), (&other, len_bytes));
}

#[test]
fn numbers_that_are_bytes_already_are_written_as_numbers() {
    bytes_are_the_numbers(&[7_u8, 8], &[7, 8], 4 + 1 + 2);
    bytes_are_the_numbers(&[0x201_u16, 0x403], &[1, 2, 3, 4], 4 + 2 + 4);
    bytes_are_the_numbers(&[1_u32], &[1, 0, 0, 0], 4 + 4 + 4);
    bytes_are_the_numbers(&[1.0_f64], &1.0_f64.to_le_bytes(), 4 + 8 + 8);
    bytes_are_the_numbers::<f64>(&[], &[], 4 + 1);
}

/// No alignment leads beyond the limit.
#[test]
fn no_message_is_longer_than_the_limit() {
    const MOST: usize = 64 << 20;
    for left in 6..=18 {
        match len_behind(MOST - 4 - left, "float64", &json!(1.5)) {
            Ok(len) => assert!(len <= MOST, "{left}: {len}"),
            Err(error) => assert!(matches!(error, EncodeError::TooLong { .. }), "{error}"),
        }
    }
}

/// Elements that are not kept are checked, too.
#[test]
fn a_wrong_boolean_is_an_error_wherever_it_is() {
    let set = set("bool[] a");
    for wrong in 0..4 {
        let mut bytes = encode(&set, &name(), &json!({"a": [true, false, true, true]})).unwrap();
        bytes[8 + wrong] = 7;
        for keep in [0, 2, usize::MAX] {
            let error = decode(&set, &name(), &bytes, keep).unwrap_err();
            let DecodeError::Value { fault, path, .. } = error else {
                panic!("{error}");
            };
            assert_eq!(fault, Fault::Bool(7), "{wrong}");
            assert_eq!(path.to_string(), format!("a[{wrong}]"));
        }
    }
}
