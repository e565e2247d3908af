//! Answering the calls of a service.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::detached::detached;
use crate::errors::{self, raise};
use crate::handles::Owned;
use crate::input::Input;
use crate::interface::interface_methods;
use crate::options::{Seconds, time};
use crate::wait::until_found;

type Handle = Arc<sm2_node::Server<[u8], [u8]>>;

/// Receives the requests of a service.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Server {
    inner: Owned<Handle>,
    name: String,
}

impl Server {
    pub(crate) fn new(handle: Handle) -> Self {
        Self {
            name: handle.service().to_string(),
            inner: Owned::new("server", handle),
        }
    }
}

interface_methods!(Server, service, wait_for_clients, wait_for_clients_timeout);

#[pymethods]
impl Server {
    fn take(&self, py: Python<'_>) -> PyResult<Option<Request>> {
        let handle = self.inner.get()?;
        take_of(py, &handle)
    }

    fn recv(&self, py: Python<'_>, timeout: Option<Seconds>) -> PyResult<Option<Request>> {
        let handle = self.inner.get()?;
        until_found(py, time(timeout), &*handle, || {
            // Another thread may have closed this object, and then expects the wait to end.
            self.inner.with(|_| ())?;
            take_of(py, &handle)
        })
    }
}

fn take_of(py: Python<'_>, handle: &Handle) -> PyResult<Option<Request>> {
    let request = handle
        .try_recv()
        .map_err(raise(errors::RecvError::new_err::<String>))?;
    Ok(request.map(|request| Request {
        data: PyBytes::new(py, &request).unbind(),
        client: request.client().to_string(),
        deadline_ns: request.deadline().map(|it| it.0),
        inner: Owned::new("request", request),
    }))
}

/// A request. If it is dropped without a reply, the call fails.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Request {
    inner: Owned<sm2_node::Request<[u8], [u8]>>,
    /// A copy: a reply releases the memory of its request, which a view could still refer to.
    #[pyo3(get)]
    data: Py<PyBytes>,
    #[pyo3(get)]
    client: String,
    #[pyo3(get)]
    deadline_ns: Option<u64>,
}

#[pymethods]
impl Request {
    fn reply(&self, py: Python<'_>, message: Input) -> PyResult<()> {
        let request = self.inner.take()?;
        let bytes = message.bytes();
        detached(py, || request.reply(bytes)).map_err(raise(errors::ReplyError::new_err::<String>))
    }

    fn fail(&self, reason: &str) -> PyResult<()> {
        let request = self.inner.take()?;
        request
            .fail(reason)
            .map_err(raise(errors::ReplyError::new_err::<String>))
    }

    #[getter]
    fn is_cancelled(&self) -> PyResult<bool> {
        self.inner.with(|request| request.is_cancelled())
    }

    #[getter]
    fn answered(&self) -> bool {
        !self.inner.is_open()
    }
}
