//! Encoding JSON from the command line as messages.

use serde_json::json;

use super::{ALL, schema};
use crate::decode::{decode, encode};

const PATH: &str = "struct{frame:string,points:list[struct{x:f64,y:f64,}],mode:enum{Idle:struct{},\
    Wait:struct{0:u8,},Go:struct{0:u8,1:i8,},Follow:struct{speed:f32,},},note:option[string],}";

fn bytes(text: &str, given: serde_json::Value) -> Vec<u8> {
    let encoded = encode(&schema(text), &given);
    encoded.unwrap_or_else(|error| panic!("{text}, {given}: {error}"))
}

fn wrong(ty: &str, given: serde_json::Value) -> String {
    let schema = schema(&format!("postcard:{ty}"));
    encode(&schema, &given).unwrap_err().to_string()
}

#[test]
fn a_value_becomes_the_message() {
    let text = format!("postcard:{PATH}");
    let given = json!({
        "frame": "map", "points": [{ "x": 1, "y": 2.5 }], "mode": { "Go": [200, -1] },
    });
    let encoded = bytes(&text, given);
    let schema = schema(&text);
    let value = decode(&schema, &encoded, ALL).unwrap();
    assert_eq!(
        serde_json::to_string(&value).unwrap(),
        r#"{"frame":"map","points":[{"x":1.0,"y":2.5}],"mode":{"Go":[200,-1]},"note":null}"#
    );
}

#[test]
fn variants_are_named() {
    let mode = "postcard:enum{Idle:struct{},Wait:struct{0:u8,},Go:struct{0:u8,1:i8,},}";
    assert_eq!(bytes(mode, json!("Idle")), [0]);
    assert_eq!(bytes(mode, json!({ "Idle": null })), [0]);
    assert_eq!(bytes(mode, json!({ "Wait": 7 })), [1, 7]);
    assert_eq!(bytes(mode, json!({ "Wait": [7] })), [1, 7]);
    assert_eq!(bytes(mode, json!({ "Go": [7, -1] })), [2, 7, 0xff]);
}

#[test]
fn one_value_is_meant_with_and_without_brackets() {
    let single = "postcard:struct{0:u8,}";
    assert_eq!(bytes(single, json!(7)), [7]);
    assert_eq!(bytes(single, json!([7])), [7]);
    // A list that is the only value may have its own brackets.
    let list = "postcard:struct{0:list[u8],}";
    assert_eq!(bytes(list, json!([7])), [1, 7]);
    assert_eq!(bytes(list, json!([7, 8])), [2, 7, 8]);
}

#[test]
fn keys_of_objects_are_read_by_their_type() {
    assert_eq!(
        bytes("postcard:map[i16,bool]", json!({ "-1": true })),
        [1, 1, 1]
    );
    assert_eq!(
        bytes("postcard:map[bool,u8]", json!({ "true": 2 })),
        [1, 1, 2]
    );
    assert_eq!(
        bytes("postcard:map[string,u8]", json!({ "1": 2 })),
        [1, 1, b'1', 2]
    );
    assert_eq!(
        bytes("postcard:map[u128,u8]", json!({ "300": 2 })),
        [1, 0xac, 2, 2]
    );
    let pairs = json!([[[1, 2], 3]]);
    assert_eq!(
        bytes("postcard:map[struct{0:u8,1:u8,},u8]", pairs),
        [1, 1, 2, 3]
    );
}

#[test]
fn what_does_not_fit_is_named_with_its_path() {
    let point = |x| json!({ "x": x, "y": 0 });
    let path = |points, mode| json!({ "frame": "", "points": points, "mode": mode });
    let cases = [
        (
            path(
                json!([point(json!(1)), point(json!(2)), point(json!("abc"))]),
                json!("Idle"),
            ),
            "points[2].x: expected a number, found \"abc\"",
        ),
        (
            path(json!([{ "x": 1 }]), json!("Idle")),
            "points[0].y: it is missing",
        ),
        (
            path(json!([{ "x": 1, "y": 2, "z": 3 }]), json!("Idle")),
            "points[0]: there is no field \"z\": it has x, y",
        ),
        (
            path(json!([[1, 2]]), json!("Idle")),
            "points[0]: expected an object with x, y, found an array",
        ),
        (
            path(json!({}), json!("Idle")),
            "points: expected an array, found an object",
        ),
        (
            path(json!([]), json!("Fly")),
            "mode: there is no variant \"Fly\": it has Idle, Wait, Go, Follow",
        ),
        (
            path(json!([]), json!("Go")),
            "mode.Go: expected an array of 2 values, found null",
        ),
        (
            path(json!([]), json!({ "Go": [1] })),
            "mode.Go: expected 2 values, found 1",
        ),
        (
            path(json!([]), json!({ "Go": [256, 0] })),
            "mode.Go[0]: expected a whole number of 0 to 255, found 256",
        ),
        (
            path(json!([]), json!({ "Idle": 1 })),
            "mode.Idle: expected null, found 1",
        ),
        (
            path(json!([]), json!({ "Follow": { "speed": 1e300 } })),
            "mode.Follow.speed: expected a number of 32 bits, found 1e+300",
        ),
        (
            path(json!([]), json!({ "Idle": null, "Wait": 1 })),
            "mode: expected a variant: \"Name\", or {\"Name\": fields}, found an object",
        ),
    ];
    for (given, expected) in cases {
        assert_eq!(wrong(PATH, given), expected);
    }
}

#[test]
fn a_wrong_value_alone_is_named_as_the_message() {
    assert_eq!(
        wrong("u16", json!(-1)),
        "message: expected a whole number of 0 to 65535, found -1"
    );
    assert_eq!(
        wrong("i8", json!(2.0)),
        "message: expected a whole number of -128 to 127, found 2.0"
    );
    assert_eq!(
        wrong("u64", json!("7")),
        "message: expected a whole number of 0 to 18446744073709551615, found \"7\""
    );
    assert_eq!(
        wrong("bool", json!(1)),
        "message: expected true or false, found 1"
    );
    assert_eq!(
        wrong("char", json!("ab")),
        "message: expected a text of one character, found \"ab\""
    );
    assert_eq!(
        wrong("map[u8,bool]", json!({ "x": true })),
        "[\"x\"]: expected a whole number of 0 to 255, found \"x\""
    );
    assert_eq!(
        wrong("array[u8;0000000000000003]", json!([1])),
        "message: expected 3 values, found 1"
    );
    let long = wrong("u8", json!("x".repeat(1_000)));
    assert!(long.len() < 120 && long.ends_with('…'), "{long}");
}

#[test]
fn numbers_are_taken_up_to_their_limits() {
    let limits = json!([0, 18_446_744_073_709_551_615_u64]);
    let encoded = bytes("plain:array[u64;0000000000000002]", limits);
    assert_eq!(encoded, [[0; 8], [0xff; 8]].concat());
    let limits = json!([i64::MIN, i64::MAX]);
    let encoded = bytes("plain:array[i64;0000000000000002]", limits);
    assert_eq!(
        encoded,
        [i64::MIN.to_le_bytes(), i64::MAX.to_le_bytes()].concat()
    );
    assert_eq!(
        bytes("plain:u128", json!(u128::MAX.to_string())),
        [0xff; 16]
    );
    assert_eq!(
        bytes("plain:i128", json!(i128::MIN.to_string())),
        i128::MIN.to_le_bytes()
    );
    assert_eq!(bytes("plain:char", json!("界")), [0x4c, 0x75, 0, 0]);
}

#[test]
fn json_messages_are_checked_and_sent_as_they_are() {
    let text = format!("json:{PATH}");
    let given = json!({ "frame": "ä\n", "points": [], "mode": { "Wait": 1 } });
    let encoded = bytes(&text, given.clone());
    let schema = schema(&text);
    let value = decode(&schema, &encoded, ALL).unwrap();
    assert_eq!(serde_json::to_value(&value).unwrap(), given);
    let error = encode(&schema, &json!({ "frame": 1 })).unwrap_err();
    assert_eq!(error.to_string(), "frame: expected text, found 1");
    // In the JSON encoding, texts do not stand for numbers.
    let number = super::schema("json:f64");
    assert!(encode(&number, &json!("NaN")).is_err());
    for ty in ["u128", "i128"] {
        let number = super::schema(&format!("json:{ty}"));
        assert_eq!(encode(&number, &json!(7)), Ok(b"7".to_vec()));
        assert!(encode(&number, &json!("7")).is_err());
    }
}

#[test]
fn a_text_message_is_a_text() {
    assert_eq!(bytes("plain:string", json!("grüße")), "grüße".as_bytes());
    let error = encode(&schema("plain:string"), &json!(1)).unwrap_err();
    assert_eq!(error.to_string(), "message: expected text, found 1");
}
