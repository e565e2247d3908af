//! A node: a session with the Manager of one domain.

use std::sync::Arc;
use std::time::Duration;

use pyo3::prelude::*;
use sm2_node::domain::QueryError;
use sm2_node::{DeclareError, TypeId};

use crate::client::Client;
use crate::errors::{self, raise};
use crate::handles::Owned;
use crate::message_type::{MessageType, comparison};
use crate::options::{
    ClientOptions, NodeOptions, PublisherOptions, Seconds, ServerOptions, SubscriberOptions, time,
};
use crate::publisher::Publisher;
use crate::server::Server;
use crate::subscriber::Subscriber;
use crate::wait;

/// How long one attempt waits for a Manager to start, before a look at signals.
const STARTUP_SLICE: Duration = Duration::from_millis(100);

/// A node of a domain.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Node {
    inner: Owned<sm2_node::Node>,
    name: String,
}

#[pymethods]
impl Node {
    #[new]
    fn new(py: Python<'_>, name: String, options: NodeOptions) -> PyResult<Self> {
        let deadline = wait::Deadline::new(Some(
            options
                .startup_timeout
                .map_or(Duration::ZERO, |Seconds(time)| time),
        ));
        let node = loop {
            let slice = deadline.left().min(STARTUP_SLICE);
            let builder = options
                .apply(sm2_node::Node::builder(&name))
                .startup_timeout(slice);
            match wait::on_thread(py, move || builder.connect())? {
                Err(sm2_node::ConnectError::NoManager { .. }) if !deadline.left().is_zero() => {}
                connected => break connected,
            }
        };
        let node = node.map_err(raise(errors::ConnectError::new_err::<String>))?;
        Ok(Self {
            name: node.name().to_string(),
            inner: Owned::new("node", node),
        })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    #[getter]
    fn is_connected(&self) -> PyResult<bool> {
        self.inner.with(|node| node.is_connected())
    }

    fn wait_connected(&self, py: Python<'_>, timeout: Option<Seconds>) -> PyResult<()> {
        let node = self.inner.get()?;
        crate::interface::wait_for(py, time(timeout), move |slice| {
            node.wait_connected_timeout(slice)
        })
    }

    fn publisher(
        &self,
        py: Python<'_>,
        topic: &str,
        data: MessageType,
        options: PublisherOptions,
    ) -> PyResult<Publisher> {
        let node = self.inner.get()?;
        register(&node, &data)?;
        let builder = node.publisher_builder(topic).type_id(data.id.clone());
        let builder = options.apply(builder);
        let declared = wait::on_thread(py, move || builder.declare())?;
        let publisher = declared.map_err(|error| not_declared(py, &node, error, &[data]))?;
        Ok(Publisher::new(Arc::new(publisher)))
    }

    fn subscriber(
        &self,
        py: Python<'_>,
        topic: &str,
        data: Option<MessageType>,
        decode: Py<PyAny>,
        options: SubscriberOptions,
    ) -> PyResult<Subscriber> {
        let node = self.inner.get()?;
        let mut builder = node.subscriber_builder(topic);
        builder = match &data {
            Some(data) => {
                register(&node, data)?;
                builder.type_id(data.id.clone())
            }
            None => builder.any_type(),
        };
        let builder = options.apply(builder);
        let declared = wait::on_thread(py, move || builder.declare())?;
        let subscriber =
            declared.map_err(|error| not_declared(py, &node, error, data.as_slice()))?;
        Ok(Subscriber::new(Arc::new(subscriber), decode))
    }

    fn server(
        &self,
        py: Python<'_>,
        service: &str,
        request: MessageType,
        reply: MessageType,
        options: ServerOptions,
    ) -> PyResult<Server> {
        let node = self.inner.get()?;
        register(&node, &request)?;
        register(&node, &reply)?;
        let builder = node.server_builder(service);
        let builder = options.apply(builder.type_ids(request.id.clone(), reply.id.clone()));
        let declared = wait::on_thread(py, move || builder.declare())?;
        let server = declared.map_err(|error| not_declared(py, &node, error, &[request, reply]))?;
        Ok(Server::new(Arc::new(server)))
    }

    fn client(
        &self,
        py: Python<'_>,
        service: &str,
        request: MessageType,
        reply: MessageType,
        options: ClientOptions,
    ) -> PyResult<Client> {
        let node = self.inner.get()?;
        register(&node, &request)?;
        register(&node, &reply)?;
        let builder = node.client_builder(service);
        let builder = options.apply(builder.type_ids(request.id.clone(), reply.id.clone()));
        let declared = wait::on_thread(py, move || builder.declare())?;
        let client = declared.map_err(|error| not_declared(py, &node, error, &[request, reply]))?;
        Ok(Client::new(Arc::new(client)))
    }

    fn describe(&self, py: Python<'_>, data: MessageType) -> PyResult<Option<String>> {
        let node = self.inner.get()?;
        describe(py, &node, data.id)?.map_err(raise(errors::QueryError::new_err::<String>))
    }

    fn fileno(&self) -> PyResult<i32> {
        self.inner.with(|node| crate::interface::number(node))
    }

    fn spin_some(&self) -> PyResult<()> {
        Ok(self.inner.with(|node| node.spin_some())??)
    }

    fn close(&self) {
        self.inner.close();
    }

    #[getter]
    fn closed(&self) -> bool {
        !self.inner.is_open()
    }
}

/// Registers the schema text of a type, if it has one.
fn register(node: &sm2_node::Node, data: &MessageType) -> PyResult<()> {
    match &data.text {
        None => Ok(()),
        Some(text) => node
            .register_schema(data.id.clone(), text)
            .map_err(raise(errors::SchemaError::new_err::<String>)),
    }
}

fn describe(
    py: Python<'_>,
    node: &sm2_node::Node,
    data: TypeId,
) -> PyResult<Result<Option<String>, QueryError>> {
    let node = node.clone();
    wait::on_thread(py, move || node.describe(&data))
}

/// The exception for a declaration with these types. A mismatch shows the schemas of both sides.
fn not_declared(
    py: Python<'_>,
    node: &sm2_node::Node,
    error: DeclareError,
    ours: &[MessageType],
) -> PyErr {
    let theirs = match &error {
        DeclareError::TypeMismatch { theirs, .. } => vec![theirs.clone()],
        DeclareError::ServiceMismatch { theirs, .. } => vec![theirs.0.clone(), theirs.1.clone()],
        _ => return errors::DeclareError::new_err(error.to_string()),
    };
    let mut text = error.to_string();
    for (ours, theirs) in ours
        .iter()
        .zip(theirs)
        .filter(|(ours, theirs)| ours.id != *theirs)
    {
        let their_text = match describe(py, node, theirs.clone()) {
            Ok(answer) => answer.unwrap_or_default(),
            Err(interrupted) => return interrupted,
        };
        text.push_str(&comparison(ours, &theirs, their_text.as_deref()));
    }
    errors::TypeMismatchError::new_err(text)
}
