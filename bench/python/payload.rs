//! The payload of messages for the processes in Python, which check it by the same code as all others.
//!
//! It is an extension module: a message costs one call, as in a program that hands an array to OpenCV. `ctypes` needs
//! the address of an array, and numpy puts it into a dictionary: both would take longer than the middleware. The calls
//! keep the GIL, because no other thread of the processes has work meanwhile.

#[path = "../src/clock.rs"]
#[allow(dead_code, reason = "the processes in Python sleep by themselves")]
mod clock;
#[path = "../src/payload.rs"]
#[allow(dead_code, reason = "the processes in Python write and check messages")]
mod payload;

use std::{ffi::c_int, slice};

use clock::now_ns;
use payload::{HEADER_BYTES, Header, check, fill, peek, stamp};
use pyo3::{exceptions::PyValueError, ffi, prelude::*, types::PyTuple};

/// The module that `role.py` loads.
#[pymodule]
mod libpayload {
    #[pymodule_export]
    use super::{read, write, write_stamped};
}

/// Writes a message. `handed` sets the time after the writing in its header.
#[pyfunction]
fn write(
    mut message: Place<true>,
    number: u64,
    flags: u64,
    start_ns: u64,
    handed: bool,
) -> PyResult<()> {
    let message = message.bytes_mut()?;
    let header = Header {
        number,
        flags,
        start_ns,
        handed_ns: 0,
    };
    fill(header, message);
    if handed {
        stamp(message, now_ns());
    }
    Ok(())
}

/// Writes a message with the times before and after the writing, if it is stamped.
#[pyfunction]
fn write_stamped(message: Place<true>, number: u64, flags: u64, stamped: bool) -> PyResult<()> {
    let start_ns = if stamped { now_ns() } else { 0 };
    write(message, number, flags, start_ns, stamped)
}

/// The number, the flags and the two times of a message, the time of the call if it is stamped, and whether `full` and
/// one of its bytes is not what was written.
#[pyfunction]
fn read(message: Place<false>, full: bool) -> PyResult<(u64, u64, u64, u64, u64, bool)> {
    let message = message.bytes()?;
    let Header {
        number,
        flags,
        start_ns,
        handed_ns,
    } = peek(message).unwrap_or_default();
    let in_hand_ns = match (start_ns, handed_ns) {
        (0, 0) => 0,
        _ => now_ns(),
    };
    let torn = full && check(message).is_err();
    Ok((number, flags, start_ns, handed_ns, in_hand_ns, torn))
}

/// The place of a message: an object with the buffer protocol, or a pair of an address and a length.
enum Place<const WRITABLE: bool> {
    /// In a box, because exporters may refer to the structure itself.
    View(Box<ffi::Py_buffer>),
    Range(usize, usize),
}

impl<const WRITABLE: bool> Place<WRITABLE> {
    /// The start and the length, which is 32 bytes or more.
    fn range(&self) -> PyResult<(*mut u8, usize)> {
        let (start, len) = match self {
            Self::View(view) => (view.buf.cast(), usize::try_from(view.len)?),
            Self::Range(address, len) => (std::ptr::with_exposed_provenance_mut(*address), *len),
        };
        match len >= HEADER_BYTES {
            true => Ok((start, len)),
            false => Err(PyValueError::new_err("a message has 32 bytes or more")),
        }
    }

    fn bytes(&self) -> PyResult<&[u8]> {
        let (start, len) = self.range()?;
        // SAFETY: the exporter promised these bytes until the view is released. `peers.py` takes addresses from the
        // middlewares alone, and keeps the message meanwhile.
        Ok(unsafe { slice::from_raw_parts(start, len) })
    }
}

impl Place<true> {
    fn bytes_mut(&mut self) -> PyResult<&mut [u8]> {
        let (start, len) = self.range()?;
        // SAFETY: as in `bytes`. The view is writable, and the processes have one thread that writes.
        Ok(unsafe { slice::from_raw_parts_mut(start, len) })
    }
}

impl<'py, const WRITABLE: bool> FromPyObject<'_, 'py> for Place<WRITABLE> {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if object.is_exact_instance_of::<PyTuple>() {
            let (address, len) = object.extract()?;
            return Ok(Self::Range(address, len));
        }
        let flags: c_int = if WRITABLE {
            ffi::PyBUF_WRITABLE
        } else {
            ffi::PyBUF_SIMPLE
        };
        let mut view = Box::new(ffi::Py_buffer::new());
        // SAFETY: `object` is alive and this thread has the GIL. The view keeps its address until it is released.
        match unsafe { ffi::PyObject_GetBuffer(object.as_ptr(), &raw mut *view, flags) } {
            0 => Ok(Self::View(view)),
            _ => Err(PyErr::fetch(object.py())),
        }
    }
}

impl<const WRITABLE: bool> Drop for Place<WRITABLE> {
    fn drop(&mut self) {
        if let Self::View(view) = self {
            // SAFETY: `extract` filled the view. A place is an argument of a function, which drops it with the GIL.
            unsafe { ffi::PyBuffer_Release(&raw mut **view) };
        }
    }
}
