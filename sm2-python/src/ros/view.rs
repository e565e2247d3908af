//! Messages of ROS 2 whose fields are read when the program asks for them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use sm2_ros::Value;
use sm2_ros::place::{self, Part};
use sm2_ros_idl::{Primitive, TypeName};

use super::types::{Types, dtype};
use crate::errors::RecvError;
use crate::input::Input;

/// A message, or a part of one, in the memory of a sample.
///
/// Each field is an attribute. An array or a sequence of numbers is a read-only numpy array that views the memory of
/// the sample. Another array or sequence is a list, and a message inside is a view again.
#[pyclass(frozen, module = "sm2.ros", name = "View")]
pub(crate) struct RosView {
    types: Arc<Types>,
    name: TypeName,
    /// Exports the memory of the whole message.
    data: Py<PyAny>,
    /// The places of the first fields, as far as they are known; that of the first one always is.
    places: Mutex<Vec<usize>>,
}

impl RosView {
    pub(super) fn new(types: Arc<Types>, data: Py<PyAny>) -> Self {
        let name = types.name.clone();
        Self::at(types, name, data, place::START)
    }

    pub(super) fn default_of(
        py: Python<'_>,
        types: &Arc<Types>,
        name: &TypeName,
    ) -> PyResult<Self> {
        let data = types.default_of(py, name)?.into_any();
        Ok(Self::at(
            Arc::clone(types),
            name.clone(),
            data,
            place::START,
        ))
    }

    fn at(types: Arc<Types>, name: TypeName, data: Py<PyAny>, at: usize) -> Self {
        Self {
            types,
            name,
            data,
            places: Mutex::new(vec![at]),
        }
    }

    /// The value of a field. It is looked for from the last field on whose place is known.
    pub(super) fn field<'py>(
        &self,
        py: Python<'py>,
        field_name: &str,
    ) -> PyResult<Bound<'py, PyAny>> {
        let fields = &self.types.get(&self.name)?.fields;
        let Some(wanted) = fields.iter().position(|it| *it.name == *field_name) else {
            let text = format!("{} has no field {field_name}", self.name);
            return Err(PyAttributeError::new_err(text));
        };
        let input: Input = self.data.extract(py)?;
        let (set, bytes) = (&self.types.set, input.bytes());
        let mut places = self.lock();
        let known = places.len().min(wanted + 1);
        let mut at = places.get(known - 1).copied().unwrap_or(place::START);
        for field in fields.iter().take(wanted).skip(known - 1) {
            let next = place::skip(set, &field.ty, bytes, at);
            at = next.map_err(|error| self.malformed(error.within(&field.name)))?;
            places.push(at);
        }
        drop(places);
        let Some(field) = fields.get(wanted) else {
            return Ok(py.None().into_bound(py));
        };
        let (part, _) = place::read(set, &field.ty, bytes, at)
            .map_err(|error| self.malformed(error.within(&field.name)))?;
        self.value(py, part)
    }

    fn value<'py>(&self, py: Python<'py>, part: Part<'_>) -> PyResult<Bound<'py, PyAny>> {
        match part {
            Part::Value(value) => single(py, value),
            Part::Numbers {
                primitive,
                len,
                at,
                big_endian,
            } => self.array(py, (primitive, big_endian), len, at),
            Part::List(parts) => {
                let list = PyList::empty(py);
                for part in parts {
                    list.append(self.value(py, part)?)?;
                }
                Ok(list.into_any())
            }
            Part::Message { name, at } => {
                let (types, data) = (Arc::clone(&self.types), self.data.clone_ref(py));
                Self::at(types, name.clone(), data, at).into_bound_py_any(py)
            }
        }
    }

    /// The numbers in place. Booleans are copied, because any byte may stand for one.
    fn array<'py>(
        &self,
        py: Python<'py>,
        (primitive, big_endian): (Primitive, bool),
        len: usize,
        at: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let is_bool = primitive == Primitive::Bool;
        let dtype = if is_bool {
            "u1".to_owned()
        } else {
            dtype(primitive, big_endian)
        };
        let numpy = py.import("numpy")?;
        let array = numpy.call_method1("frombuffer", (&self.data, dtype, len, at))?;
        if is_bool {
            array.call_method1("astype", ("?",))
        } else {
            Ok(array)
        }
    }

    fn malformed(&self, error: sm2_ros::DecodeError) -> PyErr {
        let text = format!("the message is not of type {}: {error}", self.types.name);
        RecvError::new_err(text)
    }

    fn lock(&self) -> MutexGuard<'_, Vec<usize>> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl RosView {
    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        self.field(py, name)
    }

    /// The names of the fields.
    fn __dir__(&self) -> PyResult<Vec<String>> {
        let fields = &self.types.get(&self.name)?.fields;
        Ok(fields.iter().map(|it| it.name.to_string()).collect())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let values = PyDict::new(py);
        for name in self.__dir__()? {
            values.set_item(&name, self.field(py, &name)?)?;
        }
        let mut parts = Vec::new();
        for (name, value) in values {
            parts.push(format!("{name}={}", value.repr()?));
        }
        Ok(format!("<{} {}>", self.name, parts.join(", ")))
    }
}

fn single<'py>(py: Python<'py>, value: Value<'static>) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::Bool(value) => value.into_bound_py_any(py),
        Value::Unsigned(number) => number.into_bound_py_any(py),
        Value::Signed(number) => number.into_bound_py_any(py),
        Value::F32(number) => number.into_bound_py_any(py),
        Value::F64(number) => number.into_bound_py_any(py),
        Value::Text(text) => text.into_bound_py_any(py),
        _ => Err(RecvError::new_err(
            "a single value is neither a list nor a message",
        )),
    }
}
