//! Messages that Python writes in place, in the memory that their receivers read.
//!
//! The array that Python writes to refers to memory that SM2 gives to the next message as soon as all receivers have
//! released this one. So at the end of the block, [`Loan`] makes sure that nothing can reach the memory any more: only
//! a variable of the program may refer to the array, and the array is made empty. Then the message is published. README
//! says why the array does not stay readable.

use std::sync::{Arc, Mutex, PoisonError};

use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBytes, PyDict, PyInt, PyTuple};
use self_cell::self_cell;
use sm2_node::StoreError;

use crate::array;
use crate::detached::detached;
use crate::errors::{self, LoanError, raise};
use crate::handles::{Owned, PublisherHandle};
use crate::memory::{Memory, references};

/// How many frames are searched for the variable that refers to the array.
const FRAMES_MAX: usize = 64;

/// The flag of code whose variables are not in a dictionary: that of functions.
const CO_OPTIMIZED: u32 = 1;

/// Functions that are imported once.
static NDARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
static GETFRAME: PyOnceLock<Py<PyAny>> = PyOnceLock::new();

/// `None` once it is published.
type Lent<'p> = Option<sm2_node::Loan<'p, [u8]>>;

self_cell!(
    /// A loan and the publisher that it belongs to.
    struct Loaned {
        owner: PublisherHandle,
        #[covariant]
        dependent: Lent,
    }
);

/// The memory of a loan, the base of its array.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct LoanMemory {
    inner: Owned<Loaned>,
}

impl LoanMemory {
    pub(crate) fn new(publisher: PublisherHandle, len: usize) -> Result<Self, StoreError> {
        let loaned = Loaned::try_new(publisher, |it| it.loan_slice(len).map(Some))?;
        Ok(Self {
            inner: Owned::new("loan", loaned),
        })
    }

    /// The memory, which only this process can write to.
    pub(crate) fn memory(&self) -> PyResult<Memory> {
        self.inner.with(|loaned| {
            loaned.with_dependent_mut(|_, lent| match lent {
                Some(loan) => (loan.as_mut_ptr(), loan.len()),
                None => (std::ptr::NonNull::dangling().as_ptr(), 0),
            })
        })
    }
}

/// The lengths of the dimensions of an array: a number, or a sequence of numbers.
pub(crate) enum Shape {
    Length([isize; 1]),
    Lengths(Vec<isize>),
}

impl Shape {
    pub(crate) fn lengths(&self) -> &[isize] {
        match self {
            Self::Length(length) => length,
            Self::Lengths(lengths) => lengths,
        }
    }

    /// The number of bytes of an array whose elements have `element_len` bytes.
    ///
    /// # Errors
    ///
    /// `ValueError` for a negative length, and for a number of bytes that no array can have.
    pub(crate) fn len_bytes(&self, element_len: usize) -> PyResult<usize> {
        let lengths = self.lengths();
        let mut len = Some(element_len);
        for length in lengths {
            let length = usize::try_from(*length).map_err(|_| {
                PyValueError::new_err(format!("the shape {lengths:?} has a negative length"))
            })?;
            len = len.and_then(|it| it.checked_mul(length));
        }
        len.filter(|it| isize::try_from(*it).is_ok())
            .ok_or_else(|| PyValueError::new_err(format!("the shape {lengths:?} is too large")))
    }
}

impl<'py> FromPyObject<'_, 'py> for Shape {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if object.is_instance_of::<PyInt>() {
            return Ok(Self::Length([object.extract()?]));
        }
        let lengths = object.try_iter()?.map(|length| length?.extract());
        Ok(Self::Lengths(lengths.collect::<PyResult<_>>()?))
    }
}

/// A message that is written in a `with` block.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Loan {
    memory: Py<LoanMemory>,
    /// `None` after the block.
    array: Mutex<Option<Py<PyAny>>>,
}

impl Loan {
    pub(crate) fn new<'py>(
        py: Python<'py>,
        memory: LoanMemory,
        shape: &Shape,
        dtype: Bound<'py, PyAny>,
    ) -> PyResult<Self> {
        let memory = Bound::new(py, memory)?;
        let of_bytes = match array::is_bytes(&dtype) {
            true => LoanMemory::array(&memory, shape.lengths())?,
            false => None,
        };
        let array = match of_bytes {
            Some(array) => array,
            None => {
                let make_array = NDARRAY.import(py, "numpy", "ndarray")?;
                make_array.call1((PyTuple::new(py, shape.lengths())?, dtype, &memory))?
            }
        };
        Ok(Self {
            memory: memory.unbind(),
            array: Mutex::new(Some(array.unbind())),
        })
    }

    fn take_array<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let array = self
            .array
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        match array {
            Some(array) => Ok(array.into_bound(py)),
            None => Err(LoanError::new_err(
                "this loan has ended: request another one",
            )),
        }
    }

    /// Makes sure that after this call nothing refers to the memory.
    fn detach_array(&self, py: Python<'_>, array: Bound<'_, PyAny>) -> PyResult<()> {
        // One reference is ours.
        let others = references(&array) - 1;
        // Two are ours and that of the array.
        let bases = references(self.memory.bind(py)) - 2;
        if others > 1 || bases > 0 || (others == 1 && !is_variable(&array)?) {
            return Err(LoanError::new_err(
                "the loan was not published: besides the variable of its block, something still refers to the array \
                 or its memory (a slice, a view, a tensor, a list, or an attribute), and could change the message \
                 later; drop it before the block ends, or give it a copy",
            ));
        }
        // How numpy restores a pickled array. It drops the reference to the memory, so that the variable
        // of the program cannot reach it any more.
        let nothing = PyBytes::new(py, b"");
        let state = (
            1,
            (0,),
            array.getattr(intern!(py, "dtype"))?,
            false,
            nothing,
        );
        array.call_method1(intern!(py, "__setstate__"), (state,))?;
        array.call_method1(intern!(py, "setflags"), (false,))?;
        Ok(())
    }
}

#[pymethods]
impl Loan {
    fn __enter__(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let array = self.array.lock().unwrap_or_else(PoisonError::into_inner);
        match &*array {
            Some(array) => Ok(array.clone_ref(py)),
            None => Err(LoanError::new_err(
                "this loan has ended: request another one",
            )),
        }
    }

    /// Publishes the message, unless the block has raised an exception.
    fn __exit__(
        &self,
        py: Python<'_>,
        exception: &Bound<'_, PyAny>,
        _value: &Bound<'_, PyAny>,
        _traceback: &Bound<'_, PyAny>,
    ) -> PyResult<bool> {
        let array = self.take_array(py)?;
        if !exception.is_none() {
            return Ok(false);
        }
        self.detach_array(py, array)?;
        let mut loaned = self.memory.get().inner.take()?;
        let published = detached(py, || {
            let published =
                loaned.with_dependent_mut(|_, lent| lent.take().map(sm2_node::Loan::publish));
            // Drops this handle of the publisher without the GIL, because that may wait for the node's thread.
            drop(loaned);
            published
        });
        match published {
            Some(Err(error)) => Err(raise(errors::PublishError::new_err::<String>)(error)),
            Some(Ok(_)) | None => Ok(false),
        }
    }
}

/// Whether a variable of the running Python functions refers to the array.
///
/// Another reference could be that of a C extension that has kept the address of the memory.
fn is_variable(array: &Bound<'_, PyAny>) -> PyResult<bool> {
    let py = array.py();
    let mut frame = GETFRAME.import(py, "sys", "_getframe")?.call0()?;
    for _ in 0..FRAMES_MAX {
        if frame.is_none() {
            break;
        }
        if has_local(&frame, array)? || has_value(&frame.getattr(intern!(py, "f_globals"))?, array)?
        {
            return Ok(true);
        }
        frame = frame.getattr(intern!(py, "f_back"))?;
    }
    Ok(false)
}

/// Whether a local variable of this frame refers to the array.
fn has_local(frame: &Bound<'_, PyAny>, array: &Bound<'_, PyAny>) -> PyResult<bool> {
    let py = frame.py();
    let locals = frame.getattr(intern!(py, "f_locals"))?;
    let found = has_value(&locals, array)?;
    // Before Python 3.13, the frame of a function keeps this copy of its variables, which would keep samples of the
    // program alive. If only the frame and this function refer to it, the program does not use it.
    let code = frame.getattr(intern!(py, "f_code"))?;
    let flags: u32 = code.getattr(intern!(py, "co_flags"))?.extract()?;
    if let Ok(copy) = locals.cast_exact::<PyDict>()
        && flags & CO_OPTIMIZED != 0
        && references(copy) == 2
    {
        copy.clear();
    }
    Ok(found)
}

fn has_value(variables: &Bound<'_, PyAny>, array: &Bound<'_, PyAny>) -> PyResult<bool> {
    if let Ok(variables) = variables.cast_exact::<PyDict>() {
        return Ok(variables.iter().any(|(_, value)| value.is(array)));
    }
    for value in variables.call_method0("values")?.try_iter()? {
        if value?.is(array) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Handles of publishers can be shared by threads, and so can their loans.
const _: () = {
    const fn is_send<T: Send>() {}
    is_send::<Loaned>();
    is_send::<Arc<sm2_node::Publisher<[u8]>>>();
};
