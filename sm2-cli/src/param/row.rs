//! Parameters as the commands print them.

use serde::{Serialize, Serializer, ser::SerializeSeq};
use sm2_node::params::{Entry, Range, Table, Value};
use sm2_proto::Name;

/// The parameters of a node as a JSON object.
#[derive(Serialize)]
pub(super) struct Node<'a> {
    node: &'a str,
    revision: u64,
    time_ns: u64,
    parameters: Vec<Row<'a>>,
}

impl<'a> Node<'a> {
    pub(super) fn new(node: &'a Name, table: &'a Table) -> Self {
        Self::with(node, table, table.parameters.iter())
    }

    /// Only some of the parameters.
    pub(super) fn with(
        node: &'a Name,
        table: &'a Table,
        entries: impl Iterator<Item = &'a Entry>,
    ) -> Self {
        Self {
            node: node.as_str(),
            revision: table.revision,
            time_ns: table.time_ns,
            parameters: entries.map(Row::from).collect(),
        }
    }
}

/// A parameter as a JSON object.
#[derive(Serialize)]
pub(super) struct Row<'a> {
    name: &'a str,
    #[serde(rename = "type")]
    kind: &'static str,
    value: Json<'a>,
    origin: &'static str,
    revision: u64,
    read_only: bool,
    range: Option<Bounds>,
    description: &'a str,
}

impl<'a> From<&'a Entry> for Row<'a> {
    fn from(entry: &'a Entry) -> Self {
        Self {
            name: &entry.name,
            kind: entry.kind().word(),
            value: Json(&entry.value),
            origin: entry.origin.word(),
            revision: entry.revision,
            read_only: entry.read_only,
            range: entry.range.map(Bounds::from),
            description: &entry.description,
        }
    }
}

/// A range as a JSON object.
#[derive(Serialize)]
#[serde(untagged)]
enum Bounds {
    Integer { from: i64, to: i64, step: u64 },
    Double { from: f64, to: f64, step: f64 },
}

impl From<Range> for Bounds {
    fn from(range: Range) -> Self {
        match range {
            Range::Integer { from, to, step } => Self::Integer { from, to, step },
            Range::Double { from, to, step } => Self::Double { from, to, step },
        }
    }
}

/// A value as JSON, without its type. JSON has no infinite numbers: they are the texts `inf`, `-inf` and `nan`.
struct Json<'a>(&'a Value);

impl Serialize for Json<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Value::Bool(it) => it.serialize(serializer),
            Value::Integer(it) => it.serialize(serializer),
            Value::Double(it) if it.is_finite() => it.serialize(serializer),
            Value::Double(_) => serializer.serialize_str(&self.0.to_string()),
            Value::String(it) => it.serialize(serializer),
            Value::ByteArray(it) => it.serialize(serializer),
            Value::BoolArray(it) => it.serialize(serializer),
            Value::IntegerArray(it) => it.serialize(serializer),
            Value::DoubleArray(list) => {
                let mut sequence = serializer.serialize_seq(Some(list.len()))?;
                for &it in list {
                    sequence.serialize_element(&Json(&Value::Double(it)))?;
                }
                sequence.end()
            }
            Value::StringArray(it) => it.serialize(serializer),
        }
    }
}

/// The value alone: a text without quotes, and all others as in a file.
pub(super) fn bare(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        value => value.to_string(),
    }
}
