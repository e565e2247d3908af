//! Single values of a message, compared with the decoder of whole messages.

use serde_json::{Map, Value as Json, json};
use sm2_ros::place::{self, Part};
use sm2_ros::{DecodeError, Fault, Value, decode, encode};
use sm2_ros_idl::{FieldType, Primitive, Set, TypeName};

const OUTER: &str = "bool a\nstring text\nuint8[] bytes\np/Inner inner\nfloat64[2] pair\nbool[] flags\nwstring wide\n\
                     p/Inner[] list\np/Empty[2] empty\nstring[<=2] texts\nuint16[] none\nint64 last";
const INNER: &str = "int16 x\nstring<=4 name\nfloat32[] numbers";

fn set() -> Set {
    let mut set = Set::default();
    for (name, text) in [("Outer", OUTER), ("Inner", INNER), ("Empty", "")] {
        let name = format!("p/msg/{name}").parse().unwrap();
        set.add(&name, text).unwrap();
    }
    set
}

fn outer() -> TypeName {
    "p/msg/Outer".parse().unwrap()
}

fn value() -> Json {
    let inner = |x: i16| json!({"x": x, "name": "ab", "numbers": [0.5, x]});
    json!({
        "a": true, "text": "hällo", "bytes": [1, 2, 3], "inner": inner(-7), "pair": [1.5, -2.0], "flags": [true, false],
        "wide": "ä🤖", "list": [inner(1), inner(2), inner(3)], "empty": [{}, {}], "texts": ["", "x"], "none": [],
        "last": i64::MIN,
    })
}

/// All fields of a message as JSON, each read for itself.
fn walk(set: &Set, name: &TypeName, bytes: &[u8], at: usize) -> Result<Json, DecodeError> {
    let mut fields = Map::new();
    let mut next = at;
    for field in &set.get(name)?.fields {
        let (part, end) = place::read(set, &field.ty, bytes, next)?;
        assert_eq!(place::skip(set, &field.ty, bytes, next), Ok(end));
        fields.insert(field.name.to_string(), json_of(set, &part, bytes)?);
        next = end;
    }
    Ok(Json::Object(fields))
}

fn json_of(set: &Set, part: &Part<'_>, bytes: &[u8]) -> Result<Json, DecodeError> {
    Ok(match part {
        Part::Value(value) => serde_json::to_value(value).unwrap(),
        Part::List(parts) => {
            let parts = parts.iter().map(|it| json_of(set, it, bytes));
            Json::Array(parts.collect::<Result<_, _>>()?)
        }
        Part::Message { name, at } => walk(set, name, bytes, *at)?,
        Part::Numbers {
            primitive,
            len,
            at,
            big_endian,
        } => {
            assert!(!big_endian);
            let size = primitive.size_bytes();
            let numbers = (0..*len).map(|it| {
                let number = &bytes[at + it * size..][..size];
                match primitive {
                    Primitive::Bool => json!(number == [1]),
                    Primitive::Uint8 => json!(number[0]),
                    Primitive::Float32 => json!(f32::from_le_bytes(number.try_into().unwrap())),
                    Primitive::Float64 => json!(f64::from_le_bytes(number.try_into().unwrap())),
                    other => panic!("{other:?}"),
                }
            });
            numbers.collect()
        }
    })
}

#[test]
fn fields_that_are_read_one_by_one_are_those_of_the_message() {
    let (set, name) = (set(), outer());
    let bytes = encode(&set, &name, &value()).unwrap();
    let whole = decode(&set, &name, &bytes, usize::MAX).unwrap();
    let whole = serde_json::to_value(whole).unwrap();
    assert_eq!(walk(&set, &name, &bytes, place::START), Ok(whole));
    let defaults = encode(&set, &name, &json!({})).unwrap();
    let whole = decode(&set, &name, &defaults, usize::MAX).unwrap();
    let whole = serde_json::to_value(whole).unwrap();
    assert_eq!(walk(&set, &name, &defaults, place::START), Ok(whole));
}

#[test]
fn a_message_that_is_cut_short_is_an_error_at_every_length() {
    let (set, name) = (set(), outer());
    let bytes = encode(&set, &name, &value()).unwrap();
    for len in 0..bytes.len() {
        let error = walk(&set, &name, &bytes[..len], place::START).unwrap_err();
        assert!(matches!(error, DecodeError::Value { .. }), "{len}: {error}");
    }
}

#[test]
fn places_beyond_the_message_are_errors() {
    let set = set();
    let text = &set.get(&outer()).unwrap().fields[1].ty;
    for at in [8, 9, usize::MAX] {
        let short = place::read(&set, text, &[0, 1, 0, 0, 0, 0, 0, 0][..], at);
        assert!(short.is_err(), "{at}");
    }
}

#[test]
fn a_hostile_length_is_an_error() {
    let set = set();
    let fields = &set.get(&outer()).unwrap().fields;
    let ty = |name: &str| -> &FieldType { &fields.iter().find(|it| *it.name == *name).unwrap().ty };
    let bytes = [&[0, 1, 0, 0][..], &u32::MAX.to_le_bytes(), &[0; 8]].concat();
    for name in ["bytes", "flags", "list", "none"] {
        match place::read(&set, ty(name), &*bytes, place::START) {
            Err(DecodeError::Value { fault, .. }) => assert_eq!(fault, Fault::Short, "{name}"),
            other => panic!("{name}: {other:?}"),
        }
    }
    // The header says big-endian.
    let bytes = [0, 0, 0, 0, 0, 0, 0, 2, 5, 6];
    let (part, end) = place::read(&set, ty("bytes"), &bytes[..], place::START).unwrap();
    let expected = Part::Numbers {
        primitive: Primitive::Uint8,
        len: 2,
        at: 8,
        big_endian: true,
    };
    assert_eq!((part, end), (expected, 10));
    let (part, _) = place::read(&set, ty("a"), &[0, 1, 0, 0, 1][..], place::START).unwrap();
    assert_eq!(part, Part::Value(Value::Bool(true)));
}
