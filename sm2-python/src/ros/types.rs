//! The definitions of a type of ROS 2, and of those that it refers to.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::json;
use sm2_ros_idl::{Message, Primitive, Set, TypeName};

use crate::errors::{PublishError, SchemaError, raise};

/// The definitions that one type needs. [`Set::closure`] has found no cycle among them.
pub(super) struct Types {
    pub(super) set: Set,
    pub(super) name: TypeName,
    /// Messages with the default values of these types.
    pub(super) defaults: Mutex<HashMap<TypeName, Py<PyBytes>>>,
}

impl Types {
    /// The type of this name. All names come from `set`.
    pub(super) fn get(&self, name: &TypeName) -> PyResult<&Message> {
        self.set
            .get(name)
            .map_err(raise(SchemaError::new_err::<String>))
    }

    /// A message with the default values of the type.
    pub(super) fn default_of(&self, py: Python<'_>, name: &TypeName) -> PyResult<Py<PyBytes>> {
        let lock = || self.defaults.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(bytes) = lock().get(name) {
            return Ok(bytes.clone_ref(py));
        }
        let bytes = sm2_ros::encode(&self.set, name, &json!({}))
            .map_err(raise(PublishError::new_err::<String>))?;
        let bytes = PyBytes::new(py, &bytes).unbind();
        lock().insert(name.clone(), bytes.clone_ref(py));
        Ok(bytes)
    }
}

/// The numpy dtype of a number.
pub(super) fn dtype(primitive: Primitive, big_endian: bool) -> String {
    let kind = match primitive {
        Primitive::Bool => '?',
        Primitive::Byte | Primitive::Char => 'u',
        Primitive::Uint8 | Primitive::Uint16 | Primitive::Uint32 | Primitive::Uint64 => 'u',
        Primitive::Int8 | Primitive::Int16 | Primitive::Int32 | Primitive::Int64 => 'i',
        Primitive::Float32 | Primitive::Float64 => 'f',
    };
    let order = if big_endian { '>' } else { '<' };
    match kind {
        '?' => "?".to_owned(),
        kind => format!("{order}{kind}{}", primitive.size_bytes()),
    }
}
