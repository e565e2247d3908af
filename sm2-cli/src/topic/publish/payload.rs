//! The type of the published messages, and the bytes of `--value`.

use serde_json::Value;
use sm2_proto::{Name, TypeId, schema::Schema};

use super::arguments::Arguments;
use crate::{
    built_in::BuiltIn,
    connect::CommandNode,
    decode::Codec,
    error::CliError,
    messages::{Schemas, bytes_of, definition},
    view::View,
};

/// The type to declare, and the bytes to publish if `--value` gives them.
pub(super) struct Payload {
    pub(super) data: TypeId,
    pub(super) bytes: Option<Vec<u8>>,
}

/// The value of `--value`.
///
/// # Errors
///
/// [`CliError::Json`].
pub(super) fn value(arguments: &Arguments) -> Result<Option<Value>, CliError> {
    let value = arguments.value.as_deref().map(serde_json::from_str);
    value.transpose().map_err(CliError::Json)
}

impl Payload {
    /// # Errors
    ///
    /// [`CliError::Query`], [`CliError::NoSchema`], [`CliError::Definition`], [`CliError::Encode`].
    pub(super) fn new(
        arguments: &Arguments,
        command_node: &CommandNode,
        value: Option<&Value>,
    ) -> Result<Self, CliError> {
        let Declared { data, schema } = declared(arguments, command_node, value.is_some())?;
        let bytes = match (value, &schema) {
            (None, _) => None,
            (Some(value), Some(schema)) => {
                let codec = Codec::new(&data.name, schema.clone());
                let codec = codec.map_err(|error| definition(&data, &error))?;
                Some(bytes_of(value, &data, Some(&codec))?)
            }
            (Some(value), None) => {
                let mut schemas = Schemas::new(&arguments.definitions);
                Some(bytes_of(value, &data, schemas.of(command_node, &data)?)?)
            }
        };
        if let Some(schema) = &schema {
            // Subscribers that were built without the type can then read its messages.
            command_node
                .node
                .register_schema(data.clone(), &schema.to_string())?;
        }
        Ok(Self { data, bytes })
    }
}

/// The type to declare, and its schema if the arguments or the type's name give it.
struct Declared {
    data: TypeId,
    schema: Option<Schema>,
}

/// The type to declare. Without a hash in the arguments, the type is that of the topic, else the built-in
/// type of this name, else that of ROS 2. With `--definitions`, the topic cannot replace the type that they define.
fn declared(
    arguments: &Arguments,
    command_node: &CommandNode,
    takes_topics: bool,
) -> Result<Declared, CliError> {
    let given = |name: &Name, hash, schema: Option<&Schema>| Declared {
        data: TypeId {
            name: name.clone(),
            hash,
        },
        schema: schema.cloned(),
    };
    let in_use = || -> Result<Option<Declared>, CliError> {
        let domain = command_node.snapshot()?;
        let data = View::new(&domain).topic_type(&arguments.topic).cloned();
        Ok(data.map(|data| Declared { data, schema: None }))
    };
    let bytes = || Declared {
        data: <[u8] as sm2_node::Message>::type_id(),
        schema: None,
    };
    match (&arguments.data, &arguments.schema) {
        (Some(data), Some(schema)) => {
            let hash = schema_hash(data.hash, schema)?;
            Ok(given(&data.name, hash, Some(schema)))
        }
        (Some(data), None) => match data.hash {
            Some(hash) => Ok(given(&data.name, hash, None)),
            None if data.name.as_str() == "bytes" => Ok(bytes()),
            None => {
                let known = known(&data.name, arguments)?;
                let in_use = in_use()?.filter(|it| it.data.name == data.name);
                Ok(match (in_use, known) {
                    (Some(in_use), Some(known))
                        if in_use.data != known.data && arguments.definitions.is_empty() =>
                    {
                        in_use
                    }
                    // The text need not be in the domain.
                    (_, Some(known)) => known,
                    (Some(in_use), None) => in_use,
                    (None, None) => given(&data.name, 0, None),
                })
            }
        },
        (None, _) if takes_topics => Ok(in_use()?.unwrap_or_else(bytes)),
        (None, _) => Ok(bytes()),
    }
}

/// The type that the name alone determines.
fn known(name: &Name, arguments: &Arguments) -> Result<Option<Declared>, CliError> {
    let known = arguments.definitions.known(name)?;
    Ok(known.map(|BuiltIn { data, schema }| {
        let schema = schema.and_then(|text| Schema::parse(&text).ok());
        Declared { data, schema }
    }))
}

/// The hash of the schema. Another hash in `--type` is an error.
fn schema_hash(given: Option<u64>, schema: &Schema) -> Result<u64, CliError> {
    let hash = schema.hash();
    match given {
        Some(given) if given != hash => Err(CliError::SchemaHash { given, hash }),
        _ => Ok(hash),
    }
}
