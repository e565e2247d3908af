//! Messages of types that this program was not built with, read and written by their schemas.
//!
//! A [`Codec`] decodes for `sm2 topic echo`, and encodes JSON from the command line; [`show()`] is for the terminal.
//! Messages of ROS 2 (SM2-TYP-002) are read and written by `sm2-ros`, all others here. Both have the same [`Value`],
//! whose JSON is described in [`sm2_ros::value`]; this module accepts the same JSON. A tuple is a list, a tuple of one
//! value is that value, and an optional field is its value or `null`. In the encoding `json`, only numbers stand for
//! numbers.
mod codec;
mod error;
mod json;
mod reader;
mod shape;
mod show;
mod writer;

use sm2_proto::schema::{Encoding, Layout, Root, Schema, Type};
pub(crate) use sm2_ros::Value;

pub(crate) use self::codec::{Codec, CodecError};
pub(crate) use self::error::{DecodeError, EncodeError};
pub(crate) use self::show::{Limits, show};
use self::{
    error::Wrong,
    reader::{Form, Reader},
};

/// Decodes a message. The first `keep` elements of each list, set and map are kept, and the others counted.
///
/// # Errors
///
/// [`DecodeError`] if the bytes are not a message of the type. All bytes must belong to the message.
pub(crate) fn decode<'a>(
    schema: &'a Schema,
    bytes: &'a [u8],
    keep: usize,
) -> Result<Value<'a>, DecodeError> {
    let Root::Type(root) = schema.root() else {
        return Err(DecodeError::Encoding(schema.encoding().name().into()));
    };
    match schema.encoding() {
        Encoding::Plain if *root == Type::Text => match str::from_utf8(bytes) {
            Ok(text) => Ok(Value::Text(text.into())),
            Err(error) => Err(DecodeError::new(error.valid_up_to(), Wrong::Utf8)),
        },
        Encoding::Plain => {
            let layout = Layout::of(root).map_err(DecodeError::Layout)?;
            let elements = layout.elements(bytes.len() as u64);
            let elements = elements.ok_or(DecodeError::Length {
                len: bytes.len(),
                layout,
            })?;
            Reader::new(bytes, Form::Plain { elements }, keep).whole(root)
        }
        Encoding::Postcard => Reader::new(bytes, Form::Postcard, keep).whole(root),
        Encoding::Json => json::decode(root, bytes, keep),
        other => Err(DecodeError::Encoding(other.name().into())),
    }
}

/// Encodes JSON from the command line as a message.
///
/// # Errors
///
/// [`EncodeError`] with the path to the value that does not fit the schema.
pub(crate) fn encode(schema: &Schema, given: &serde_json::Value) -> Result<Vec<u8>, EncodeError> {
    let Root::Type(root) = schema.root() else {
        return Err(EncodeError::Encoding(schema.encoding().name().into()));
    };
    match schema.encoding() {
        Encoding::Plain if *root == Type::Text => match given {
            serde_json::Value::String(text) => Ok(text.clone().into_bytes()),
            other => Err(EncodeError::expected("text", other)),
        },
        Encoding::Plain => {
            Layout::of(root).map_err(EncodeError::Layout)?;
            writer::encoded(writer::Form::Plain, root, given)
        }
        Encoding::Postcard => writer::encoded(writer::Form::Postcard, root, given),
        Encoding::Json => {
            writer::encoded(writer::Form::Json, root, given)?;
            Ok(given.to_string().into_bytes())
        }
        other => Err(EncodeError::Encoding(other.name().into())),
    }
}

#[cfg(test)]
mod tests;
