//! Messages by their schemas, from bytes to JSON and back.

use sm2_proto::schema::{Encoding, Schema};

use crate::decode::{Limits, decode, encode, show};

/// The number of elements of a long list that are shown.
const KEEP: usize = 3;
/// The limit of `show`, and the text that it appends to a message that it cuts.
const SHOWN_MAX: usize = 17_000;

/// The first two lines and the rest; one line or none if there are no more.
pub(super) fn schemas(data: &[u8]) -> &[u8] {
    let mut ends = (0..data.len()).filter(|&at| data[at] == b'\n');
    let end = ends.nth(1).unwrap_or(data.len());
    &data[..end]
}

/// A decoded message fits one screen and can be written as JSON. JSON that is encoded as a message decodes
/// to the same message. A message that takes both ways stays the same, except for values that JSON lacks.
pub(super) fn message(data: &[u8]) {
    let schemas = schemas(data);
    let Some(payload) = data.get(schemas.len() + 1..) else {
        return;
    };
    let first = schemas.split(|&byte| byte == b'\n').next();
    let first = first.and_then(|text| str::from_utf8(text).ok());
    let Some(schema) = first.and_then(|text| Schema::parse(text).ok()) else {
        return;
    };
    if let Some(json) = shown(&schema, payload) {
        said(&schema, &json);
    }
    if let Ok(json) = serde_json::from_slice(payload) {
        meant(&schema, &json);
    }
}

/// The output of `sm2 topic echo` for these bytes, if they are a message.
fn shown(schema: &Schema, payload: &[u8]) -> Option<serde_json::Value> {
    let value = decode(schema, payload, usize::MAX).ok()?;
    let short = decode(schema, payload, KEEP).expect("what is kept does not matter");
    for value in [&value, &short] {
        let screen = show(value, &Limits::SCREEN);
        assert!(screen.len() < SHOWN_MAX, "{} bytes", screen.len());
        let plain = |c: char| c == '\n' || !c.is_control();
        assert!(screen.chars().all(plain), "{screen:?}");
    }
    let text = serde_json::to_string(&value).expect("every message has its JSON");
    assert!(!text.contains('\n'), "one line");
    // This fails only for a message that is nested more deeply than serde_json allows.
    serde_json::from_str(&text).ok()
}

/// The program reads the JSON that it prints.
fn said(schema: &Schema, json: &serde_json::Value) {
    if *schema.encoding() == Encoding::Json {
        // JSON messages are shown as they came, even if they do not match the schema.
        return;
    }
    match encode(schema, json) {
        Ok(bytes) => again(schema, &bytes),
        Err(error) => panic!("{json}: {error}"),
    }
}

/// JSON from the command line.
fn meant(schema: &Schema, json: &serde_json::Value) {
    if let Ok(bytes) = encode(schema, json) {
        again(schema, &bytes);
    }
}

/// An encoded message decodes, and the decoded value encodes to the same bytes.
fn again(schema: &Schema, bytes: &[u8]) {
    let json = shown(schema, bytes).expect("what was encoded is a message");
    if *schema.encoding() == Encoding::Json {
        // The message is JSON, with numbers of 128 bits where this program prints texts.
        return;
    }
    let twice = encode(schema, &json).expect("what was printed is taken");
    let later = shown(schema, &twice).expect("what was encoded is a message");
    assert_eq!(json, later);
}
