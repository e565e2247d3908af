//! Received messages.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBytes, PyDict, PyType};

use crate::handles::Owned;
use crate::memory::Memory;

/// Functions of numpy, which is imported once.
static FROM_BUFFER: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
static UINT8: PyOnceLock<Py<PyAny>> = PyOnceLock::new();

/// How many messages of one subscriber a program holds. Changed by threads that have the GIL.
#[derive(Debug)]
pub(crate) struct Account {
    pub(crate) topic: String,
    pub(crate) samples: AtomicUsize,
    pub(crate) views: AtomicUsize,
}

/// A received message. Its memory does not change as long as the sample or a view of it exists.
#[pyclass(frozen, weakref, module = "sm2")]
pub(crate) struct Sample {
    inner: Owned<sm2_node::Sample<[u8]>>,
    account: Arc<Account>,
    /// Called with this sample to get the message as a Python object.
    decode: Py<PyAny>,
    sequence: u64,
    source_time_ns: u64,
    lost: u64,
}

impl Sample {
    pub(crate) fn new(
        sample: sm2_node::Sample<[u8]>,
        account: &Arc<Account>,
        decode: Py<PyAny>,
    ) -> Self {
        account.samples.fetch_add(1, Ordering::Relaxed);
        Self {
            sequence: sample.sequence(),
            source_time_ns: sample.source_time().0,
            lost: sample.lost(),
            inner: Owned::new("sample", sample),
            account: Arc::clone(account),
            decode,
        }
    }

    /// The memory of the message, which must not be written.
    pub(crate) fn memory(&self) -> PyResult<Memory> {
        self.inner
            .with(|sample| (sample.as_ptr().cast_mut(), sample.len()))
    }

    pub(crate) fn viewed(&self) {
        self.account.views.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn unviewed(&self) {
        self.account.views.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Drop for Sample {
    fn drop(&mut self) {
        self.account.samples.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The base of an array of bytes: it counts as a view of its sample, as a `memoryview` does.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct ArrayBase {
    sample: Py<Sample>,
}

impl ArrayBase {
    fn new(sample: Py<Sample>) -> Self {
        sample.get().viewed();
        Self { sample }
    }

    /// The memory of the message, which must not be written.
    pub(crate) fn memory(&self) -> PyResult<Memory> {
        self.sample.get().memory()
    }
}

impl Drop for ArrayBase {
    fn drop(&mut self) {
        self.sample.get().unviewed();
    }
}

#[pymethods]
impl Sample {
    /// For type hints: `Sample[bytes]`.
    #[classmethod]
    fn __class_getitem__<'py>(
        class: &Bound<'py, PyType>,
        item: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let types = class.py().import("types")?;
        types.call_method1("GenericAlias", (class, item))
    }

    /// The name of the topic.
    #[getter]
    fn topic(&self) -> &str {
        &self.account.topic
    }

    /// The number of the publication, from 1.
    #[getter]
    fn sequence(&self) -> u64 {
        self.sequence
    }

    /// The time of publication, by `time.monotonic_ns()`.
    #[getter]
    fn source_time_ns(&self) -> u64 {
        self.source_time_ns
    }

    /// How many messages of this publisher were lost between the sample before and this one.
    #[getter]
    fn lost(&self) -> u64 {
        self.lost
    }

    /// The name of the publisher's node.
    #[getter]
    fn publisher(&self) -> PyResult<String> {
        self.inner.with(|sample| sample.publisher().to_string())
    }

    /// The name of the type that the publisher declared.
    #[getter]
    fn type_name(&self) -> PyResult<Option<String>> {
        self.inner
            .with(|sample| sample.type_id().map(|data| data.name.to_string()))
    }

    /// The message as a value of the topic's type. An array is a view of the memory of the sample.
    #[getter]
    fn value<'py>(slf: Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.get().decode.bind(slf.py()).call1((&slf,))
    }

    /// A read-only array that views the memory of the sample, of `uint8` by default, in this shape.
    #[pyo3(signature = (dtype = None, shape = None))]
    fn numpy<'py>(
        slf: Bound<'py, Self>,
        dtype: Option<Bound<'py, PyAny>>,
        shape: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = slf.py();
        let of_bytes = match &dtype {
            None => ArrayBase::array(Bound::new(py, ArrayBase::new(slf.clone().unbind()))?)?,
            Some(_) => None,
        };
        let array = match of_bytes {
            Some(array) => array,
            None => {
                let dtype = match dtype {
                    Some(dtype) => dtype,
                    None => UINT8.import(py, "numpy", "uint8")?.clone(),
                };
                let from_buffer = FROM_BUFFER.import(py, "numpy", "frombuffer")?;
                from_buffer.call1((slf, dtype))?
            }
        };
        match shape {
            Some(shape) => array.call_method1("reshape", (shape,)),
            None => Ok(array),
        }
    }

    fn __len__(&self) -> PyResult<usize> {
        self.inner.with(|sample| sample.len())
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.inner.with(|sample| PyBytes::new(py, sample))
    }

    /// DLPack, by numpy, which marks the memory as read-only.
    ///
    /// A consumer that names `copy` gets what it asks for, without a copy unless it wants one. numpy always does. Other
    /// consumers, such as PyTorch, do not look at the mark, and a write to the memory would end the process: they get a
    /// copy, unless the program passes `copy=False` to them.
    #[pyo3(signature = (**options))]
    fn __dlpack__<'py>(
        slf: Bound<'py, Self>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = slf.py();
        let value = Self::value(slf.clone())?;
        let mut array = if value.hasattr("__dlpack__")? {
            value
        } else {
            Self::numpy(slf, None, None)?
        };
        let decides = options.map_or(Ok(false), |it| it.contains("copy"))?;
        if !decides {
            array = array.call_method0("copy")?;
        }
        array
            .getattr(pyo3::intern!(py, "__dlpack__"))?
            .call((), options)
    }

    /// The memory of the processor.
    fn __dlpack_device__(&self) -> (i32, i32) {
        (1, 0)
    }

    fn __repr__(&self) -> String {
        let Self {
            sequence, account, ..
        } = self;
        let topic = &account.topic;
        match self
            .inner
            .with(|sample| (sample.len(), sample.publisher().to_string()))
        {
            Ok((len, publisher)) => {
                format!("<Sample {sequence} of {topic} from {publisher}, {len} bytes>")
            }
            Err(_) => format!("<Sample {sequence} of {topic}, of another process>"),
        }
    }
}
