//! RIHS01: the SHA-256 of a type's description as JSON. ROS 2 compares types by it (REP 2011).

use std::fmt::{self, Write as _};

use sha2::{Digest, Sha256};

use crate::{Base, FieldType, Message, Set, SetError, Shape, TypeName};

/// The RIHS01 hash of a type. [`Display`](fmt::Display) is ROS 2's text: `RIHS01_` and 64 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TypeHash(pub [u8; 32]);

impl fmt::Display for TypeHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RIHS01_")?;
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl Set {
    /// Computes the RIHS01 hash of a type.
    ///
    /// # Errors
    ///
    /// As [`closure`](Self::closure).
    pub fn hash(&self, name: &TypeName) -> Result<TypeHash, SetError> {
        let mut types = self.closure(name)?;
        let whole = types.pop();
        types.sort_by_key(|it| it.name.to_string());
        let mut json = String::from("{\"type_description\": ");
        if let Some(whole) = whole {
            describe(&mut json, whole);
        }
        json.push_str(", \"referenced_type_descriptions\": [");
        for (at, part) in types.into_iter().enumerate() {
            json.push_str(if at > 0 { ", " } else { "" });
            describe(&mut json, part);
        }
        json.push_str("]}");
        Ok(TypeHash(Sha256::digest(json).into()))
    }
}

/// Appends a description as Python's `json.dumps` writes it. Names consist of letters, digits, `_` and `/`, so
/// nothing has to be escaped.
fn describe(json: &mut String, message: &Message) {
    json.push_str("{\"type_name\": \"");
    json.push_str(&message.name.to_string());
    json.push_str("\", \"fields\": [");
    let mut separator = "";
    for field in &message.fields {
        json.push_str(separator);
        describe_field(json, &field.name, &Described::of(&field.ty));
        separator = ", ";
    }
    if message.fields.is_empty() {
        // IDL has no structure without fields, so ROS 2 adds one.
        let byte = Described {
            type_id: crate::Primitive::Uint8.type_id(),
            ..Described::default()
        };
        describe_field(json, "structure_needs_at_least_one_member", &byte);
    }
    json.push_str("]}");
}

fn describe_field(json: &mut String, name: &str, ty: &Described) {
    let Described {
        type_id,
        capacity,
        string_capacity,
        nested,
    } = ty;
    // Writing to a `String` does not fail.
    let _never = write!(
        json,
        "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {type_id}, \"capacity\": {capacity}, \
         \"string_capacity\": {string_capacity}, \"nested_type_name\": \"{nested}\"}}}}"
    );
}

/// The members of `type_description_interfaces/msg/FieldType`.
#[derive(Default)]
struct Described {
    type_id: u8,
    capacity: u32,
    string_capacity: u32,
    nested: String,
}

impl Described {
    fn of(ty: &FieldType) -> Self {
        let (added, capacity) = match ty.shape {
            Shape::One => (0, 0),
            Shape::Array(len) => (48, len),
            Shape::Sequence(Some(max)) => (96, max),
            Shape::Sequence(None) => (144, 0),
        };
        let (base_id, string_capacity) = match &ty.base {
            Base::Message(_) => (1, 0),
            Base::Primitive(primitive) => (primitive.type_id(), 0),
            Base::String { max_bytes: None } => (17, 0),
            Base::WString { max_units: None } => (18, 0),
            Base::String {
                max_bytes: Some(max),
            } => (21, *max),
            Base::WString {
                max_units: Some(max),
            } => (22, *max),
        };
        Self {
            type_id: base_id + added,
            capacity,
            string_capacity,
            nested: match &ty.base {
                Base::Message(name) => name.to_string(),
                _ => String::new(),
            },
        }
    }
}
