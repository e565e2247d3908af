//! Messages by their schemas, from bytes to JSON and back.

use sm2_proto::schema::{Encoding, Schema};

use crate::decode::{Limits, decode, encode, show};

/// Of a long list this many elements are shown.
const KEEP: usize = 3;
/// As `show` cuts what is too long, and its words for that.
const SHOWN_MAX: usize = 17_000;

/// The first two lines, or all there is.
pub(super) fn schemas(data: &[u8]) -> &[u8] {
    let mut ends = (0..data.len()).filter(|&at| data[at] == b'\n');
    let end = ends.nth(1).unwrap_or(data.len());
    &data[..end]
}

/// Bytes that are a message are shown on one screen and as JSON; JSON that is read as a
/// message is that message; and a message that went through both is the same, but for what
/// JSON cannot say.
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

/// What `sm2 topic echo` prints of these bytes, if they are a message.
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
    // Nothing but the depth, which serde_json bounds, makes this fail.
    serde_json::from_str(&text).ok()
}

/// JSON that this program printed is taken by it.
fn said(schema: &Schema, json: &serde_json::Value) {
    if *schema.encoding() == Encoding::Json {
        // Shown as it came, also where it is not what the schema says.
        return;
    }
    match encode(schema, json) {
        Ok(bytes) => again(schema, &bytes),
        Err(error) => panic!("{json}: {error}"),
    }
}

/// JSON that a person wrote.
fn meant(schema: &Schema, json: &serde_json::Value) {
    if let Ok(bytes) = encode(schema, json) {
        again(schema, &bytes);
    }
}

/// What was made of JSON is a message, and from there on neither changes.
fn again(schema: &Schema, bytes: &[u8]) {
    let json = shown(schema, bytes).expect("what was encoded is a message");
    if *schema.encoding() == Encoding::Json {
        // The message is JSON itself, with numbers of 128 bits where we print texts.
        return;
    }
    let twice = encode(schema, &json).expect("what was printed is taken");
    let later = shown(schema, &twice).expect("what was encoded is a message");
    assert_eq!(json, later);
}
