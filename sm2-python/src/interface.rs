//! The part that publishers, subscribers, servers and clients share.

use std::os::fd::{AsFd, AsRawFd};
use std::time::Duration;

use pyo3::prelude::*;
use sm2_node::WaitError;
use sm2_node::domain::Near;

use crate::errors::{self, raise};
use crate::wait::in_slices;

/// Calls `wait` in slices, until it succeeds or the timeout is over.
///
/// # Errors
///
/// [`errors::WaitError`], and exceptions of signal handlers.
pub(crate) fn wait_for(
    py: Python<'_>,
    timeout: Option<Duration>,
    wait: impl Fn(Duration) -> Result<(), WaitError> + Send + Sync,
) -> PyResult<()> {
    let mut last = None;
    let found = in_slices(py, timeout, |slice| match wait(slice) {
        Ok(()) => Ok(Some(())),
        Err(
            error @ (WaitError::TimedOut { .. }
            | WaitError::ManagerGone { .. }
            | WaitError::NoManager { .. }),
        ) => {
            last = Some(error);
            Ok(None)
        }
        Err(error) => Err(raise(errors::WaitError::new_err::<String>)(error)),
    })?;
    match (found, last) {
        (None, Some(error)) => Err(raise(errors::WaitError::new_err::<String>)(error)),
        _ => Ok(()),
    }
}

/// The descriptor's number.
pub(crate) fn number(handle: &impl AsFd) -> i32 {
    handle.as_fd().as_raw_fd()
}

/// The texts of the reasons why an interface has no links.
pub(crate) fn texts(near: &[Near]) -> Vec<String> {
    near.iter().map(ToString::to_string).collect()
}

/// Implements the methods that publishers, subscribers, servers and clients share, for a class whose field `inner` owns
/// an `Arc` of the handle.
macro_rules! interface_methods {
    ($class:ident, $name:ident, $wait_for:ident, $wait_for_timeout:ident) => {
        #[pyo3::pymethods]
        impl $class {
            #[getter]
            fn $name(&self) -> &str {
                &self.name
            }

            fn $wait_for(
                &self,
                py: pyo3::Python<'_>,
                count: usize,
                timeout: Option<crate::options::Seconds>,
            ) -> pyo3::PyResult<()> {
                let handle = self.inner.get()?;
                crate::interface::wait_for(py, crate::options::time(timeout), |slice| {
                    handle.$wait_for_timeout(count, slice)
                })
            }

            #[getter]
            fn matched(&self) -> pyo3::PyResult<usize> {
                self.inner.with(|handle| handle.matched())
            }

            #[getter]
            fn is_registered(&self) -> pyo3::PyResult<bool> {
                self.inner.with(|handle| handle.is_registered())
            }

            fn why(&self, py: pyo3::Python<'_>) -> pyo3::PyResult<Vec<String>> {
                let handle = self.inner.get()?;
                let near = crate::wait::on_thread(py, move || handle.why())?;
                near.map(|near| crate::interface::texts(&near))
                    .map_err(crate::errors::raise(
                        crate::errors::QueryError::new_err::<String>,
                    ))
            }

            fn fileno(&self) -> pyo3::PyResult<i32> {
                self.inner
                    .with(|handle| crate::interface::number(&**handle))
            }

            fn close(&self) {
                self.inner.close();
            }

            #[getter]
            fn closed(&self) -> bool {
                !self.inner.is_open()
            }
        }
    };
}

pub(crate) use interface_methods;
