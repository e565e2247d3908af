//! The type of the published messages, and the bytes of a value that is given as JSON.

use serde_json::Value;
use sm2_proto::{Name, TypeId, schema::Schema};

use super::arguments::Arguments;
use crate::{
    connect::Session,
    error::CliError,
    messages::{Schemas, bytes_of, is_bytes},
    view::View,
};

/// The type to declare, and the bytes to publish if `--value` gives them.
pub(super) struct Payload {
    pub(super) data: TypeId,
    pub(super) bytes: Option<Vec<u8>>,
}

/// What `--value` says, as JSON.
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
    /// [`CliError::Query`], [`CliError::NoSchema`], [`CliError::Encode`].
    pub(super) fn new(
        arguments: &Arguments,
        session: &Session,
        value: Option<&Value>,
    ) -> Result<Self, CliError> {
        let data = data_type(arguments, session, value.is_some())?;
        let bytes = match (value, &arguments.schema) {
            (None, _) => None,
            (Some(value), Some(schema)) => Some(bytes_of(value, &data, Some(schema))?),
            (Some(value), None) => {
                let mut schemas = Schemas::default();
                let schema = match is_bytes(&data) {
                    true => None,
                    false => schemas.of(session, &data),
                };
                Some(bytes_of(value, &data, schema)?)
            }
        };
        if let Some(schema) = &arguments.schema {
            // Subscribers that do not know the type can read it too.
            session
                .node
                .register_schema(data.clone(), &schema.to_string())?;
        }
        Ok(Self { data, bytes })
    }
}

/// The type to declare: what is left open is taken to be what is in use.
fn data_type(
    arguments: &Arguments,
    session: &Session,
    takes_topics: bool,
) -> Result<TypeId, CliError> {
    let typed = |name: &Name, hash| TypeId {
        name: name.clone(),
        hash,
    };
    let bytes = <[u8] as sm2_node::Message>::type_id;
    let in_use = || -> Result<Option<TypeId>, CliError> {
        let domain = session.snapshot()?;
        Ok(View::new(&domain).topic_type(&arguments.topic).cloned())
    };
    match (&arguments.data, &arguments.schema) {
        (Some(data), Some(schema)) => Ok(typed(&data.name, schema_hash(data.hash, schema)?)),
        (Some(data), None) => match data.hash {
            Some(hash) => Ok(typed(&data.name, hash)),
            None if data.name.as_str() == "bytes" => Ok(bytes()),
            None => {
                let in_use = in_use()?.filter(|it| it.name == data.name);
                Ok(in_use.unwrap_or_else(|| typed(&data.name, 0)))
            }
        },
        (None, _) if takes_topics => Ok(in_use()?.unwrap_or_else(bytes)),
        (None, _) => Ok(bytes()),
    }
}

/// A schema has one hash; another one that is given beside it is a mistake.
fn schema_hash(given: Option<u64>, schema: &Schema) -> Result<u64, CliError> {
    let hash = schema.hash();
    match given {
        Some(given) if given != hash => Err(CliError::SchemaHash { given, hash }),
        _ => Ok(hash),
    }
}
