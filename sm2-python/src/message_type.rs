//! Message types that are known only at run time: a name and a schema text.

use pyo3::prelude::*;
use sm2_node::{Name, TypeId, explain::difference};
use sm2_proto::schema::Schema;

use crate::errors::SchemaError;

/// A message type. In Python it is a tuple of its name and its schema text; without a text it is raw bytes.
#[derive(Clone, Debug)]
pub(crate) struct MessageType {
    pub(crate) id: TypeId,
    pub(crate) text: Option<String>,
}

impl<'py> FromPyObject<'_, 'py> for MessageType {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let (name, text): (String, Option<String>) = object.extract()?;
        let hash = match &text {
            None => 0,
            Some(text) => match Schema::parse(text) {
                Ok(schema) => schema.hash(),
                Err(reason) => {
                    let text = format!("the schema text of {name} is malformed: {reason}: {text}");
                    return Err(SchemaError::new_err(text));
                }
            },
        };
        let name = Name::new(&name)
            .map_err(|reason| SchemaError::new_err(format!("type name {name:?}: {reason}")))?;
        let id = TypeId { name, hash };
        Ok(Self { id, text })
    }
}

/// The text for a person who declared `ours`, while the topic carries `theirs`: both schemas and their first
/// difference.
pub(crate) fn comparison(ours: &MessageType, theirs: &TypeId, their_text: Option<&str>) -> String {
    let shown = |id: &TypeId, text: Option<&str>| match text {
        Some(text) => text.to_owned(),
        None if id.hash == 0 => "raw bytes".to_owned(),
        None => "no node has registered its schema".to_owned(),
    };
    let our_text = ours.text.as_deref();
    let mut lines = format!(
        "\n  declared: {}: {}\n  in use:   {}: {}",
        ours.id.name,
        shown(&ours.id, our_text),
        theirs.name,
        shown(theirs, their_text),
    );
    if let (Some(ours), Some(theirs)) = (our_text, their_text)
        && let (Ok(ours), Ok(theirs)) = (Schema::parse(ours), Schema::parse(theirs))
        && let Some(difference) = difference(&ours, &theirs)
    {
        lines.push_str("\n  first difference: ");
        lines.push_str(&difference.to_string());
    }
    lines
}
