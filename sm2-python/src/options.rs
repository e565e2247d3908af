//! The options of nodes and interfaces, which Python passes as dictionaries.

use std::path::PathBuf;
use std::time::Duration;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sm2_node::{ClientBuilder, NodeBuilder, PublisherBuilder, ServerBuilder, SubscriberBuilder};

/// A time in seconds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seconds(pub(crate) Duration);

impl<'py> FromPyObject<'_, 'py> for Seconds {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let seconds: f64 = object.extract()?;
        // Infinity, and times above 584 years, stand for a time that never passes.
        match Duration::try_from_secs_f64(seconds) {
            Ok(time) => Ok(Self(time)),
            Err(_) if seconds > 0.0 => Ok(Self(Duration::MAX)),
            Err(error) => Err(PyValueError::new_err(format!("{seconds} s: {error}"))),
        }
    }
}

/// `timeout` in seconds; `None` waits without a limit.
pub(crate) fn time(timeout: Option<Seconds>) -> Option<Duration> {
    timeout.map(|Seconds(time)| time)
}

/// Applies those of the options that Python has set (`None` keeps the default of `sm2-node`).
macro_rules! apply {
    ($builder:ident, $options:ident, [$($plain:ident),*], [$($seconds:ident),*]) => {{
        $(if let Some(value) = $options.$plain {
            $builder = $builder.$plain(value);
        })*
        $(if let Some(Seconds(value)) = $options.$seconds {
            $builder = $builder.$seconds(value);
        })*
        $builder
    }};
}

/// The options of `Node`.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct NodeOptions {
    domain: Option<String>,
    socket: Option<PathBuf>,
    manager_timeout: Option<Seconds>,
    /// Applied by the caller, in slices.
    pub(crate) startup_timeout: Option<Seconds>,
    ring_lane: Option<bool>,
    background: Option<bool>,
    standby_manager: bool,
}

impl NodeOptions {
    pub(crate) fn apply(&self, mut builder: NodeBuilder) -> NodeBuilder {
        if let Some(domain) = &self.domain {
            builder = builder.domain(domain);
        }
        if let Some(socket) = &self.socket {
            builder = builder.socket(socket);
        }
        if self.standby_manager {
            builder = builder.embed_manager(sm2_manager::Options::default());
        }
        apply!(builder, self, [ring_lane, background], [manager_timeout])
    }
}

/// The options of a publisher.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct PublisherOptions {
    #[pyo3(item("keep_last"))]
    depth: Option<u16>,
    reliable: Option<bool>,
    latched: Option<u16>,
    publish_timeout: Option<Seconds>,
    wait_share_percent: Option<u8>,
    deadline: Option<Seconds>,
    liveliness: Option<Seconds>,
    lifespan: Option<Seconds>,
    sealed: Option<bool>,
    inline_max: Option<usize>,
    pool_limit: Option<u64>,
    keep_idle: Option<Seconds>,
    max_len: Option<usize>,
    slots: Option<u32>,
    prefault: Option<bool>,
    mlock: Option<bool>,
}

impl PublisherOptions {
    pub(crate) fn apply(self, mut builder: PublisherBuilder<[u8]>) -> PublisherBuilder<[u8]> {
        apply!(
            builder,
            self,
            [
                depth,
                reliable,
                latched,
                wait_share_percent,
                sealed,
                inline_max,
                pool_limit,
                max_len,
                slots,
                prefault,
                mlock
            ],
            [publish_timeout, deadline, liveliness, lifespan, keep_idle]
        )
    }
}

/// The options of a subscriber.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct SubscriberOptions {
    #[pyo3(item("keep_last"))]
    depth: Option<u16>,
    reliable: Option<bool>,
    max_borrowed: Option<u16>,
    deadline: Option<Seconds>,
    liveliness: Option<Seconds>,
    sealed: Option<bool>,
    max_len: Option<u64>,
}

impl SubscriberOptions {
    pub(crate) fn apply(self, mut builder: SubscriberBuilder<[u8]>) -> SubscriberBuilder<[u8]> {
        apply!(
            builder,
            self,
            [depth, reliable, max_borrowed, sealed, max_len],
            [deadline, liveliness]
        )
    }
}

/// The options of a server.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ServerOptions {
    depth: Option<u16>,
    max_borrowed: Option<u16>,
    sealed: Option<bool>,
    inline_max: Option<usize>,
    max_len: Option<u64>,
}

impl ServerOptions {
    pub(crate) fn apply(self, mut builder: ServerBuilder<[u8], [u8]>) -> ServerBuilder<[u8], [u8]> {
        apply!(
            builder,
            self,
            [depth, max_borrowed, sealed, inline_max, max_len],
            []
        )
    }
}

/// The options of a client.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ClientOptions {
    max_borrowed: Option<u16>,
    sealed: Option<bool>,
    inline_max: Option<usize>,
    max_len: Option<u64>,
}

impl ClientOptions {
    pub(crate) fn apply(self, mut builder: ClientBuilder<[u8], [u8]>) -> ClientBuilder<[u8], [u8]> {
        apply!(
            builder,
            self,
            [max_borrowed, sealed, inline_max, max_len],
            []
        )
    }
}
