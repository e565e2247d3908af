//! Sending the messages of a topic.

use std::collections::HashMap;
use std::time::Duration;

use pyo3::prelude::*;
use sm2_node::WaitError;
use sm2_node::diagnostics::Fate;

use crate::detached::detached;
use crate::errors::{self, raise};
use crate::handles::{Owned, PublisherHandle};
use crate::input::Input;
use crate::interface::interface_methods;
use crate::loan::{Loan, LoanMemory, Shape};
use crate::options::{Seconds, time};
use crate::wait::in_slices;

type Inner = sm2_node::Publisher<[u8]>;

/// Sends messages to all subscribers of a topic.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Publisher {
    inner: Owned<PublisherHandle>,
    name: String,
}

/// The result of one publication.
#[pyclass(frozen, get_all, eq, module = "sm2")]
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Published {
    /// How many subscribers have the message.
    links: usize,
    /// How many reliable subscribers missed it.
    missed: usize,
    /// How many subscribers accept no message of this length.
    too_long: usize,
}

impl From<sm2_node::Published> for Published {
    fn from(published: sm2_node::Published) -> Self {
        let sm2_node::Published {
            links,
            missed,
            too_long,
        } = published;
        Self {
            links,
            missed,
            too_long,
        }
    }
}

#[pymethods]
impl Published {
    fn __repr__(&self) -> String {
        let Self {
            links,
            missed,
            too_long,
        } = self;
        format!("Published(links={links}, missed={missed}, too_long={too_long})")
    }
}

impl Publisher {
    pub(crate) fn new(handle: PublisherHandle) -> Self {
        Self {
            name: handle.topic().to_string(),
            inner: Owned::new("publisher", handle),
        }
    }

    /// Calls `is_done` with slices of the timeout. Returns whether it was done in time.
    fn wait_until(
        &self,
        py: Python<'_>,
        timeout: Option<Seconds>,
        is_done: impl Fn(&Inner, Duration) -> Result<bool, WaitError> + Send + Sync,
    ) -> PyResult<bool> {
        let handle = self.inner.get()?;
        let found = in_slices(py, time(timeout), |slice| {
            let done = is_done(&handle, slice);
            let done = done.map_err(raise(errors::WaitError::new_err::<String>))?;
            Ok(done.then_some(()))
        });
        Ok(found?.is_some())
    }
}

interface_methods!(
    Publisher,
    topic,
    wait_for_subscribers,
    wait_for_subscribers_timeout
);

#[pymethods]
impl Publisher {
    fn publish(
        &self,
        py: Python<'_>,
        message: Input,
        timeout: Option<Seconds>,
    ) -> PyResult<Published> {
        let handle = self.inner.get()?;
        let bytes = message.bytes();
        let published = detached(py, || match time(timeout) {
            None => handle.publish(bytes),
            Some(timeout) => handle.publish_timeout(bytes, timeout),
        });
        published
            .map(Published::from)
            .map_err(raise(errors::PublishError::new_err::<String>))
    }

    fn try_publish(&self, py: Python<'_>, message: Input) -> PyResult<Option<Published>> {
        let handle = self.inner.get()?;
        let bytes = message.bytes();
        let published = detached(py, || handle.try_publish(bytes));
        let published = published.map_err(raise(errors::PublishError::new_err::<String>))?;
        Ok(published.map(Published::from))
    }

    /// A loan of the memory of an array of this shape and dtype, whose elements have `element_len` bytes.
    fn loan<'py>(
        &self,
        py: Python<'py>,
        shape: Shape,
        dtype: Bound<'py, PyAny>,
        element_len: usize,
    ) -> PyResult<Loan> {
        let len = shape.len_bytes(element_len)?;
        let handle = self.inner.get()?;
        // The first use of a slot takes long.
        let memory = detached(py, || LoanMemory::new(handle, len));
        let memory = memory.map_err(raise(errors::PublishError::new_err::<String>))?;
        Loan::new(py, memory, &shape, dtype)
    }

    fn wait_for_room(&self, py: Python<'_>, timeout: Option<Seconds>) -> PyResult<bool> {
        self.wait_until(py, timeout, sm2_node::Publisher::wait_for_room_timeout)
    }

    fn flush(&self, py: Python<'_>, timeout: Option<Seconds>) -> PyResult<bool> {
        self.wait_until(py, timeout, sm2_node::Publisher::flush_timeout)
    }

    #[getter]
    fn counters(&self) -> PyResult<HashMap<&'static str, u64>> {
        let counters = self.inner.with(|handle| handle.counters())?;
        let fates = Fate::ALL.map(|fate| (fate.as_str(), counters.of(fate)));
        let others = [
            ("offered", counters.offered),
            ("in_flight", counters.in_flight),
        ];
        Ok(others.into_iter().chain(fates).collect())
    }

    #[getter]
    fn unheard(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.unheard())
    }

    #[getter]
    fn missed_deadlines(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.missed_deadlines())
    }

    #[getter]
    fn lost_liveliness(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.lost_liveliness())
    }

    #[getter]
    fn pool_bytes(&self) -> PyResult<u64> {
        self.inner.with(|handle| handle.pool_bytes())
    }

    fn assert_liveliness(&self) -> PyResult<()> {
        self.inner.with(|handle| handle.assert_liveliness())
    }
}
