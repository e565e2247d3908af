//! Arrays of bytes over memory of SM2, made by numpy's interface for C.
//!
//! `numpy.frombuffer` and `numpy.ndarray` make the same arrays, but a call of them needs a few hundred lines of the
//! caches. A large message has displaced these lines, and each reception would fetch them again: between messages of
//! 10 MB, `Sample.numpy` takes 4 us with this module, and 9 us with `numpy.frombuffer`. The functions of Python remain
//! for a numpy whose interface this module does not know.

use std::ffi::{c_int, c_uint, c_void};
use std::ptr::null_mut;

use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyCapsule;

use crate::memory::Memory;

/// The most dimensions of an array that is made here. numpy has at least 32.
const DIMENSIONS_MAX: usize = 8;

/// `NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_ALIGNED`, and `NPY_ARRAY_WRITEABLE`.
const READABLE: c_int = 0x0101;
const WRITABLE: c_int = 0x0400;

/// Positions in the table of functions, which are the same in all versions with one of these [`VERSIONS`].
const GET_VERSION: usize = 0;
const NEW_FROM_DESCR: usize = 94;
const SET_BASE_OBJECT: usize = 282;

/// The versions of the binary interface of numpy 1 and 2.
const VERSIONS: [c_uint; 2] = [0x0100_0009, 0x0200_0000];

type GetVersion = unsafe extern "C" fn() -> c_uint;
type NewFromDescr = unsafe extern "C" fn(
    class: *mut ffi::PyTypeObject,
    dtype: *mut ffi::PyObject,
    dimensions: c_int,
    lengths: *const isize,
    strides: *const isize,
    data: *mut c_void,
    flags: c_int,
    object: *mut ffi::PyObject,
) -> *mut ffi::PyObject;
type SetBaseObject =
    unsafe extern "C" fn(array: *mut ffi::PyObject, base: *mut ffi::PyObject) -> c_int;

/// The parts of numpy's interface that are used here.
struct Numpy {
    class: Py<PyAny>,
    /// The dtype `u1`.
    dtype: Py<PyAny>,
    new_from_descr: NewFromDescr,
    set_base_object: SetBaseObject,
}

/// `None` if this numpy has another interface.
static NUMPY: PyOnceLock<Option<Numpy>> = PyOnceLock::new();

impl Numpy {
    fn load(py: Python<'_>) -> Option<Self> {
        let module = py.import("numpy._core._multiarray_umath");
        let module = module.or_else(|_| py.import("numpy.core._multiarray_umath"));
        let table = module.ok()?.getattr("_ARRAY_API").ok()?;
        let table = table.cast_into::<PyCapsule>().ok()?;
        let table = table.pointer_checked(None).ok()?.cast::<*const c_void>();
        // SAFETY: numpy documents this capsule as the table of its functions, which lives as long as the process. The
        // entry 0 returns the version of the table, in all versions.
        let function = |index| unsafe { table.add(index).read() };
        // SAFETY: as above.
        let version =
            unsafe { std::mem::transmute::<*const c_void, GetVersion>(function(GET_VERSION))() };
        if !VERSIONS.contains(&version) {
            return None;
        }
        let numpy = py.import("numpy").ok()?;
        // SAFETY: these are the functions of these types in the tables of this version.
        let (new_from_descr, set_base_object) = unsafe {
            (
                std::mem::transmute::<*const c_void, NewFromDescr>(function(NEW_FROM_DESCR)),
                std::mem::transmute::<*const c_void, SetBaseObject>(function(SET_BASE_OBJECT)),
            )
        };
        Some(Self {
            class: numpy.getattr("ndarray").ok()?.unbind(),
            dtype: numpy.call_method1("dtype", ("u1",)).ok()?.unbind(),
            new_from_descr,
            set_base_object,
        })
    }

    fn get(py: Python<'_>) -> Option<&Self> {
        NUMPY.get_or_init(py, || Self::load(py)).as_ref()
    }
}

/// Whether this is the dtype of the arrays that are made here.
pub(crate) fn is_bytes(dtype: &Bound<'_, PyAny>) -> bool {
    Numpy::get(dtype.py()).is_some_and(|it| it.dtype.is(dtype))
}

/// An array of bytes with these lengths, which refers to `base`. `None` if numpy has another interface, or not as many
/// dimensions.
///
/// # Safety
///
/// The memory has at least as many bytes as the array. It is valid for reads, and for writes if the array is
/// writable, as long as `base` exists.
pub(crate) unsafe fn of_bytes<'py>(
    base: Bound<'py, PyAny>,
    (data, _): Memory,
    lengths: &[isize],
    is_writable: bool,
) -> Option<PyResult<Bound<'py, PyAny>>> {
    let py = base.py();
    let numpy = Numpy::get(py)?;
    if lengths.len() > DIMENSIONS_MAX {
        return None;
    }
    let flags = READABLE | if is_writable { WRITABLE } else { 0 };
    // SAFETY: this thread has the GIL. `NewFromDescr` takes one reference to the dtype and copies the few lengths.
    // Bytes have no alignment, and without strides they are contiguous. The array does not own `data`: it refers to
    // `base`, which keeps the memory, as the caller promises. `SetBaseObject` takes a reference to `base`, also if it
    // fails.
    let array = unsafe {
        let array = (numpy.new_from_descr)(
            numpy.class.as_ptr().cast(),
            numpy.dtype.clone_ref(py).into_ptr(),
            lengths.len() as c_int,
            lengths.as_ptr(),
            std::ptr::null(),
            data.cast(),
            flags,
            null_mut(),
        );
        let array = match Bound::from_owned_ptr_or_err(py, array) {
            Ok(array) => array,
            Err(error) => return Some(Err(error)),
        };
        match (numpy.set_base_object)(array.as_ptr(), base.into_ptr()) {
            0 => array,
            _ => return Some(Err(PyErr::fetch(py))),
        }
    };
    Some(Ok(array))
}
