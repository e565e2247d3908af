//! The types of messages, and their forms in the protocol.
//!
//! | type in the domain | encoding | schema | message |
//! | --- | --- | --- | --- |
//! | type of ROS 2 | `cdr` | `ros2msg`, its definition | unchanged |
//! | JSON | `json` | `jsonschema` | unchanged |
//! | plain data, serde types | `json` | `jsonschema` | converted by its schema |
//! | serde type with the fields of a Foxglove schema | `json` | `jsonschema`, Foxglove's | converted by both schemas |
//! | bytes, types without a schema | `json` | `jsonschema` | an object whose field `bytes` is in base64 |
//!
//! A message whose JSON is not an object is the field `value` of an object: Foxglove shows objects only.

use std::{borrow::Cow, collections::HashMap, error::Error, sync::Arc};

use base64::{Engine as _, engine::general_purpose::STANDARD as BASE64};
use serde_json::{Value, json};
use sm2_cli::Transcoder;
use sm2_node::{Node, domain::QueryError};
use sm2_proto::{
    TypeId,
    schema::{Encoding, Root, Scalar, Schema, Type},
};

use crate::{
    foxglove_schema::FoxgloveSchema,
    json_schema::{self, VALUE},
    protocol::Messages,
};

/// The longest message that is converted to JSON, in bytes. A converter needs some ten times as much memory.
pub(crate) const CONVERTED_BYTES_MAX: usize = 1024 * 1024;

/// The field that has the bytes of a message without a schema.
const BYTES: &str = "bytes";

/// The reason why a message or a schema cannot be used, for people.
type Unusable = Box<dyn Error + Send + Sync>;

/// A type of messages, ready for conversions.
#[derive(Debug)]
pub(crate) struct MessageType {
    name: String,
    form: Form,
    /// The text of the schema.
    schema: String,
    /// `None` for [`Form::Bytes`].
    transcoder: Option<Transcoder>,
}

/// The form of the messages of a type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Cdr,
    Json { is_wrapped: bool },
    Converted { is_wrapped: bool },
    Foxglove(&'static FoxgloveSchema),
    Bytes,
}

impl MessageType {
    /// Prepares a type that has this schema.
    ///
    /// # Errors
    ///
    /// The schema is a wrong definition of a type of ROS 2.
    pub(crate) fn new(data: &TypeId, schema: Schema) -> Result<Self, Unusable> {
        if let (Encoding::Plain | Encoding::Postcard | Encoding::Json, Root::Type(ty)) =
            (schema.encoding(), schema.root())
            && let Some(known) = FoxgloveSchema::of(&data.name, ty)
        {
            return Ok(Self {
                name: known.name.to_owned(),
                form: Form::Foxglove(known),
                schema: known.json_schema().to_string(),
                transcoder: Some(Transcoder::new(&data.name, schema)?),
            });
        }
        let (form, text) = match (schema.encoding(), schema.root()) {
            (_, Root::Definition(definition)) => (Form::Cdr, definition.text().to_owned()),
            (Encoding::Plain, Root::Type(Type::List(element)))
                if **element == Type::Scalar(Scalar::U8) =>
            {
                return Ok(Self::bytes(data));
            }
            (Encoding::Json, Root::Type(ty)) => {
                let (schema, is_wrapped) = json_schema::of(ty);
                (Form::Json { is_wrapped }, schema.to_string())
            }
            (Encoding::Plain | Encoding::Postcard, Root::Type(ty)) => {
                let (schema, is_wrapped) = json_schema::of(ty);
                (Form::Converted { is_wrapped }, schema.to_string())
            }
            (_, Root::Type(_)) => return Ok(Self::bytes(data)),
        };
        Ok(Self {
            name: data.name.to_string(),
            form,
            schema: text,
            transcoder: Some(Transcoder::new(&data.name, schema)?),
        })
    }

    /// A type without a schema.
    fn bytes(data: &TypeId) -> Self {
        let field = json!({ "type": "string", "contentEncoding": "base64" });
        let schema = json!({ "type": "object", "properties": { BYTES: field } });
        Self {
            name: data.name.to_string(),
            form: Form::Bytes,
            schema: schema.to_string(),
            transcoder: None,
        }
    }

    /// The type, as channels and services state it.
    pub(crate) fn messages(&self) -> Messages<'_> {
        let (encoding, schema_encoding) = match self.form {
            Form::Cdr => ("cdr", "ros2msg"),
            Form::Json { .. } | Form::Converted { .. } | Form::Foxglove(_) | Form::Bytes => {
                ("json", "jsonschema")
            }
        };
        Messages {
            encoding,
            schema_name: &self.name,
            schema_encoding,
            schema: &self.schema,
        }
    }

    /// Whether viewers get the messages as they are.
    pub(crate) const fn is_unchanged(&self) -> bool {
        matches!(self.form, Form::Cdr | Form::Json { is_wrapped: false })
    }

    /// The longest message that a viewer can get, in bytes; `None` for any length.
    pub(crate) const fn max_len(&self) -> Option<usize> {
        match self.form {
            Form::Cdr | Form::Json { .. } => None,
            Form::Converted { .. } | Form::Foxglove(_) | Form::Bytes => Some(CONVERTED_BYTES_MAX),
        }
    }

    /// The message of the domain as a viewer gets it.
    ///
    /// # Errors
    ///
    /// It is not a message of the type, or longer than [`max_len`](Self::max_len).
    pub(crate) fn to_viewer<'a>(&self, message: &'a [u8]) -> Result<Cow<'a, [u8]>, Unusable> {
        let len = message.len();
        if self.max_len().is_some_and(|max| len > max) {
            let max = CONVERTED_BYTES_MAX;
            return Err(format!("{len} bytes, and at most {max} are converted to JSON").into());
        }
        Ok(match (self.form, &self.transcoder) {
            (Form::Cdr | Form::Json { is_wrapped: false }, _) => message.into(),
            (Form::Json { is_wrapped: true }, _) => wrapped(message).into(),
            (Form::Converted { is_wrapped }, Some(transcoder)) => {
                let json = transcoder.to_json(message)?;
                match is_wrapped {
                    true => wrapped(&json).into(),
                    false => json.into(),
                }
            }
            (Form::Foxglove(known), Some(transcoder)) => {
                let mut value = serde_json::from_slice(&transcoder.to_json(message)?)?;
                known.to_viewer(&mut value);
                serde_json::to_vec(&value)?.into()
            }
            (Form::Bytes | Form::Converted { .. } | Form::Foxglove(_), _) => {
                let object = json!({ BYTES: BASE64.encode(message) });
                object.to_string().into_bytes().into()
            }
        })
    }

    /// The message of a viewer as the domain gets it.
    ///
    /// # Errors
    ///
    /// The encoding is another one, or it is not a message of the type.
    pub(crate) fn to_domain<'a>(
        &self,
        encoding: &str,
        payload: &'a [u8],
    ) -> Result<Cow<'a, [u8]>, Unusable> {
        let own = self.messages().encoding;
        // Viewers may write JSON for a type of ROS 2.
        if encoding != own && encoding != "json" {
            return Err(
                format!("the encoding is {encoding}, but {} is in {own}", self.name).into(),
            );
        }
        if encoding == "cdr" {
            return Ok(payload.into());
        }
        let mut value: Value = serde_json::from_slice(payload)?;
        let field = match self.form {
            Form::Cdr => None,
            Form::Foxglove(known) => {
                known.to_domain(&mut value)?;
                None
            }
            Form::Json { is_wrapped } | Form::Converted { is_wrapped } => {
                is_wrapped.then_some(VALUE)
            }
            Form::Bytes => Some(BYTES),
        };
        if let Some(field) = field {
            let inner = value.get_mut(field).map(Value::take);
            value = inner.ok_or_else(|| format!("the object has no field {field}"))?;
        }
        match &self.transcoder {
            Some(transcoder) => Ok(transcoder.to_message(&value)?.into()),
            None => Ok(BASE64.decode(value.as_str().unwrap_or_default())?.into()),
        }
    }
}

fn wrapped(json: &[u8]) -> Vec<u8> {
    let open = format!("{{\"{VALUE}\":");
    [open.as_bytes(), json, b"}"].concat()
}

/// The types of a domain that were asked for.
#[derive(Debug, Default)]
pub(crate) struct MessageTypes {
    known: HashMap<TypeId, Arc<MessageType>>,
    /// Types without a schema that a node has registered.
    unknown: HashMap<TypeId, Arc<MessageType>>,
}

impl MessageTypes {
    /// The type with this name and hash. A type without a schema is asked for again each time.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub(crate) fn of(
        &mut self,
        node: &Node,
        data: &TypeId,
    ) -> Result<Arc<MessageType>, QueryError> {
        if let Some(known) = self.known.get(data) {
            return Ok(Arc::clone(known));
        }
        let schema = node.describe(data)?;
        let schema = schema.and_then(|text| Schema::parse(&text).ok());
        let Some(schema) = schema else {
            let unknown = self.unknown.entry(data.clone());
            return Ok(Arc::clone(
                unknown.or_insert_with(|| MessageType::bytes(data).into()),
            ));
        };
        let known = MessageType::new(data, schema).unwrap_or_else(|error| {
            tracing::warn!(%data, %error, "the registered schema cannot be used: messages are shown as bytes");
            MessageType::bytes(data)
        });
        let known = Arc::new(known);
        self.known.insert(data.clone(), Arc::clone(&known));
        Ok(known)
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::Name;

    use super::*;

    fn message_type(text: &str) -> MessageType {
        let schema = Schema::parse(text).unwrap();
        let data = TypeId {
            name: Name::new("Test").unwrap(),
            hash: schema.hash(),
        };
        MessageType::new(&data, schema).unwrap()
    }

    /// Both directions of a message.
    fn check(text: &str, message: &[u8], viewer: &str) {
        let ty = message_type(text);
        let found = ty.to_viewer(message).unwrap();
        assert_eq!(String::from_utf8_lossy(&found), viewer, "{text}");
        let back = ty.to_domain("json", viewer.as_bytes()).unwrap();
        assert_eq!(back, message, "{text}");
    }

    #[test]
    fn messages_are_converted_in_both_directions() {
        check("plain:string", b"hi", r#"{"value":"hi"}"#);
        check("plain:f32", &1.5_f32.to_le_bytes(), r#"{"value":1.5}"#);
        check("plain:struct{x:u8,y:u8,}", &[1, 2], r#"{"x":1,"y":2}"#);
        check(
            "postcard:struct{name:string,on:bool,}",
            b"\x02hi\x01",
            r#"{"name":"hi","on":true}"#,
        );
        check("json:struct{x:u8,}", br#"{"x":1}"#, r#"{"x":1}"#);
        check("json:list[u8]", b"[1,2]", r#"{"value":[1,2]}"#);
        check("plain:list[u8]", &[0, 255, 16], r#"{"bytes":"AP8Q"}"#);
        check(
            "postcard:struct{timestamp:struct{sec:u32,nsec:u32,},data:list[u8],format:string,}",
            b"\x01\x02\x03\x00\x10\x20\x04opus",
            r#"{"data":"ABAg","format":"opus","timestamp":{"nsec":2,"sec":1}}"#,
        );
    }

    #[test]
    fn wrong_messages_are_errors() {
        let ty = message_type("plain:struct{x:u8,y:u8,}");
        assert!(ty.to_viewer(&[1]).is_err());
        assert!(ty.to_domain("cdr", &[1, 2]).is_err());
        assert!(ty.to_domain("json", br#"{"x":1}"#).is_err());
        assert!(ty.to_domain("json", b"{").is_err());
        let audio = message_type(
            "json:struct{timestamp:struct{sec:u32,nsec:u32,},data:list[u8],format:string,}",
        );
        let message = br#"{"timestamp":{"sec":1,"nsec":2},"data":"AB","format":"opus"}"#;
        let error = audio.to_domain("json", message).unwrap_err();
        assert!(error.to_string().contains("padding"), "{error}");
        let wrapped = message_type("plain:string");
        assert!(wrapped.to_domain("json", br#""hi""#).is_err());
    }

    #[test]
    fn a_long_message_is_not_converted() {
        let ty = message_type("plain:list[u8]");
        assert!(ty.to_viewer(&vec![0; CONVERTED_BYTES_MAX]).is_ok());
        assert!(ty.to_viewer(&vec![0; CONVERTED_BYTES_MAX + 1]).is_err());
        let json = message_type("json:string");
        assert!(json.to_viewer(&vec![b' '; CONVERTED_BYTES_MAX + 1]).is_ok());
    }

    #[test]
    fn a_type_of_ros_2_is_unchanged() {
        let name = Name::new("std_msgs/msg/String").unwrap();
        let text = "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";
        let schema = Schema::parse(text).unwrap();
        let data = TypeId {
            name,
            hash: schema.hash(),
        };
        let ty = MessageType::new(&data, schema).unwrap();
        let messages = ty.messages();
        assert_eq!(
            (messages.encoding, messages.schema_encoding),
            ("cdr", "ros2msg")
        );
        assert_eq!(messages.schema, "string data\n");
        let message = b"\0\x01\0\0\x03\0\0\0hi\0";
        assert_eq!(*ty.to_viewer(message).unwrap(), *message);
        assert_eq!(*ty.to_domain("cdr", message).unwrap(), *message);
        let json = ty.to_domain("json", br#"{"data":"hi"}"#).unwrap();
        assert_eq!(*json, *message);
    }
}
