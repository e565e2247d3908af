//! Types of ROS 2 that are known at run time. The crate `sm2-ros` reads and writes their bytes.

mod encode;
mod types;
mod view;

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use sm2_ros_idl::{FolderError, Set, TypeName};

use crate::errors::{SchemaError, raise};
use types::Types;
pub(crate) use view::RosView;

/// A type of ROS 2, and the types that it refers to.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct RosType {
    types: Arc<Types>,
    #[pyo3(get)]
    schema: String,
}

#[pymethods]
impl RosType {
    /// The type `name`, by the definitions in these folders and those of the common interfaces.
    #[new]
    fn new(name: &str, folders: Vec<PathBuf>) -> PyResult<Self> {
        let wrong = raise(SchemaError::new_err::<String>);
        let name: TypeName = name.parse().map_err(wrong)?;
        let mut set = Set::default();
        for folder in folders {
            set.add_definitions(&folder).map_err(unreadable)?;
        }
        sm2_ros::definitions::complete(&mut set, &name);
        let schema = set
            .schema_text(&name)
            .map_err(raise(SchemaError::new_err::<String>))?;
        let defaults = Mutex::default();
        let types = Arc::new(Types {
            set,
            name,
            defaults,
        });
        Ok(Self { types, schema })
    }

    #[getter]
    fn name(&self) -> String {
        self.types.name.to_string()
    }

    /// The names of the fields, with their types as definitions write them.
    #[getter]
    fn fields(&self) -> PyResult<Vec<(String, String)>> {
        let fields = &self.types.get(&self.types.name)?.fields;
        let fields = fields.iter();
        Ok(fields
            .map(|it| (it.name.to_string(), it.ty.to_string()))
            .collect())
    }

    /// The names of the constants, with their types and values as the definition writes them.
    #[getter]
    fn constants(&self) -> PyResult<Vec<(String, String, String)>> {
        let constants = &self.types.get(&self.types.name)?.constants;
        let constants = constants.iter();
        Ok(constants
            .map(|it| (it.name.to_string(), it.ty.to_string(), it.value.to_string()))
            .collect())
    }

    /// A message with the default values of the type.
    fn default(&self, py: Python<'_>) -> PyResult<RosView> {
        RosView::default_of(py, &self.types, &self.types.name)
    }

    /// A message in memory that `data` exports. Its fields are read when the program asks for them.
    fn decode(&self, data: Py<PyAny>) -> RosView {
        RosView::new(Arc::clone(&self.types), data)
    }

    /// The bytes of a message.
    fn encode<'py>(&self, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
        encode::message(&self.types, value)
    }
}

fn unreadable(error: FolderError) -> PyErr {
    match error {
        FolderError::Io { path, error } => {
            PyOSError::new_err(format!("{}: {error}", path.display()))
        }
        error => SchemaError::new_err(error.to_string()),
    }
}
