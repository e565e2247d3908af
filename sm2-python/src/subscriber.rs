//! Receiving the messages of a topic.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use pyo3::prelude::*;
use sm2_node::RecvError;

use crate::detached::detached;
use crate::errors;
use crate::handles::Owned;
use crate::interface::interface_methods;
use crate::options::{Seconds, time};
use crate::sample::{Account, Sample};
use crate::wait::until_found;

/// How long `recv` waits in `sm2-node` first, which is faster than to poll a descriptor. A signal does not end this
/// part, so Ctrl-C may take as long.
const QUICK: Duration = Duration::from_millis(100);

type Handle = Arc<sm2_node::Subscriber<[u8]>>;

/// Receives the messages of a topic.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Subscriber {
    inner: Owned<Handle>,
    name: String,
    account: Arc<Account>,
    decode: Py<PyAny>,
}

impl Subscriber {
    pub(crate) fn new(handle: Handle, decode: Py<PyAny>) -> Self {
        let topic = handle.topic().to_string();
        Self {
            inner: Owned::new("subscriber", handle),
            name: topic.clone(),
            account: Arc::new(Account {
                topic,
                samples: AtomicUsize::new(0),
                views: AtomicUsize::new(0),
            }),
            decode,
        }
    }

    /// A sample of this subscriber, or the exception for an error.
    fn sample(
        &self,
        py: Python<'_>,
        received: Result<Option<sm2_node::Sample<[u8]>>, RecvError>,
    ) -> PyResult<Option<Sample>> {
        match received {
            Ok(sample) => {
                Ok(sample.map(|it| Sample::new(it, &self.account, self.decode.clone_ref(py))))
            }
            Err(error @ RecvError::TooManyBorrowed { .. }) => Err(self.too_many(&error)),
            Err(error) => Err(errors::RecvError::new_err(error.to_string())),
        }
    }

    /// The error at the borrow limit, with the number of views: a forgotten array is the usual reason.
    fn too_many(&self, error: &RecvError) -> PyErr {
        let Account {
            topic,
            samples,
            views,
        } = &*self.account;
        let (samples, views) = (
            samples.load(Ordering::Relaxed),
            views.load(Ordering::Relaxed),
        );
        errors::BorrowLimitError::new_err(format!(
            "{error} (topic {topic}: {samples} samples are held; {views} views, such as numpy arrays, refer to their \
             memory)"
        ))
    }
}

interface_methods!(
    Subscriber,
    topic,
    wait_for_publishers,
    wait_for_publishers_timeout
);

#[pymethods]
impl Subscriber {
    fn take(&self, py: Python<'_>) -> PyResult<Option<Sample>> {
        let handle = self.inner.get()?;
        self.sample(py, handle.try_recv())
    }

    fn recv(&self, py: Python<'_>, timeout: Option<Seconds>) -> PyResult<Option<Sample>> {
        let handle = self.inner.get()?;
        let timeout = time(timeout);
        let quick = timeout.map_or(QUICK, |it| it.min(QUICK));
        let received = detached(py, || handle.recv_timeout(quick));
        if let Some(sample) = self.sample(py, received)? {
            return Ok(Some(sample));
        }
        py.check_signals()?;
        let timeout = timeout.map(|it| it.saturating_sub(quick));
        until_found(py, timeout, &*handle, || {
            // Another thread may have closed this object, and then expects the wait to end.
            self.inner.with(|_| ())?;
            self.sample(py, handle.try_recv())
        })
    }

    #[getter]
    fn lost(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.lost())
    }

    #[getter]
    fn missed_deadlines(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.missed_deadlines())
    }

    #[getter]
    fn lost_liveliness(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.lost_liveliness())
    }

    /// The samples that the program holds, and the views of their memory.
    #[getter]
    fn held(&self) -> (usize, usize) {
        let Account { samples, views, .. } = &*self.account;
        (
            samples.load(Ordering::Relaxed),
            views.load(Ordering::Relaxed),
        )
    }
}
