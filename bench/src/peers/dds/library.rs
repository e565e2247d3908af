//! The functions of `bench_dds.h`.

use std::{
    ffi::{CStr, CString, c_char, c_int, c_void},
    path::Path,
};

use crate::{job::Channel, peers::contract::PeerError};

/// A callback that writes a message.
pub(super) type Write = unsafe extern "C" fn(*mut c_void, *mut u8, usize);
/// A callback that handles a message; a result other than 0 ends the pump.
pub(super) type Read = unsafe extern "C" fn(*mut c_void, *const u8, usize) -> c_int;

/// `bench_topic` of `bench_dds.h`: a channel.
#[repr(C)]
pub(super) struct RawTopic {
    name: *const c_char,
    max_len: usize,
    depth: u32,
    lossless: c_int,
}

impl RawTopic {
    /// The result holds a pointer to `name`, and is valid as long as it.
    pub(super) fn new(channel: &Channel, name: &CString) -> Self {
        Self {
            name: name.as_ptr(),
            max_len: channel.max_len,
            depth: channel.depth.clamp(1, 1 << 16) as u32,
            lossless: c_int::from(channel.lossless),
        }
    }
}

type Publish = unsafe extern "C" fn(*mut c_void, usize, Write, *mut c_void) -> c_int;
type Pump = unsafe extern "C" fn(*mut c_void, u64, Read, *mut c_void) -> c_int;

/// A loaded library, which is never unloaded.
pub(super) struct Library {
    error: unsafe extern "C" fn() -> *const c_char,
    pub(super) open: unsafe extern "C" fn(u32, *const c_char) -> *mut c_void,
    pub(super) publish_on: unsafe extern "C" fn(*mut c_void, *const RawTopic) -> *mut c_void,
    pub(super) matched: unsafe extern "C" fn(*mut c_void) -> c_int,
    pub(super) publish: Publish,
    pub(super) subscribe_to: unsafe extern "C" fn(*mut c_void, *const RawTopic) -> *mut c_void,
    pub(super) pump: Pump,
}

impl Library {
    /// Loads a library for the life of the process.
    pub(super) fn load(path: &Path) -> Result<&'static Self, PeerError> {
        let failed = || PeerError::caused::<libloading::Error>("load its library");
        // SAFETY: this program has compiled the library itself, in a folder beside its binary. On
        // loading, only the initializers of the DDS implementation run.
        let library = unsafe { libloading::Library::new(path) }.map_err(failed())?;
        let library = Box::leak(Box::new(library));
        // SAFETY: the types match `bench_dds.h`, and the library was compiled with it.
        unsafe {
            Ok(Box::leak(Box::new(Self {
                error: *library.get(b"bench_error\0").map_err(failed())?,
                open: *library.get(b"bench_open\0").map_err(failed())?,
                publish_on: *library.get(b"bench_publish_on\0").map_err(failed())?,
                matched: *library.get(b"bench_matched\0").map_err(failed())?,
                publish: *library.get(b"bench_publish\0").map_err(failed())?,
                subscribe_to: *library.get(b"bench_subscribe_to\0").map_err(failed())?,
                pump: *library.get(b"bench_pump\0").map_err(failed())?,
            })))
        }
    }

    /// Returns the pointer, or the library's error if it is null.
    pub(super) fn checked(
        &self,
        pointer: *mut c_void,
        action: &'static str,
    ) -> Result<*mut c_void, PeerError> {
        match pointer.is_null() {
            true => Err(self.failure(action)),
            false => Ok(pointer),
        }
    }

    /// Returns the code, or the library's error if it is negative.
    pub(super) fn done(&self, code: c_int, action: &'static str) -> Result<usize, PeerError> {
        usize::try_from(code).map_err(|_| self.failure(action))
    }

    fn failure(&self, action: &'static str) -> PeerError {
        // SAFETY: `bench_error` returns a text that ends with 0 and is valid until this thread's
        // next call.
        let reason = unsafe { CStr::from_ptr((self.error)()) };
        PeerError::new(action, reason.to_string_lossy())
    }
}
