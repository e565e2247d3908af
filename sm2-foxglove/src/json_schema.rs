//! The JSON Schema of a type of SM2, as Foxglove reads it.
//!
//! Foxglove knows objects, arrays of values that are not arrays, and scalars. Everything else would make it refuse the
//! whole schema, so a field of another type is left out: its value is still in the message.
//!
//! | type | JSON | schema |
//! | --- | --- | --- |
//! | whole number of up to 64 bits | number | `integer` |
//! | floating-point number | number, or the text `NaN`, `inf` or `-inf` | `number` |
//! | whole number of 128 bits, character, text, enumeration without fields | text | `string` |
//! | structure | object | `object` |
//! | map with texts, characters, whole numbers or booleans as keys | object | `object` |
//! | list, set, array, tuple of one type | array | `array` |
//! | optional value | the value or `null` | that of the value |
//! | list of lists, tuple of several types, enumeration with fields, other map | array or object | left out |

use serde_json::{Map, Value, json};
use sm2_proto::schema::{Field, Scalar, Type, Variant};

/// The name of the only field of a message whose JSON is not an object.
pub(crate) const VALUE: &str = "value";

/// The schema of the messages of a type, and whether they are in an object with the field [`VALUE`].
pub(crate) fn of(root: &Type) -> (Value, bool) {
    match schema(root) {
        Some(schema) if schema["type"] == "object" && !may_be_null(root) => (schema, false),
        schema => {
            let value = schema.map(|schema| (VALUE.to_owned(), schema));
            (object(value.into_iter().collect()), true)
        }
    }
}

fn may_be_null(ty: &Type) -> bool {
    match ty {
        Type::Option(_) => true,
        Type::Struct(fields) => match &fields[..] {
            [only] if only.name() == "0" => may_be_null(only.ty()),
            _ => false,
        },
        _ => false,
    }
}

fn object(properties: Map<String, Value>) -> Value {
    json!({ "type": "object", "properties": properties })
}

fn schema(ty: &Type) -> Option<Value> {
    match ty {
        Type::Scalar(scalar) => Some(scalar_schema(*scalar)),
        Type::Text => Some(json!({ "type": "string" })),
        Type::Struct(fields) => structure(fields),
        Type::Enum(variants) => enumeration(variants),
        Type::Array { element, .. } | Type::List(element) | Type::Set(element) => array(element),
        Type::Map { key, value } => match **key {
            Type::Scalar(Scalar::F32 | Scalar::F64) => None,
            Type::Scalar(_) | Type::Text => Some(match schema(value) {
                Some(value) => json!({ "type": "object", "additionalProperties": value }),
                None => json!({ "type": "object" }),
            }),
            _ => None,
        },
        Type::Option(value) => schema(value),
    }
}

fn scalar_schema(scalar: Scalar) -> Value {
    let name = match scalar {
        Scalar::F32 | Scalar::F64 => "number",
        Scalar::Bool => "boolean",
        Scalar::Char | Scalar::U128 | Scalar::I128 => "string",
        Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => "integer",
        Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64 => "integer",
    };
    json!({ "type": name })
}

/// A tuple of one value is that value, a tuple is an array, and an empty structure is `null`.
fn structure(fields: &[Field]) -> Option<Value> {
    let is_tuple = (fields.iter().enumerate()).all(|(at, field)| field.name() == at.to_string());
    match fields {
        [] => None,
        [only] if is_tuple => schema(only.ty()),
        [first, rest @ ..] if is_tuple => match rest.iter().all(|it| it.ty() == first.ty()) {
            true => array(first.ty()),
            false => None,
        },
        _ => {
            let property = |it: &Field| Some((it.name().to_owned(), schema(it.ty())?));
            Some(object(fields.iter().filter_map(property).collect()))
        }
    }
}

fn enumeration(variants: &[Variant]) -> Option<Value> {
    let has_fields = variants.iter().any(|it| !it.fields().is_empty());
    let names: Vec<_> = variants.iter().map(Variant::name).collect();
    (!has_fields).then(|| json!({ "type": "string", "enum": names }))
}

fn array(element: &Type) -> Option<Value> {
    let items = schema(element).filter(|it| it["type"] != "array")?;
    Some(json!({ "type": "array", "items": items }))
}

#[cfg(test)]
mod tests {
    use sm2_proto::schema::{Root, Schema};

    use super::*;

    fn of_text(text: &str) -> (Value, bool) {
        match Schema::parse(text).unwrap().root() {
            Root::Type(ty) => of(ty),
            Root::Definition(_) => panic!("a type of ROS 2"),
        }
    }

    #[test]
    fn a_structure_is_an_object() {
        let text = "postcard:struct{frame:string,id:u32,on:bool,at:struct{x:f64,y:f64,},\
                    points:list[struct{0:f32,1:f32,}],names:map[string,u8],last:option[i64],\
                    mode:enum{Idle:struct{},Busy:struct{},},}";
        let (schema, is_wrapped) = of_text(text);
        assert!(!is_wrapped);
        let expected = json!({ "type": "object", "properties": {
            "frame": { "type": "string" },
            "id": { "type": "integer" },
            "on": { "type": "boolean" },
            "at": { "type": "object", "properties": {
                "x": { "type": "number" }, "y": { "type": "number" } } },
            "names": { "type": "object", "additionalProperties": { "type": "integer" } },
            "last": { "type": "integer" },
            "mode": { "type": "string", "enum": ["Idle", "Busy"] },
        } });
        assert_eq!(schema, expected, "a list of tuples is left out");
    }

    #[test]
    fn other_messages_are_in_an_object() {
        let value = |schema: Value| json!({ "type": "object", "properties": { "value": schema } });
        for (text, expected) in [
            ("plain:string", json!({ "type": "string" })),
            ("plain:f32", json!({ "type": "number" })),
            (
                "plain:list[u16]",
                json!({ "type": "array", "items": { "type": "integer" } }),
            ),
            ("plain:struct{0:u128,}", json!({ "type": "string" })),
            ("postcard:option[char]", json!({ "type": "string" })),
            (
                "postcard:option[struct{x:u8,}]",
                json!({ "type": "object", "properties": { "x": { "type": "integer" } } }),
            ),
        ] {
            assert_eq!(of_text(text), (value(expected), true), "{text}");
        }
        for text in [
            "postcard:enum{A:struct{0:u8,},}",
            "postcard:list[list[u8]]",
            "postcard:struct{0:u8,1:f32,}",
        ] {
            let expected = json!({ "type": "object", "properties": {} });
            assert_eq!(of_text(text), (expected, true), "{text}");
        }
    }
}
