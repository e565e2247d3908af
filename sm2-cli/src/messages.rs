//! Messages of types that this program was not built with, read and written by the schemas that nodes have
//! registered (SM2-SCH-001).

use std::{borrow::Cow, collections::HashMap};

use clap::Args;
use serde::Serialize;
use sm2_proto::{TypeId, schema::Schema};

use crate::{
    connect::CommandNode,
    decode::{self, Codec, CodecError, Limits, Value},
    error::CliError,
    ros_types::Definitions,
    text::{self, Hex},
};

/// The options for how messages are shown.
#[derive(Args, Clone, Copy, Debug, Default)]
#[group(multiple = false)]
pub(crate) struct Show {
    /// Do not decode: print text as it is, and the length and first bytes of anything else
    #[arg(long)]
    pub(crate) raw: bool,
    /// Do not decode: print all bytes as hex digits
    #[arg(long)]
    pub(crate) hex: bool,
}

impl Show {
    /// Whether messages of this type are decoded, if its schema is known.
    pub(crate) fn decodes(self, data: &TypeId) -> bool {
        !self.raw && !self.hex && !is_bytes(data)
    }
}

/// The schemas that were already asked for.
#[derive(Debug, Default)]
pub(crate) struct Schemas {
    known: HashMap<TypeId, Option<Result<Codec, CodecError>>>,
    /// The definitions of types that no node has registered.
    definitions: Definitions,
}

impl Schemas {
    pub(crate) fn new(definitions: &Definitions) -> Self {
        Self {
            known: HashMap::new(),
            definitions: definitions.clone(),
        }
    }

    /// The schema of a type, to encode a message. `None` for bytes, and if no node has registered it.
    ///
    /// # Errors
    ///
    /// [`CliError::Definition`] if it is a wrong definition of ROS 2.
    pub(crate) fn of(
        &mut self,
        command_node: &CommandNode,
        data: &TypeId,
    ) -> Result<Option<&Codec>, CliError> {
        if is_bytes(data) {
            return Ok(None);
        }
        self.ask(command_node, data);
        match self.known.get(data) {
            Some(Some(Ok(codec))) => Ok(Some(codec)),
            Some(Some(Err(error))) => Err(definition(data, error)),
            Some(None) | None => Ok(None),
        }
    }

    /// The schema of a type, to show messages. If it is a wrong definition of ROS 2, standard error says so once, and
    /// the messages are shown as those of a type without a schema.
    pub(crate) fn shown(&mut self, command_node: &CommandNode, data: &TypeId) -> Option<&Codec> {
        let is_new = self.ask(command_node, data);
        self.known_shown(data, is_new)
    }

    /// As [`shown`](Self::shown), for a type whose schema text is known, or is known not to be there.
    pub(crate) fn shown_with(&mut self, data: &TypeId, text: Option<&str>) -> Option<&Codec> {
        let is_new = !self.known.contains_key(data);
        if is_new {
            self.learn(data, text.map(str::to_owned));
        }
        self.known_shown(data, is_new)
    }

    fn known_shown(&self, data: &TypeId, is_new: bool) -> Option<&Codec> {
        match self.known.get(data)? {
            Some(Ok(codec)) => Some(codec),
            Some(Err(error)) => {
                if is_new {
                    stderr_line!("sm2: {}", definition(data, error));
                }
                None
            }
            None => None,
        }
    }

    /// Asks for the schema of a type, unless it is known. Returns whether there is a new answer.
    fn ask(&mut self, command_node: &CommandNode, data: &TypeId) -> bool {
        if self.known.contains_key(data) {
            return false;
        }
        // Without a Manager there is no answer. The next message asks again.
        let Ok(text) = command_node.describe(data) else {
            return false;
        };
        self.learn(data, text);
        true
    }

    fn learn(&mut self, data: &TypeId, text: Option<String>) {
        let schema = text.or_else(|| self.defined(data));
        let schema = schema.and_then(|text| Schema::parse(&text).ok());
        let codec = schema.map(|schema| Codec::new(&data.name, schema));
        self.known.insert(data.clone(), codec);
    }

    /// The schema text of a type of ROS 2 that no node has registered.
    fn defined(&self, data: &TypeId) -> Option<String> {
        // A folder of `--definitions` that cannot be read is an error where the command reads `--type`.
        let known = self.definitions.of_ros(&data.name).ok().flatten()?;
        known.schema.filter(|_| known.data == *data)
    }
}

/// A message as a member of a JSON object.
#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Content<'a> {
    /// A value that was decoded by its schema.
    Value(Value<'a>),
    Text(&'a str),
    Hex(String),
    File(Cow<'a, str>),
}

impl<'a> Content<'a> {
    /// The most readable form of a message.
    pub(crate) fn new(message: &'a [u8], schema: Option<&'a Codec>, show: Show) -> Self {
        let decoded = match (schema, show) {
            (_, Show { hex: true, .. }) => return Self::Hex(Hex(message, "").to_string()),
            (Some(schema), Show { raw: false, .. }) => schema.decode_all(message).ok(),
            _ => None,
        };
        match (decoded, str::from_utf8(message)) {
            (Some(value), _) if !matches!(value, Value::Text(_)) => Self::Value(value),
            (_, Ok(text)) => Self::Text(text),
            (_, Err(_)) => Self::Hex(Hex(message, "").to_string()),
        }
    }
}

/// A message as lines of text, with a newline at the end.
pub(crate) fn lines(message: &[u8], schema: Option<&Codec>, show: Show) -> Vec<u8> {
    let mut lines = Vec::new();
    if show.hex {
        lines = Hex(message, "").to_string().into_bytes();
        lines.push(b'\n');
        return lines;
    }
    let decoded = schema.filter(|_| !show.raw).map(|schema| {
        // The decoder counts the elements that are not shown.
        schema.decode(message, Limits::SCREEN.elements)
    });
    match decoded {
        Some(Ok(value)) if !matches!(value, Value::Text(_)) => {
            lines = decode::show(&value, &Limits::SCREEN).into_bytes();
            lines.push(b'\n');
        }
        Some(Err(error)) => {
            text::write_bytes(&mut lines, message);
            lines.extend_from_slice(format!("  (not a message of its type: {error})\n").as_bytes());
        }
        _ => text::write_message(&mut lines, message),
    }
    lines
}

/// Encodes JSON from the command line as a message.
///
/// # Errors
///
/// [`CliError::Encode`]; [`CliError::NoSchema`] if no node has registered the schema of the type.
pub(crate) fn bytes_of(
    value: &serde_json::Value,
    data: &TypeId,
    schema: Option<&Codec>,
) -> Result<Vec<u8>, CliError> {
    let Some(schema) = schema else {
        return match value {
            serde_json::Value::String(text) if is_bytes(data) => Ok(text.clone().into_bytes()),
            _ => Err(CliError::NoSchema(match is_bytes(data) {
                true => {
                    "messages of type bytes have no fields: give a JSON text, or a file with --from"
                        .into()
                }
                false => format!(
                    "no node has registered the schema of {data}: start a program that uses the type, \
                     give the schema with --schema, or give the bytes with --from"
                ),
            })),
        };
    };
    schema.encode(value).map_err(|error| CliError::Encode {
        data: data.to_string(),
        reason: error.to_string(),
    })
}

/// The error for a definition of ROS 2 that cannot serve to read or write messages of the type.
pub(crate) fn definition(data: &TypeId, error: &CodecError) -> CliError {
    CliError::Definition {
        data: data.to_string(),
        reason: error.clone(),
    }
}

/// Whether this is the type `bytes`, which has no schema.
fn is_bytes(data: &TypeId) -> bool {
    data.name.as_str() == "bytes" && data.hash == 0
}
