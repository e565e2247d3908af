//! The bytes of messages of ROS 2 whose values are Python objects.

use std::sync::Arc;

use pyo3::exceptions::{
    PyAttributeError, PyOverflowError, PyTypeError, PyUnicodeError, PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use sm2_ros::cdr::Writer;
use sm2_ros::{EncodeError, FieldPath};
use sm2_ros_idl::{Base, Field, FieldType, Message, Primitive, Shape, TypeName};

use super::types::{Types, dtype};
use super::view::RosView;
use crate::errors::PublishError;
use crate::input::Input;

/// Encodes a message: a dictionary with fields, or an object whose attributes are the fields.
pub(super) fn message<'py>(
    types: &Arc<Types>,
    value: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyBytes>> {
    let py = value.py();
    let mut encoder = Encoder {
        types,
        writer: Writer::new(Vec::new()),
    };
    encoder.message(&types.name, value).map_err(|wrong| {
        let text = format!("the value is not of type {}: {}", types.name, wrong.text());
        match wrong {
            Wrong::Value(error) => PublishError::new_err(format!("{text}{error}")),
            Wrong::Python { error, .. } if is_of_value(py, &error) => {
                PublishError::new_err(format!("{text}{}", error.value(py)))
            }
            Wrong::Python { error, .. } => error,
        }
    })?;
    Ok(PyBytes::new(py, &encoder.writer.into_sink()))
}

/// Whether an exception is about the value that the program passed. Others, such as `MemoryError`, stay as they are.
fn is_of_value(py: Python<'_>, error: &PyErr) -> bool {
    error.is_instance_of::<PyAttributeError>(py)
        || error.is_instance_of::<PyTypeError>(py)
        || error.is_instance_of::<PyOverflowError>(py)
        || error.is_instance_of::<PyUnicodeError>(py)
        || error.is_instance_of::<PyValueError>(py)
}

/// The reason why a value has no encoding.
enum Wrong {
    Value(EncodeError),
    Python { path: FieldPath, error: PyErr },
}

impl Wrong {
    fn within(self, step: &str) -> Self {
        match self {
            Self::Value(error) => Self::Value(error.within(step)),
            Self::Python { mut path, error } => {
                path.prepend(step);
                Self::Python { path, error }
            }
        }
    }

    /// The path, with a colon. The text of an `EncodeError` has its own.
    fn text(&self) -> String {
        match self {
            Self::Value(_) => String::new(),
            Self::Python { path, .. } => format!("{path}: "),
        }
    }
}

impl From<PyErr> for Wrong {
    fn from(error: PyErr) -> Self {
        let path = FieldPath::MESSAGE;
        Self::Python { path, error }
    }
}

impl From<EncodeError> for Wrong {
    fn from(error: EncodeError) -> Self {
        Self::Value(error)
    }
}

struct Encoder<'t> {
    types: &'t Arc<Types>,
    writer: Writer<Vec<u8>>,
}

impl Encoder<'_> {
    fn message(&mut self, name: &TypeName, value: &Bound<'_, PyAny>) -> Result<(), Wrong> {
        let types = self.types;
        let message = types.get(name)?;
        let dict = value.cast::<PyDict>().ok();
        if let Some(dict) = dict {
            check_names(message, dict)?;
        }
        if message.fields.is_empty() {
            // IDL has no structure without fields: ROS 2 sends a byte.
            self.writer.number(0_u8);
        }
        for field in &message.fields {
            let value = match dict {
                None => value.getattr(&*field.name)?,
                Some(dict) => match dict.get_item(&*field.name)? {
                    Some(value) => value,
                    None => RosView::default_of(value.py(), types, name)?
                        .field(value.py(), &field.name)?,
                },
            };
            let written = self.field(field, &value);
            written.map_err(|wrong| wrong.within(&field.name))?;
        }
        Ok(())
    }

    fn field(&mut self, field: &Field, value: &Bound<'_, PyAny>) -> Result<(), Wrong> {
        let FieldType { base, shape } = &field.ty;
        if *shape == Shape::One {
            return self.value(base, value);
        }
        if let Base::Primitive(primitive) = base {
            return self.numbers(*primitive, *shape, value);
        }
        let len = value.len()?;
        self.len(*shape, len)?;
        for (at, item) in value.try_iter()?.take(len).enumerate() {
            let written = self.value(base, &item?);
            written.map_err(|wrong| wrong.within(&format!("[{at}]")))?;
        }
        Ok(())
    }

    /// Writes the length of a sequence, and checks that of an array.
    fn len(&mut self, shape: Shape, len: usize) -> Result<(), Wrong> {
        match shape {
            Shape::Sequence(max) => Ok(self.writer.len(len, max)?),
            Shape::Array(expected) if len != expected as usize => {
                let text = format!("expected {expected} elements, found {len}");
                Err(PyValueError::new_err(text).into())
            }
            Shape::Array(_) | Shape::One => Ok(()),
        }
    }

    /// Writes an array of numpy, or what `sm2.ros` makes one of.
    fn numbers(
        &mut self,
        primitive: Primitive,
        shape: Shape,
        value: &Bound<'_, PyAny>,
    ) -> Result<(), Wrong> {
        let convert = value.py().import("sm2._numbers")?.getattr("contiguous")?;
        let array = convert.call1((value, dtype(primitive, false)))?;
        let input: Input = array.extract()?;
        let size = primitive.size_bytes();
        self.len(shape, input.bytes().len() / size)?;
        self.writer.number_bytes(input.bytes(), size);
        Ok(())
    }

    fn value(&mut self, base: &Base, value: &Bound<'_, PyAny>) -> Result<(), Wrong> {
        match base {
            Base::Primitive(primitive) => self.primitive(*primitive, value)?,
            Base::String { max_bytes } => self.writer.text(value.extract()?, *max_bytes)?,
            Base::WString { max_units } => self.writer.wide_text(value.extract()?, *max_units)?,
            Base::Message(name) => self.message(name, value)?,
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: Primitive, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let writer = &mut self.writer;
        match primitive {
            Primitive::Bool => writer.bool(value.extract()?),
            Primitive::Byte | Primitive::Char | Primitive::Uint8 => {
                writer.number::<u8>(value.extract()?);
            }
            Primitive::Uint16 => writer.number::<u16>(value.extract()?),
            Primitive::Uint32 => writer.number::<u32>(value.extract()?),
            Primitive::Uint64 => writer.number::<u64>(value.extract()?),
            Primitive::Int8 => writer.number::<i8>(value.extract()?),
            Primitive::Int16 => writer.number::<i16>(value.extract()?),
            Primitive::Int32 => writer.number::<i32>(value.extract()?),
            Primitive::Int64 => writer.number::<i64>(value.extract()?),
            Primitive::Float32 => writer.number::<f32>(value.extract()?),
            Primitive::Float64 => writer.number::<f64>(value.extract()?),
        }
        Ok(())
    }
}

/// A misspelt field would silently have its default value.
fn check_names(message: &Message, dict: &Bound<'_, PyDict>) -> PyResult<()> {
    for name in dict.keys() {
        let name: String = name.extract()?;
        if message.fields.iter().all(|it| *it.name != *name) {
            let text = format!("{} has no field {name}", message.name);
            return Err(PyTypeError::new_err(text));
        }
    }
    Ok(())
}
