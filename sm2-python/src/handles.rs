//! Handles of SM2 as Python objects own them: they can be closed, and a forked child cannot use them.

use std::mem;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pyo3::PyResult;
use sm2_io::Maker;

use crate::errors::{ClosedError, ForkError};

/// The handle that a publisher and its loans share.
pub(crate) type PublisherHandle = Arc<sm2_node::Publisher<[u8]>>;

/// A handle of SM2 that belongs to a Python object.
///
/// A child that was made by `fork(2)` has a copy of the handle, but its descriptors and rings are those of the parent:
/// to release a message there would release it for the parent. The child therefore gets a [`ForkError`] for each use,
/// and never drops its copy.
pub(crate) struct Owned<T> {
    /// Locked for short moments, by threads that have the GIL.
    value: Mutex<Option<T>>,
    maker: Maker,
    /// The noun for error texts.
    what: &'static str,
}

impl<T> Owned<T> {
    pub(crate) fn new(what: &'static str, value: T) -> Self {
        Self {
            value: Mutex::new(Some(value)),
            maker: Maker::this_process(),
            what,
        }
    }

    /// Calls `change` with the handle.
    ///
    /// # Errors
    ///
    /// [`ClosedError`], [`ForkError`].
    pub(crate) fn with<R>(&self, change: impl FnOnce(&mut T) -> R) -> PyResult<R> {
        self.check_process()?;
        match self.lock().as_mut() {
            Some(value) => Ok(change(value)),
            None => Err(self.closed()),
        }
    }

    /// Takes the handle out. The object is closed from then on.
    ///
    /// # Errors
    ///
    /// As [`with`](Self::with).
    pub(crate) fn take(&self) -> PyResult<T> {
        self.check_process()?;
        self.lock().take().ok_or_else(|| self.closed())
    }

    /// Drops the handle, if it is not closed yet. A forked child only forgets its copy.
    pub(crate) fn close(&self) {
        let value = self.lock().take();
        if self.is_inherited() {
            mem::forget(value);
        }
    }

    /// Whether the handle is there. Also true in a forked child.
    pub(crate) fn is_open(&self) -> bool {
        self.lock().is_some()
    }

    fn check_process(&self) -> PyResult<()> {
        if !self.is_inherited() {
            return Ok(());
        }
        let what = self.what;
        Err(ForkError::new_err(format!(
            "this {what} belongs to the process that forked this one: connect a node of your own, or start \
             the child with multiprocessing's method 'spawn'"
        )))
    }

    fn is_inherited(&self) -> bool {
        self.maker.is_parent()
    }

    fn closed(&self) -> pyo3::PyErr {
        ClosedError::new_err(format!("this {} is closed", self.what))
    }

    fn lock(&self) -> MutexGuard<'_, Option<T>> {
        self.value.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Clone> Owned<T> {
    /// A copy of the handle, which stays valid if another thread closes the object meanwhile.
    ///
    /// # Errors
    ///
    /// As [`with`](Self::with).
    pub(crate) fn get(&self) -> PyResult<T> {
        self.with(|value| value.clone())
    }
}

impl<T> Drop for Owned<T> {
    fn drop(&mut self) {
        self.close();
    }
}
