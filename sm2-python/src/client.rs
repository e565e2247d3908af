//! Calling a service.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::detached::detached;
use crate::errors::{self, raise};
use crate::handles::Owned;
use crate::input::Input;
use crate::interface::interface_methods;
use crate::options::{Seconds, time};
use crate::wait::{on_thread, until_found};

type Handle = Arc<sm2_node::Client<[u8], [u8]>>;

/// Calls the servers of a service.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Client {
    inner: Owned<Handle>,
    name: String,
    /// Whether a request was sent: until then, sending one may wait for the link to a server.
    is_linked: AtomicBool,
}

impl Client {
    pub(crate) fn new(handle: Handle) -> Self {
        Self {
            name: handle.service().to_string(),
            inner: Owned::new("client", handle),
            is_linked: AtomicBool::new(false),
        }
    }
}

interface_methods!(Client, service, wait_for_servers, wait_for_servers_timeout);

#[pymethods]
impl Client {
    /// Sends a request. The call ends after `timeout`.
    fn send(&self, py: Python<'_>, request: Input, timeout: Option<Seconds>) -> PyResult<Call> {
        let handle = self.inner.get()?;
        let timeout = time(timeout);
        let sent = if self.is_linked.load(Ordering::Relaxed) {
            let bytes = request.bytes();
            detached(py, || send_to(&handle, bytes, timeout))
        } else {
            let (client, bytes) = (Arc::clone(&handle), request.bytes().to_vec());
            on_thread(py, move || send_to(&client, &bytes, timeout))?
        };
        let call = sent.map_err(raise(errors::CallError::new_err::<String>))?;
        self.is_linked.store(true, Ordering::Relaxed);
        Ok(Call {
            inner: Owned::new("call", call),
            client: handle,
        })
    }
}

fn send_to(
    client: &sm2_node::Client<[u8], [u8]>,
    request: &[u8],
    timeout: Option<Duration>,
) -> Result<sm2_node::Call<[u8]>, sm2_node::CallError> {
    match timeout {
        None => client.send(request),
        Some(timeout) => client.send_timeout(request, timeout),
    }
}

/// A pending call. If it is dropped, the call is cancelled.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Call {
    inner: Owned<sm2_node::Call<[u8]>>,
    client: Handle,
}

impl Call {
    fn look(&self, py: Python<'_>) -> PyResult<Option<Py<PyBytes>>> {
        let reply = self.inner.with(|call| call.try_wait())?;
        match reply {
            Ok(None) => Ok(None),
            // A copy, so that the reply is released at once.
            Ok(Some(reply)) => {
                self.inner.close();
                Ok(Some(PyBytes::new(py, &reply).unbind()))
            }
            Err(error) => {
                self.inner.close();
                Err(errors::CallError::new_err(error.to_string()))
            }
        }
    }
}

#[pymethods]
impl Call {
    /// The reply, if it has arrived.
    fn take(&self, py: Python<'_>) -> PyResult<Option<Py<PyBytes>>> {
        self.look(py)
    }

    /// Waits for the reply, for at most `timeout`; the call goes on after it.
    fn wait(&self, py: Python<'_>, timeout: Option<Seconds>) -> PyResult<Option<Py<PyBytes>>> {
        until_found(py, time(timeout), &*self.client, || self.look(py))
    }

    fn cancel(&self) -> PyResult<()> {
        self.inner.with(|call| call.cancel())
    }

    fn fileno(&self) -> i32 {
        crate::interface::number(&*self.client)
    }

    #[getter]
    fn closed(&self) -> bool {
        !self.inner.is_open()
    }
}
